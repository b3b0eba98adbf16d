"""Actions: goals that clients send, and goals of others that they work on.

What works on the goals of one action is a function that is an action, another client, or a service:
of a service the goal is its request, the result its reply; there is no feedback.
"""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, Protocol, TypeAlias

from attrs import define, field, frozen

from uoarm.bridge import on_failure
from uoarm.errors import (
    BridgeError,
    ControlMessageError,
    FailureReason,
    MessageError,
    UoarmError,
    UsageError,
)
from uoarm.model import Message, Plan, QueuePolicy, show_value
from uoarm.server.front_end import (
    Backend,
    Charge,
    Client,
    Done,
    Goal,
    GoalStatus,
    Lane,
    LimitError,
    MemoryUse,
    Operation,
    UnknownError,
    coded_text,
    is_action,
)
from uoarm_rosbridge._names import NamedPort, find_place
from uoarm_rosbridge._types import check_type, is_same_type, read_arguments, reader_of, service_type
from uoarm_rosbridge._wire import fragment_size, split, write_ros


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


class ActionProvider(Protocol):
    """A client that works on goals."""

    def send(self, message: Mapping[str, Any]) -> None:
        """Send one message to the client.

        Raises:
            BusyError: it leaves too much unread.
            MessageError: the message has no form.
        """


@frozen(eq=False)
class _Offer:
    """A client's offer to work on the goals of one action; a runner for those who send them."""

    name: str
    given: str  # the name as the client has it, by which it knows what it is sent
    kind: str
    provider: ActionProvider
    hub: ActionHub

    def start(self, goal: Goal) -> None:
        """Send a goal to the provider."""
        if goal.kind and self.kind and not is_same_type(goal.kind, self.kind):
            raise MessageError(
                f"action {self.name!r} has the type {self.kind!r:.100}, not {goal.kind!r:.100}"
            )
        identity = self.hub.note(self, goal)
        with on_failure(self.hub.close_goal, identity):
            self.provider.send(
                {
                    "op": "send_action_goal",
                    "id": identity,
                    "action": self.given,
                    "action_type": self.kind,
                    "args": {} if goal.arguments is None else goal.arguments,
                    "feedback": True,
                }
            )

    def cancel(self, goal: Goal, done: Done) -> None:
        """Ask the provider to end a goal."""
        del done
        identity = self.hub.identity_of(goal)
        if identity is not None:
            self.provider.send({"op": "cancel_action_goal", "id": identity, "action": self.given})

    def abandon(self, goal: Goal) -> None:
        """Ask for its end; the answer is taken and goes nowhere."""
        goal.ended = True
        with suppress(UoarmError):
            self.cancel(goal, lambda _: None)


class ActionHub:
    """All actions behind one server, in the loop's thread."""

    def __init__(self) -> None:
        self._offers: dict[str, _Offer] = {}
        self._goals: dict[str, tuple[_Offer, Goal]] = {}
        self._numbers = itertools.count(1)

    @property
    def actions(self) -> dict[str, str]:
        """Types by action, of those that clients offer."""
        return {name: offer.kind for name, offer in tuple(self._offers.items())}

    def runner(self, name: str) -> Runner | None:
        """Return what works on the goals of an action that a client offers."""
        return self._offers.get(name)

    def offer(self, given: str, kind: str, provider: ActionProvider) -> None:
        """Let a client work on the goals of an action.

        Raises:
            LimitError: another client does so already.
        """
        name = find_place(given).name
        if name in self._offers and self._offers[name].provider is not provider:
            raise LimitError(f"another client provides {name!r}")
        self._offers[name] = _Offer(name, given, kind, provider, self)

    def withdraw(self, name: str, provider: ActionProvider) -> None:
        """Take an offer back; goals that it has not finished fail."""
        offer = self._offers.get(name)
        if offer is not None and offer.provider is provider:
            del self._offers[name]
            self._fail(lambda item: item.name == name, f"{name} was unadvertised")

    def forget(self, provider: ActionProvider) -> None:
        """Take back all offers of a client that has gone."""
        for name in [name for name, offer in self._offers.items() if offer.provider is provider]:
            del self._offers[name]
        self._fail(lambda item: item.provider is provider, "the client that provides it has gone")

    def note(self, offer: _Offer, goal: Goal) -> str:
        """Remember a goal until its result; returns its id."""
        identity = f"uoarm:{offer.name}:{next(self._numbers)}"
        self._goals[identity] = (offer, goal)
        return identity

    def identity_of(self, goal: Goal) -> str | None:
        """Return the id of a goal that is not finished."""
        return next((name for name, (_, item) in self._goals.items() if item is goal), None)

    def goal(self, identity: str, provider: ActionProvider) -> Goal:
        """Return a goal that a client works on.

        Raises:
            UnknownError: there is none, or another client works on it.
        """
        offer, goal = self._goals.get(identity, (None, None))
        if offer is None or goal is None or offer.provider is not provider:
            raise UnknownError(f"this client works on no goal {identity!r:.200}")
        return goal

    def close_goal(self, identity: str) -> None:
        """Forget a goal that has its result."""
        del self._goals[identity]

    def _fail(self, concerns: Callable[[_Offer], bool], text: str) -> None:
        for identity, (offer, goal) in list(self._goals.items()):
            if concerns(offer):
                del self._goals[identity]
                goal.fail(BridgeError(text, FailureReason.CLOSED))


class CallRunner:
    """Calls one function for one client."""

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


Fields = Mapping[str, Any]
Identity: TypeAlias = "str | float"


@frozen(eq=False)
class _Sent:
    place: NamedPort
    goal: Goal
    runner: Runner
    charge: Charge


@define(eq=False)
class Actions:
    """Goals of one client by id, in the loop's thread.

    A function is an action where its component takes goals; a service is one without feedback.
    Other names are actions between clients.

    Args:
        fail: reports to the client what went wrong with a message of its.
        send: sends another client's request; raises BusyError where it leaves too much unread.
    """

    _client: Client
    _backend: Backend
    _hub: ActionHub
    _fail: Callable[[Fields, BaseException], None]
    send: Callable[[Fields], None]
    _sent: dict[Identity, _Sent] = field(factory=dict, init=False)
    _joined: set[str] = field(factory=set, init=False)
    _offered: set[str] = field(factory=set, init=False)
    _numbers: itertools.count[int] = field(factory=lambda: itertools.count(1), init=False)

    def send_goal(self, fields: Fields) -> None:
        """Begin with a goal; feedback and result come with its id."""
        identity = fields["action"] if fields.get("id") is None else fields["id"]
        if identity in self._sent:
            raise UsageError(f"the goal {identity!r:.200} is under way")
        if len(self._sent) >= self._client.limits.streams:
            raise LimitError(f"{self._client.limits.streams} goals are under way already")
        place = find_place(fields["action"])
        self._client.require(Operation.CALL, place.right)
        runner = self._runner(place)
        charge = self._client.account.charge(MemoryUse.ASKED, self._client.in_hand)
        sent = self._sent[identity] = _Sent(place, self._goal(identity, fields), runner, charge)
        with on_failure(self._forget, identity):
            runner.start(sent.goal)

    def cancel_goal(self, fields: Fields) -> None:
        """Ask for a goal's end; its result says what became of it."""
        sent = self._sent.get(fields["id"])
        if sent is None:
            raise UnknownError(f"this client has no goal {fields['id']!r:.200} under way")

        def done(error: BaseException | None) -> None:
            if error is not None:
                self._fail(fields, error)

        sent.runner.cancel(sent.goal, done)

    def cancel_all(self, place: NamedPort) -> None:
        """Ask for the end of all goals of this client to one action."""
        for identity, sent in list(self._sent.items()):
            if sent.place == place:
                self.cancel_goal({"op": "cancel_action_goal", "id": identity})

    def advertise(self, fields: Fields) -> None:
        """Work on goals of other clients from now on."""
        place = find_place(fields["action"])
        self._client.require(Operation.SEND, place.right)
        if place.function:
            raise UsageError(f"{place.name!r} belongs to the server")
        if len(self._offered) >= self._client.limits.streams:
            raise LimitError(f"{self._client.limits.streams} actions are offered already")
        self._hub.offer(fields["action"], fields["type"], self)
        self._offered.add(place.name)

    def unadvertise(self, fields: Fields) -> None:
        """Work on goals of an action no more."""
        name = find_place(fields["action"]).name
        if name not in self._offered:
            raise UsageError(f"this client does not provide {name!r}")
        self._offered.discard(name)
        self._hub.withdraw(name, self)

    def take_feedback(self, fields: Fields) -> None:
        """Pass feedback on to the client that sent the goal."""
        self._hub.goal(fields["id"], self).feed(fields.get("values"))

    def take_result(self, fields: Fields) -> None:
        """Pass a result on to the client that sent the goal."""
        goal = self._hub.goal(fields["id"], self)
        status = _status(fields.get("status"))
        self._hub.close_goal(fields["id"])
        values = fields.get("values")
        if fields["result"] is True:
            goal.finish({} if values is None else values, status)
        else:
            text = f"the goal ended {status.name.lower()}: {show_value(values, 500)}"
            goal.fail(BridgeError(text, FailureReason.REFUSED))

    def close(self) -> None:
        """Give everything back; what this client asked for is cancelled."""
        for sent in self._sent.values():
            sent.runner.abandon(sent.goal)
        self._sent.clear()
        for function in self._joined:
            self._backend.actions.leave(function, self)
        self._hub.forget(self)

    def _runner(self, place: NamedPort) -> Runner:
        if not place.function:
            runner = self._hub.runner(place.name)
            if runner is None:
                raise UnknownError(f"there is no action {place.name!r:.200}")
            return runner
        function = self._backend.robot.config.functions.get(place.function)
        if function is None or place.port:
            raise UnknownError(f"there is no function {place.wanted!r:.200}")
        if any(is_action(component) for component in function.components):
            self._joined.add(place.function)
            return self._backend.actions.join(place.function, self)
        return CallRunner(place, self._backend)

    def _goal(self, identity: Identity, fields: Fields) -> Goal:
        """Return a goal that answers to the client, feedback and result in their order."""
        named = {name: fields[name] for name in ("action", "id") if fields.get(name) is not None}
        lane = Lane(QueuePolicy(self._client.limits.queue_messages), text=True)
        feedback = {**fields, "op": "action_feedback"}

        def on_feedback(values: Message) -> None:
            if fields.get("feedback"):
                try:
                    frame = write_ros({"op": "action_feedback", "values": values, **named})
                except MessageError as error:
                    if lane.refuse(error):
                        self._fail(feedback, error)
                else:
                    self._client.outbox.put(lane, *self._split(frame, fields))

        def on_result(values: Message, status: GoalStatus) -> None:
            try:
                frame = _result(named, values, status, result=True)
            except MessageError as error:
                on_failure(error)
            else:
                finish(frame)

        def on_failure(error: BaseException) -> None:
            view = self._backend.role_views.of(self._client.role)
            text = view.text(coded_text(error), str(fields["action"]))
            finish(_result(named, text, GoalStatus.UNKNOWN, result=False))

        def finish(frame: bytes) -> None:
            self._forget(identity)
            self._client.outbox.finish(lane, *self._split(frame, fields))

        stated = str(fields.get("action_type") or "")

        def check(plan: Plan) -> None:
            structure = plan.provider.structures.get("input.goal")
            known = "" if structure is None else service_type(structure, plan.function)
            check_type(f"action {fields['action']!r}", stated, known)

        goal = Goal(
            fields.get("args"),
            on_feedback,
            on_result,
            on_failure,
            self._client.in_hand,
            stated,
            read_arguments,
        )
        if stated:
            goal.check = check
        return goal

    def _forget(self, identity: Identity) -> None:
        sent = self._sent.pop(identity, None)
        if sent is not None:
            sent.charge.release()

    def _split(self, frame: bytes, fields: Fields) -> list[bytes]:
        return split(frame, fragment_size(fields), f"uoarm:goal:{next(self._numbers)}")


def _status(given: Any) -> GoalStatus:
    try:
        return GoalStatus(given)
    except ValueError:
        known = ", ".join(
            f"{goal_status.value} ({goal_status.name.lower()})" for goal_status in GoalStatus
        )
        text = f"action_result: status: expected one of {known}, got {show_value(given)}"
        raise ControlMessageError(text) from None


def _result(named: Fields, values: Message, status: GoalStatus, *, result: bool) -> bytes:
    reports = {"op": "action_result", "values": values, "status": int(status), "result": result}
    return write_ros({**reports, **named})
