"""Actions of one server: functions that take goals, and clients that work on others' goals."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, Protocol

from attrs import frozen

from uoarm.errors import BridgeError, FailureReason, MessageError, UoarmError
from uoarm.server.front_end import Backend, Done, LimitError, UnknownError
from uoarm_rosbridge._runners import Goal, Runner, StreamRunner
from uoarm_rosbridge._typedefs import is_same_type

__all__ = ["ActionHub", "ActionProvider"]


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
        try:
            self.provider.send(
                {
                    "op": "send_action_goal",
                    "id": identity,
                    "action": self.name,
                    "action_type": self.kind,
                    "args": {} if goal.arguments is None else goal.arguments,
                    "feedback": True,
                }
            )
        except BaseException:
            self.hub.close_goal(identity)
            raise

    def cancel(self, goal: Goal, done: Done) -> None:
        """Ask the provider to end a goal."""
        del done
        identity = self.hub.identity_of(goal)
        if identity is not None:
            self.provider.send({"op": "cancel_action_goal", "id": identity, "action": self.name})

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
        self._functions: dict[str, tuple[StreamRunner, set[object]]] = {}

    @property
    def actions(self) -> dict[str, str]:
        """Types by action, of those that clients offer."""
        return {name: offer.kind for name, offer in tuple(self._offers.items())}

    def runner(self, name: str) -> Runner | None:
        """Return what works on the goals of an action that a client offers."""
        return self._offers.get(name)

    def join(self, function: str, backend: Backend, client: object) -> StreamRunner:
        """Return what works on the goals of a function; give it back with `leave`."""
        if function not in self._functions:
            self._functions[function] = (StreamRunner(function, backend), set())
        runner, clients = self._functions[function]
        clients.add(client)
        return runner

    def leave(self, function: str, client: object) -> None:
        """Give a function back; the last one closes it."""
        runner, clients = self._functions[function]
        clients.discard(client)
        if not clients:
            del self._functions[function]
            runner.close()

    def offer(self, name: str, kind: str, provider: ActionProvider) -> None:
        """Let a client work on the goals of an action.

        Raises:
            LimitError: another client does so already.
        """
        if name in self._offers and self._offers[name].provider is not provider:
            raise LimitError(f"another client provides {name!r}")
        self._offers[name] = _Offer(name, kind, provider, self)

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
