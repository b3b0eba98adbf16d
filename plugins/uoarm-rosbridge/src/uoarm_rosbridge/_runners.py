"""A function that is an action: goals and cancellations go in; status, feedback, result come out.

A component is an action when it has an open input `goal` and the outputs `status` and `result`;
an input `cancel` and an output `feedback` may be there. Messages that come out carry `goal_id`.

A service serves as one, too: the goal is its request, the result its reply; there is no feedback.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from enum import IntEnum
from typing import Protocol

from attrs import define, field

from uoarm import Connection
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, UoarmError, UsageError
from uoarm.model import Component, Message
from uoarm.server.front_end import (
    Account,
    Backend,
    BusyError,
    Done,
    Envelope,
    Feed,
    FeedKey,
    InputSender,
)
from uoarm_rosbridge._names import NamedPort, topic_of
from uoarm_rosbridge._types import check_type, read_arguments, reader_of, service_type

__all__ = ["CallRunner", "Goal", "GoalStatus", "Runner", "StreamRunner", "is_action"]


class GoalStatus(IntEnum):
    """How a goal stands, with the numbers of `action_msgs/msg/GoalStatus`."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6


@define(eq=False)
class Goal:
    """A goal on its way; everything in the loop's thread.

    After its end nothing more is heard of it, whatever still comes.

    Attributes:
        arguments: the goal as the client wrote it.
        on_feedback: hears what comes before the result.
        on_result: hears the result and how the goal ended.
        on_failure: hears why there is no result.
        octets: of memory that the arguments hold.
        kind: the type of the action that the client states; empty: none.
        ended: whether one of the two last was called, or the client has gone.
    """

    arguments: Message
    on_feedback: Callable[[Message], None]
    on_result: Callable[[Message, GoalStatus], None]
    on_failure: Callable[[BaseException], None]
    octets: int = 0
    kind: str = ""
    ended: bool = field(default=False, init=False)

    def feed(self, values: Message) -> None:
        """Pass feedback on."""
        if not self.ended:
            self.on_feedback(values)

    def finish(self, values: Message, status: GoalStatus) -> None:
        """Pass the result on."""
        if not self.ended:
            self.ended = True
            self.on_result(values, status)

    def fail(self, error: BaseException) -> None:
        """Tell that there is no result."""
        if not self.ended:
            self.ended = True
            self.on_failure(error)


class Runner(Protocol):
    """Who works on the goals of one action."""

    def start(self, goal: Goal) -> None:
        """Begin with a goal; raises UoarmError when it is refused at once."""

    def cancel(self, goal: Goal, done: Done) -> None:
        """Ask for a goal's end; raises UoarmError where that cannot be asked.

        What the goal ends with comes as its result; `done` hears how the asking went.
        """

    def abandon(self, goal: Goal) -> None:
        """Cancel, as far as it can be, a goal whose client has gone."""


_ENDS = {
    "succeeded": GoalStatus.SUCCEEDED,
    "canceled": GoalStatus.CANCELED,
    "aborted": GoalStatus.ABORTED,
}
_EARLY = 64
_CANCEL_OCTETS = 500


def is_action(component: Component) -> bool:
    """Say whether a component takes goals."""
    inputs = {input_.name for input_ in component.inputs if input_.source is None}
    return "goal" in inputs and {"status", "result"} <= {
        output.name for output in component.outputs
    }


def _taking(component: Component) -> Component:
    if not is_action(component):
        raise UsageError(f"component {component.name!r} takes no goals")
    return component


class StreamRunner:
    """The goals of all clients to one function, in the loop's thread.

    A component tells a goal's id only with the status that answers it. So goals are handed over one
    at a time, each after the answer to the one before; once accepted they run side by side.

    Args:
        function: the function.
        backend: where it is opened, with the first goal.
    """

    def __init__(self, function: str, backend: Backend) -> None:
        self._function = function
        self._backend = backend
        self._waiting: deque[Goal] = deque()
        self._asked: Goal | None = None
        self._running: dict[str, Goal] = {}
        self._connection: Connection | None = None
        self._unwanted = False
        self._timer: asyncio.TimerHandle | None = None
        self._early: deque[tuple[str, Mapping[str, Message]]] = deque(maxlen=_EARLY)
        self._parts: dict[_Part, Feed] = {}
        self._account: Account | None = None
        self._sending: InputSender | None = None
        self._opening: asyncio.Task[None] | None = None

    def start(self, goal: Goal) -> None:
        """Hand a goal over after those before it.

        Raises:
            BusyError: too many wait.
        """
        if len(self._waiting) >= self._backend.limits.streams:
            raise BusyError(f"{len(self._waiting)} goals to {self._function!r} wait already")
        self._waiting.append(goal)
        if self._sending is not None:
            self._next()
        elif self._opening is None:
            self._opening = asyncio.ensure_future(self._open())

    def cancel(self, goal: Goal, done: Done) -> None:
        """Ask for a goal's end; `done` hears how the asking went."""
        if goal in self._waiting:
            self._waiting.remove(goal)
            goal.finish({}, GoalStatus.CANCELED)
        elif goal is self._asked:
            self._unwanted = True
        else:
            identity = next((name for name, value in self._running.items() if value is goal), None)
            if identity is not None and self._sending is not None:
                self._sending.send({"goal_id": identity}, "cancel", done, _CANCEL_OCTETS)

    def abandon(self, goal: Goal) -> None:
        """Cancel a goal whose client has gone, if it can be."""
        goal.ended = True
        with suppress(UoarmError):
            self.cancel(goal, _ignore)

    def close(self) -> None:
        """Let go of the function after what was handed over."""
        if self._opening is not None:
            self._opening.cancel()
        if self._sending is None:
            self._leave()
        else:
            self._sending.after(self._leave)

    async def _open(self) -> None:
        try:
            connection = await self._join("status")
            outputs = {
                output.name for output in _taking(connection.plan.provider.component).outputs
            }
            for part in outputs & {"feedback", "result"}:
                await self._join(part)
        except Exception as error:  # noqa: BLE001 - told to those who sent goals
            self._fail_all(error)
            return
        finally:
            self._opening = None
        self._connection = connection
        self._account = self._backend.open_account()
        self._sending = self._backend.sender(connection, self._account, read_arguments)
        for listener, feed in tuple(self._parts.items()):
            if listener in self._parts:  # until one of them tells that it has ended
                feed.add(listener)
        self._next()

    async def _join(self, name: str) -> Connection:
        feed = await self._backend.join(FeedKey(f"{self._function}.{name}"))
        self._parts[_Part(name, self._receive, self._ended)] = feed
        assert feed.connection is not None, "join returns feeds that are open"
        return feed.connection

    def _next(self) -> None:
        """Hand over the next goal, unless one waits for its answer."""
        while self._asked is None and self._waiting and self._sending is not None:
            goal = self._asked = self._waiting.popleft()
            seconds = self._backend.limits.request_seconds
            self._timer = asyncio.get_running_loop().call_later(seconds, self._late, goal)
            try:
                self._hand_over(goal, self._sending)
            except UoarmError as error:
                self._refused(goal, error)

    def _hand_over(self, goal: Goal, sending: InputSender) -> None:
        def done(error: BaseException | None) -> None:
            if error is not None:
                self._refused(goal, error)

        if goal.kind and self._connection is not None:
            structure = self._connection.plan.provider.structures.get("input.goal")
            known = "" if structure is None else service_type(structure, self._function)
            check_type(f"action {topic_of(self._function)!r}", goal.kind, known)
        sending.send(goal.arguments, "goal", done, goal.octets)

    def _refused(self, goal: Goal, error: BaseException) -> None:
        goal.fail(error)
        self._answered(goal)
        self._next()

    def _late(self, goal: Goal) -> None:
        text = f"{self._function!r} has not answered the goal in time"
        self._refused(goal, BridgeTimeoutError(text))

    def _answered(self, goal: Goal) -> None:
        if goal is self._asked:
            self._asked = None
            self._unwanted = False
            if self._timer is not None:
                self._timer.cancel()

    def _receive(self, part: str, message: Message) -> None:
        if not isinstance(message, Mapping):
            return
        identity = str(message.get("goal_id"))
        if identity in self._running:
            self._forward(part, self._running[identity], identity, message)
        elif self._asked is not None:
            if part == "status" and message.get("status") in {"accepted", "rejected"}:
                self._decide(self._asked, identity, accepted=message["status"] == "accepted")
            else:
                self._early.append((part, message))

    def _decide(self, goal: Goal, identity: str, *, accepted: bool) -> None:
        unwanted = self._unwanted
        self._answered(goal)
        if not accepted:
            text = f"{self._function!r} rejected the goal"
            goal.fail(BridgeError(text, FailureReason.REFUSED))
        else:
            self._running[identity] = goal
            early = [pair for pair in self._early if pair[1].get("goal_id") == identity]
            self._early.clear()
            for part, message in early:
                self._receive(part, message)
            if unwanted:
                self.cancel(goal, _ignore)
        self._next()

    def _forward(
        self, part: str, goal: Goal, identity: str, message: Mapping[str, Message]
    ) -> None:
        if part == "feedback":
            goal.feed(message.get("feedback"))
        elif part == "result":
            del self._running[identity]
            status = _ENDS.get(str(message.get("status")), GoalStatus.UNKNOWN)
            goal.finish(message.get("result"), status)
        elif message.get("status") == "lost":
            del self._running[identity]
            text = f"the server of {self._function!r} has gone; what became of the goal is unknown"
            goal.fail(BridgeError(text, FailureReason.CLOSED))

    def _ended(self, state: str, cause: str) -> None:
        text = f"{self._function!r} has {state}: {cause or 'killed'}"
        self._fail_all(BridgeError(text, FailureReason.CLOSED))

    def _fail_all(self, error: BaseException) -> None:
        goals = [*self._running.values(), *self._waiting]
        self._running.clear()
        self._waiting.clear()
        self._early.clear()
        if self._asked is not None:
            goals.append(self._asked)
            self._answered(self._asked)
        self._leave()
        for goal in goals:
            goal.fail(error)

    def _leave(self) -> None:
        parts, self._parts = self._parts, {}
        if self._sending is not None and self._account is not None:
            self._sending.close()
            self._account.close()
        self._sending = None
        for part, feed in parts.items():
            feed.remove(part)
            self._backend.leave(feed)


class _Part:
    """Listens to one output."""

    def __init__(
        self,
        name: str,
        on_message: Callable[[str, Message], None],
        ended: Callable[[str, str], None],
    ) -> None:
        self._name = name
        self._receive = on_message
        self.ended = ended

    def offer(self, envelope: Envelope) -> None:
        """Pass one message on."""
        self._receive(self._name, envelope.message)

    def refuse(self, envelope: Envelope, error: Exception) -> None:
        """Never called: nothing is written here."""


def _ignore(error: BaseException | None) -> None:
    """Let a cancellation that failed pass: the result says what became of the goal."""
    del error


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
        except Exception as error:  # noqa: BLE001 - told to the one who sent it
            goal.fail(error)
        else:
            goal.finish(reply, GoalStatus.SUCCEEDED)
