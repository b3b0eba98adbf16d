"""A function that is an action: goals and cancellations go in; status, feedback, result come out.

A component is an action when it has an open input `goal` and the outputs `status` and `result`;
an input `cancel` and an output `feedback` may be there. Messages that come out carry `goal_id`.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from enum import IntEnum
from typing import Protocol

from attrs import define, field, frozen

from uoarm._control import Connection
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, UoarmError, UsageError
from uoarm.model import Component, Message, MessageStructure, Plan
from uoarm.server._failures import BusyError
from uoarm.server._limits import Limits
from uoarm.server.streams._feed import Envelope, Feed, FeedKey
from uoarm.server.streams._input_sender import Done, InputSender, Read
from uoarm.server.streams._memory import Account


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

    After its end nothing more is reported of it, whatever still comes.

    Attributes:
        arguments: the goal as the client wrote it.
        on_feedback: called with what comes before the result.
        on_result: called with the result and how the goal ended.
        on_failure: called with why there is no result.
        octets: of memory that the arguments hold.
        kind: the type of the action that the client states; empty: none.
        read: makes the logical value of the arguments by the goal's structure, in a worker.
        check: called with the plan that works on it before it is handed over; may refuse it.
        ended: whether one of the two last callbacks was called, or the client has gone.
    """

    arguments: Message
    on_feedback: Callable[[Message], None]
    on_result: Callable[[Message, GoalStatus], None]
    on_failure: Callable[[BaseException], None]
    octets: int = 0
    kind: str = ""
    read: Read = lambda _, message: message
    check: Callable[[Plan], object] = lambda _: None
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
        """Pass on why there is no result."""
        if not self.ended:
            self.ended = True
            self.on_failure(error)


class ActionBackend(Protocol):
    """What the goals of a function need of the server."""

    @property
    def limits(self) -> Limits:
        """The bounds of clients."""

    async def join(self, wanted: FeedKey) -> Feed:
        """Return an open feed."""

    def leave(self, feed: Feed) -> None:
        """Give a feed back."""

    def open_account(self) -> Account:
        """Return an account for what no single client caused."""

    def sender(self, connection: Connection, account: Account, read: Read) -> InputSender:
        """Return what hands messages to a connection."""


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

    A component says a goal's id only with the status that answers it. So goals are handed over one
    at a time, each after the answer to the one before; once accepted they run side by side.

    Args:
        backend: where it is opened, with the first goal.
    """

    def __init__(self, function: str, backend: ActionBackend) -> None:
        self._function = function
        self._backend = backend
        self._waiting: deque[Goal] = deque()
        # Handed over, and without an answer yet: the next status that accepts or rejects an unknown
        # id is its answer. So there is never more than one.
        self._asked: Goal | None = None
        self._running: dict[str, Goal] = {}
        self._connection: Connection | None = None
        # Whether that one was cancelled before its id was known: it is cancelled when it is.
        self._unwanted = False
        self._timer: asyncio.TimerHandle | None = None
        # Outputs are separate channels: feedback, even the result, may come before the status that
        # accepts. Bounded, since a component may speak of ids that no client has.
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
        """Ask for a goal's end; `done` is called with how the asking went."""
        if goal in self._waiting:
            self._waiting.remove(goal)
            goal.finish({}, GoalStatus.CANCELED)
        elif goal is self._asked:
            self._unwanted = True
        else:
            identity = next((name for name, value in self._running.items() if value is goal), None)
            if identity is not None and self._sending is not None:
                message = {"goal_id": identity}
                self._sending.send(message, "cancel", done, _CANCEL_OCTETS, ends_motion=True)

    def stop(self, goal: Goal) -> bool:
        """Have the input that takes goals send its stop message; one that waits is not given.

        Returns whether the goal was given, and so something is stopped.
        """
        # Nothing that moves is due to this goal: there is nothing to stop, for others either.
        if self._sending is None or goal in self._waiting:
            self.cancel(goal, _ignore)
            return False
        with suppress(BusyError):  # enough stops of it are under way
            self._sending.stop("goal", _ignore)
        return True

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
        else:  # cancellations of clients that have just gone are among what was handed over
            self._sending.after(self._leave)

    async def _open(self) -> None:
        try:
            connection = await self._join("status")
            outputs = {
                output.name for output in _taking(connection.plan.provider.component).outputs
            }
            # All are open before the first goal goes: no result can come while it is being opened.
            for part in outputs & {"feedback", "result"}:
                await self._join(part)
        except Exception as error:  # noqa: BLE001 - each goal gets it
            self._fail_all(error)
            return
        finally:
            self._opening = None
        self._connection = connection
        self._account = self._backend.open_account()
        self._sending = self._backend.sender(connection, self._account, _read_goal)
        for listener, feed in tuple(self._parts.items()):
            if listener in self._parts:  # until one of them has ended
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
            # Set before it is handed over: where that fails at once, the goal and its timer are
            # forgotten again.
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

        if self._connection is not None:
            goal.check(self._connection.plan)
        sending.send(goal, "goal", done, goal.octets)

    def _refused(self, goal: Goal, error: BaseException) -> None:
        # Also called for a goal that was answered, or given up, meanwhile: both then do nothing.
        goal.fail(error)
        self._answered(goal)
        self._next()

    def _late(self, goal: Goal) -> None:
        text = f"{self._function!r} has not answered the goal in time"
        goal.fail(BridgeTimeoutError(text))
        if goal is not self._asked:  # its client ended the function in there
            return
        # An answer that comes still does not say whose it is: no other goal is handed over for as
        # long again, whose client would get this one's id. Where it is accepted, it is cancelled.
        self._unwanted = True
        seconds = self._backend.limits.request_seconds
        self._timer = asyncio.get_running_loop().call_later(seconds, self._give_up, goal)

    def _give_up(self, goal: Goal) -> None:
        self._answered(goal)
        self._next()

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
        # Read before the goal counts as answered, which forgets it.
        unwanted = self._unwanted
        self._answered(goal)
        if not accepted:
            text = f"{self._function!r} rejected the goal"
            goal.fail(BridgeError(text, FailureReason.REFUSED))
        else:
            self._running[identity] = goal
            # Passed on in the order in which it came; what is of other ids is of no goal of ours.
            early = [pair for pair in self._early if pair[1].get("goal_id") == identity]
            self._early.clear()
            for part, message in early:
                self._receive(part, message)
            if unwanted:
                with suppress(UoarmError):  # the server is closing, which ends the function
                    self.cancel(goal, _ignore)
        self._next()

    def _forward(
        self, part: str, goal: Goal, identity: str, message: Mapping[str, Message]
    ) -> None:
        if part == "feedback":
            goal.feed(message.get("feedback"))
        elif part == "result":
            # Taken out before its client has the result, and may cancel or send another in there.
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
        # All is empty, and the feeds are given back, before a callback is called: a client that
        # asks again in there opens the function anew.
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
        # Taken first: giving the last feed back ends the connection, whose end comes here again.
        parts, self._parts = self._parts, {}
        if self._sending is not None and self._account is not None:
            self._sending.close()
            self._account.close()
        self._sending = None
        for part, feed in parts.items():
            feed.remove(part)
            self._backend.leave(feed)


@frozen(eq=False)
class _Part:
    """Listens to one output."""

    _name: str
    _receive: Callable[[str, Message], None]
    ended: Callable[[str, str], None]

    def offer(self, envelope: Envelope) -> None:
        """Pass one message on."""
        self._receive(self._name, envelope.message)


def _ignore(error: BaseException | None) -> None:
    """Let a cancellation that failed pass: the result says what became of the goal."""
    del error


def _read_goal(structure: MessageStructure, message: Message) -> Message:
    """Read a goal in the way of its client; a cancellation is as it is."""
    return message.read(structure, message.arguments) if isinstance(message, Goal) else message


class ActionRunners:
    """What works on goals, by function, for the clients of all front ends together.

    Goals are handed over one at a time, so that one connection has one runner, whichever protocol
    its clients speak.
    """

    def __init__(self, backend: ActionBackend) -> None:
        self._backend = backend
        self._functions: dict[str, tuple[StreamRunner, set[object]]] = {}

    def join(self, function: str, client: object) -> StreamRunner:
        """Return what works on the goals of a function; give it back with `leave`."""
        if function not in self._functions:
            self._functions[function] = (StreamRunner(function, self._backend), set())
        runner, clients = self._functions[function]
        clients.add(client)
        return runner

    def leave(self, function: str, client: object) -> None:
        """Give a function back; the last one closes it."""
        runner, clients = self._functions[function]
        clients.discard(client)
        if not clients:
            # Before it closes: a client that joins from here on gets a runner that works.
            del self._functions[function]
            runner.close()
