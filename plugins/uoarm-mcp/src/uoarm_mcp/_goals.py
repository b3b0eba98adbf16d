"""Work that lasts: a handle at once, how it stands, its end once, and its cancellation."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from typing import Any

from attrs import define, field

from uoarm.errors import UoarmError
from uoarm.model import Message
from uoarm.server.front_end import LimitError, UnknownError
from uoarm_mcp._values import RenderedMessage, failure_text

__all__ = ["AgentGoal", "AgentGoals", "within"]

_MOST_RUNNING = 32
_MOST_KEPT = 128


@define(eq=False)
class AgentGoal:
    """One piece of work.

    Attributes:
        handle: by which the agent knows it; of what needed an approval it is that of the approval.
        function: which function works on it.
        state: `running`, or how it ended, in the framework's own word.
        result: what it came to.
        cause: why it failed.
        feedback: what came last before the result.
        cancel: asks for its end; returns whether that could be asked.
        stop: stops what it moves, in the loop; returns whether anything is.
        done: set at its end.
        is_reported: whether its end was reported.
    """

    handle: str
    function: str
    state: str = "running"
    result: RenderedMessage | None = None
    cause: str = ""
    feedback: Message = None
    cancel: Callable[[], bool] | None = None
    stop: Callable[[], bool] | None = None
    is_cancelled: bool = False
    is_reported: bool = False
    began: float = field(factory=time.monotonic)
    ended: float | None = None
    done: asyncio.Event = field(factory=asyncio.Event)

    def facts(self) -> dict[str, Any]:
        """Return how it stands, as data; the end is reported once with its result."""
        facts: dict[str, Any] = {
            "state": self.state,
            "handle": self.handle,
            "function": self.function,
            "seconds": round((self.ended or time.monotonic()) - self.began, 3),
        }
        if self.is_cancelled and self.state == "running":
            facts["cancelling"] = True
        if self.done.is_set():
            facts["first_report"] = not self.is_reported
            self.is_reported = True
        if self.cause:
            facts["cause"] = self.cause
        if self.result is not None:
            facts["summary" if self.result.is_summary else "result"] = self.result.value
        return facts


class AgentGoals:
    """The goals of one agent, in the server's loop."""

    def __init__(self) -> None:
        self._goals: OrderedDict[str, AgentGoal] = OrderedDict()
        self._tasks: set[asyncio.Task[None]] = set()

    def all(self) -> list[AgentGoal]:
        """Return those that are known, oldest first."""
        return list(self._goals.values())

    def find(self, handle: str) -> AgentGoal:
        """Return one; raises UnknownError."""
        goal = self._goals.get(handle)
        if goal is None:
            raise UnknownError(f"there is no goal {handle!r:.64} of this agent")
        return goal

    def knows(self, handle: str) -> bool:
        """Say whether there is one."""
        return handle in self._goals

    def check_room(self) -> None:
        """Refuse more than an agent may have under way; raises LimitError."""
        if len(self._tasks) >= _MOST_RUNNING:
            raise LimitError(f"{len(self._tasks)} goals are under way; wait for one of them first")

    def start(
        self,
        goal: AgentGoal,
        work: Callable[[AgentGoal], Awaitable[RenderedMessage]],
        text: Callable[[str], str],
    ) -> None:
        """Begin with a goal, which `check_room` had room for."""
        self._goals[goal.handle] = goal
        if len(self._goals) > _MOST_KEPT:
            oldest = next(handle for handle, item in self._goals.items() if item.done.is_set())
            del self._goals[oldest]
        task = asyncio.ensure_future(self._run(goal, work, text))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def forget(self, goal: AgentGoal) -> None:
        """Know one no more that was not begun with."""
        self._goals.pop(goal.handle, None)

    def cancel(self, goal: AgentGoal) -> bool:
        """Ask for a goal's end; returns whether the framework could be asked."""
        goal.is_cancelled = True
        return goal.cancel is not None and goal.cancel()

    def running(self) -> list[AgentGoal]:
        """Return those that are under way, oldest first."""
        return [goal for goal in self._goals.values() if not goal.done.is_set()]

    def stop_own(self) -> list[str]:
        """Stop what goals under way move by an input; returns which."""
        return [f"{goal.function}.goal" for goal in self.running() if goal.stop and goal.stop()]

    def close(self) -> None:
        """Stop what moves, and ask for the end of all that is under way."""
        self.stop_own()
        for goal in self.running():
            self.cancel(goal)

    async def _run(
        self,
        goal: AgentGoal,
        work: Callable[[AgentGoal], Awaitable[RenderedMessage]],
        text: Callable[[str], str],
    ) -> None:
        try:
            goal.result = await work(goal)
            if goal.state == "running":
                goal.state = "succeeded"
        except UoarmError as error:
            goal.state = "canceled" if goal.is_cancelled else "failed"
            goal.cause = text(failure_text(error))
        except Exception as error:  # noqa: BLE001 - the end is reported, whatever it is
            goal.state = "failed"
            goal.cause = failure_text(error)
        finally:
            goal.ended = time.monotonic()
            goal.done.set()


async def within(seconds: float, event: asyncio.Event) -> None:
    """Wait for an event, for so many seconds at most."""
    if event.is_set():
        return
    with contextlib.suppress(asyncio.TimeoutError):
        await asyncio.wait_for(event.wait(), seconds)
