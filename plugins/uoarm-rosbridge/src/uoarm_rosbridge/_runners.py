"""What works on the goals of one action: a function that is one, or a service.

Of a service the goal is its request, the result its reply; there is no feedback.
"""

from __future__ import annotations

import asyncio
from typing import Protocol

from uoarm.errors import UsageError
from uoarm.server.front_end import Backend, Done, Goal, GoalStatus
from uoarm_rosbridge._names import NamedPort
from uoarm_rosbridge._types import reader_of

__all__ = ["CallRunner", "Runner"]


class Runner(Protocol):
    """Who works on the goals of one action."""

    def start(self, goal: Goal) -> None:
        """Begin with a goal; raises UoarmError when it is refused at once."""

    def cancel(self, goal: Goal, done: Done) -> None:
        """Ask for a goal's end; raises UoarmError where that cannot be asked.

        What the goal ends with comes as its result; `done` is called with how the asking went.
        """

    def abandon(self, goal: Goal) -> None:
        """Cancel, as far as it can be, a goal whose client has gone."""


class CallRunner:
    """Calls one function for one client.

    Args:
        place: the function.
        backend: where it is called.
    """

    def __init__(self, place: NamedPort, backend: Backend) -> None:
        self._place = place
        self._backend = backend
        self._tasks: dict[Goal, asyncio.Task[None]] = {}

    def start(self, goal: Goal) -> None:
        """Call the function."""
        task = self._tasks[goal] = asyncio.ensure_future(self._call(goal))
        task.add_done_callback(lambda _: self._tasks.pop(goal, None))

    def cancel(self, goal: Goal, done: Done) -> None:
        """Refuse: a call runs to its end."""
        del goal, done
        raise UsageError(
            f"{self._place.name} is a call, which cannot be cancelled; its result still comes"
        )

    def abandon(self, goal: Goal) -> None:
        """Wait for the reply no more."""
        if goal in self._tasks:
            self._tasks[goal].cancel()

    async def _call(self, goal: Goal) -> None:
        try:
            reply = await self._backend.call(
                self._place.wanted,
                goal.arguments,
                reader_of(f"action {self._place.name!r}", goal.kind),
                self._backend.limits.call_seconds,
            )
        except Exception as error:  # noqa: BLE001 - reported to its sender
            goal.fail(error)
        else:
            goal.finish(reply, GoalStatus.SUCCEEDED)
