"""Where an application touches a plan: what it receives and what it sends."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

from attrs import define, field

from uoarm._control.live.component import LiveComponent
from uoarm._dataplane import Clock, Inbox, Route, make_check
from uoarm.errors import UsageError
from uoarm.model import Message, QueuePolicy, RouteStatus, ValidationMode

__all__ = ["ApplicationPorts", "OutputReceiver"]


class OutputReceiver:
    """The application's inbox, into which the route of one plan at a time delivers.

    Args:
        queue: what to do when the application is slower than the messages.
        on_raised: told what a callback of the application raised first.

    Attributes:
        inbox: where the application reads.
        arrived: how many messages have come so far.
        began: how many had come before the plan that is heard now.
    """

    def __init__(self, queue: QueuePolicy, on_raised: Callable[[str], None]) -> None:
        self.inbox = Inbox(queue, self._count_drop, self._raised)
        self._on_raised = on_raised
        self._has_raised = False
        self.arrived = 0
        self.began = 0
        self._heard: Route | None = None

    def route(
        self, provider: LiveComponent, output: str, user: str, mode: ValidationMode, clock: Clock
    ) -> Route:
        """Make the route of a provider's output; before it is heard its messages are dropped.

        They are counted as `replaced`.
        """

        def arrive(message: Message) -> None:
            if route is self._heard:
                self.arrived += 1
                self.inbox.put(message)
            else:
                route.take_back("replaced")

        place = f"{provider.component.name}.{output}"
        check = provider.check(output, provider.structures[f"output.{output}"], mode)
        route = Route(place, user, arrive, clock=clock, check=check)
        return route

    def hear(self, route: Route | None) -> None:
        """Let the messages of this route through from now on, and of no other."""
        if route is not self._heard:
            self._heard = route
            self.began = self.arrived

    def _raised(self, text: str) -> None:
        if self._heard is not None:
            self._heard.last_error = text
        if not self._has_raised:
            self._has_raised = True
            self._on_raised(text)

    def _count_drop(self, reason: str) -> None:
        if self._heard is not None:
            self._heard.take_back(reason)


class Sender:
    """One application's route into one input.

    Args:
        live: the open component.
        name: its input.
        user: id of the connection, for the status map.
        validate: OFF trusts the application; anything else checks every message it sends.
        clock: seconds.

    Attributes:
        place: the input, for errors.

    Raises:
        BridgeError: the bridge could not open the input.
    """

    def __init__(
        self, live: LiveComponent, name: str, user: str, validate: ValidationMode, clock: Clock
    ) -> None:
        port = next(one for one in live.component.inputs if one.name == name)
        send, default_queue = live.open_input(name, lambda: self._route.closed)
        self._require_released = partial(live.require_released, name)
        self.place = place = f"{live.component.name}.{name}"
        mode = ValidationMode.OFF if validate is ValidationMode.OFF else ValidationMode.ALWAYS
        self._check = make_check(live.structures[f"input.{name}"], mode, place)
        queue = port.queue or default_queue
        watch = live.watch(name)
        self._route = Route(user, place, send, clock=clock, queue=queue, watch=watch)

    def send(self, message: Message) -> None:
        """Hand one message over.

        Raises:
            CommandRefusedError: the emergency stop holds the input.
            MessageError: it does not match the input's structure.
        """
        self._require_released()
        if self._check is not None:
            self._check(message)
        self._route.deliver(message)

    def flush(self, timeout: float) -> bool:
        """Wait until the component has taken what was sent; False when time ran out."""
        return self._route.drain(timeout)

    def status(self) -> RouteStatus:
        """Return what the status map shows."""
        return self._route.status()

    def close(self) -> None:
        """Send nothing more."""
        self._route.close()


@define(eq=False)
class ApplicationPorts:
    """What receives from one provider, and what feeds it.

    A plan that is replaced upstream of its provider leaves its ports to the next plan, so that
    nothing is lost or heard twice on the way out of a component that stays.

    Args:
        provider: the open component that provides the function asked for.
        route: takes the messages of its output; None where the application receives none.
        output: name of that output.
    """

    provider: LiveComponent
    route: Route | None
    output: str | None
    senders: dict[str, Sender] = field(factory=dict, init=False)

    def attach(self) -> None:
        """Receive from the next message on."""
        if self.route is not None and self.output is not None:
            self.provider.outlets[self.output].attach(self.route)

    @contextmanager
    def letting_through(self) -> Iterator[None]:
        """Have the application hear the retained message, if any, after it began to hear these."""
        if self.route is None or self.output is None:
            yield
        else:
            with self.provider.outlets[self.output].letting_through(self.route):
                yield

    def feed(self, user: str, validate: ValidationMode, clock: Clock) -> None:
        """Open every input that the application feeds.

        Raises:
            BridgeError: the bridge could not open one.
        """
        for port in self.provider.component.inputs:
            if port.source is None:
                self.senders[port.name] = Sender(self.provider, port.name, user, validate, clock)

    def sender(self, port: str | None) -> Sender:
        """Return the way into an input; None is the only one, or `default`.

        Raises:
            UsageError: the application feeds no such input.
        """
        if port is None and len(self.senders) == 1:
            return next(iter(self.senders.values()))
        sender = self.senders.get(port or "default")
        if sender is None:
            has = f"it has {', '.join(self.senders)}" if self.senders else "it has none"
            raise UsageError(
                f"function {self.provider.component.function!r} has no input "
                f"{port or 'default'!r} for the application: {has}"
            )
        return sender

    def flush(self, timeout: float) -> bool:
        """Wait until the component has taken what was sent; False when time ran out."""
        return all(sender.flush(timeout) for sender in tuple(self.senders.values()))

    def routes(self) -> tuple[Route | Sender, ...]:
        """Return the routes at these ports."""
        received = () if self.route is None else (self.route,)
        return (*received, *tuple(self.senders.values()))

    def close(self) -> None:
        """Send and receive nothing more. May be called again."""
        for sender in tuple(self.senders.values()):
            sender.close()
        if self.route is not None and self.output is not None:
            self.provider.outlets[self.output].detach(self.route)
            self.route.close()
