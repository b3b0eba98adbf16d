"""Where an application touches a plan: what it receives and what it sends."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

from attrs import define, field, frozen

from uoarm._dataplane import Clock, Inbox, Outlet, Route, make_check
from uoarm._parts._component import LiveComponent
from uoarm._raised import Log, text_of
from uoarm.bridge import boot_seconds
from uoarm.errors import (
    BridgeError,
    CommandRefusedError,
    FailureReason,
    MessageError,
    UoarmError,
    UsageError,
)
from uoarm.model import (
    CommandPhase,
    LeaseHolder,
    Message,
    QueuePolicy,
    ValidationMode,
)

_log = Log("uoarm.commands")
_LAST_SECONDS = 0.5


@define(eq=False)
class _DeliveringRoute:
    """The route that delivers, if there is one: what its messages come to is reported to it.

    Attributes:
        on_raised: called with what a callback of the application raised first.
    """

    on_raised: Callable[[str], None]
    route: Route | None = None
    _has_raised: bool = False

    def raised(self, text: str) -> None:
        if self.route is not None:
            self.route.last_error = text
        if not self._has_raised:
            self._has_raised = True
            self.on_raised(text)

    def count_drop(self, reason: str) -> None:
        if self.route is not None:
            self.route.take_back(reason)


class OutputReceiver:
    """The application's inbox, into which the route of one plan at a time delivers.

    Args:
        on_raised: called with what a callback of the application raised first.

    Attributes:
        inbox: where the application reads.
        arrived: how many messages have come so far.
        began: how many had come before the plan that delivers now.
        outlet: the one that delivers; what stands there is the very objects that came.
    """

    def __init__(self, queue: QueuePolicy, on_raised: Callable[[str], None]) -> None:
        self._delivering = _DeliveringRoute(on_raised)
        self.outlet: Outlet | None = None
        self.inbox = Inbox(queue, self._delivering.count_drop, self._delivering.raised)
        # Counted in the thread of the route that delivers, of which there is one.
        self.arrived = 0
        self.began = 0

    def route(
        self, provider: LiveComponent, output: str, user: str, mode: ValidationMode, clock: Clock
    ) -> Route:
        """Make the route of a provider's output; before it delivers its messages are dropped.

        They are counted as `replaced`.
        """

        # Both routes may bring messages as one plan takes over from another: each asks, for each of
        # its messages, whether it is the one. `deliver_from` replaces that in one step.
        def arrive(message: Message) -> None:
            if route is self._delivering.route:
                self.arrived += 1
                self.inbox.put(message)
            else:
                route.take_back("replaced")

        place = f"{provider.component.name}.{output}"
        structure = provider.structures[f"output.{output}"]

        def judge(message: Message, _: bool) -> None:  # noqa: FBT001 - a callback
            provider.judge(output, structure, message)

        check = provider.check(output, structure, mode)
        route = Route(place, user, arrive, clock=clock, check=check)
        route.judge = judge
        return route

    def deliver_from(self, route: Route | None, outlet: Outlet | None) -> None:
        """Let the messages of this route, from this outlet, through from now on; of no other."""
        self.outlet = outlet
        if route is not self._delivering.route:
            self._delivering.route = route
            self.began = self.arrived


@frozen
class _Command:
    """A message on its way to an input that moves something.

    Attributes:
        number: in the order in which the application sent them.
        sent: when; seconds of the clock of commands.
    """

    message: Message
    sender: LeaseHolder
    number: int
    sent: float


class Sender:
    """One application's route into one input.

    What goes to an input that moves something is looked at twice: as it is sent, so that the
    sender learns which client commands it, and when its turn has come, after its queue.

    Args:
        user: id of the connection, for the status map.
        validate: OFF trusts the application; anything else checks every message it sends.

    Attributes:
        place: the input, for errors.
        route: what it sends goes through it.
        lifetime: seconds for which a command lives; None: until the next one.

    Raises:
        BridgeError: the bridge could not open the input.
    """

    def __init__(
        self, live: LiveComponent, name: str, user: str, validate: ValidationMode, clock: Clock
    ) -> None:
        port = live.component.input(name)
        self._policy = policy = port.endpoint.command
        self.lifetime = None if policy is None else policy.lifetime
        self._live = live
        self._name = name
        self._lease = live.leases.get(name)
        self._last_sender: LeaseHolder | None = None
        self._numbers = itertools.count(1)
        # The number of the last stop, written by who stops: a command with a lower one is not sent
        # any more. One that was admitted just before is followed by another stop (`_halt_again`).
        # Held while it is taken: of two who stop at once the later one writes the higher number.
        self._stopping = threading.Lock()
        self._stopped = 0
        self._failures = 0  # that a flush has reported

        def is_over() -> bool:
            return self.route.closed

        self.route: Route
        if policy is None:
            send, default_queue = live.open_input(port, is_over)
        else:
            self._pass_on, default_queue = live.open_input(port, is_over, self._admit)
            send = self._hand_command
        self._require_released = partial(live.require_released, name)
        self.place = place = f"{live.component.name}.{name}"
        mode = ValidationMode.OFF if validate is ValidationMode.OFF else ValidationMode.ALWAYS
        self._check = make_check(live.structures[f"input.{name}"], mode, place)
        queue = port.queue or default_queue
        watch = live.watches[name]
        self.route = Route(user, place, send, clock=clock, queue=queue, watch=watch)

    def send(
        self,
        message: Message,
        sender: LeaseHolder,
        *,
        take_over: bool = False,
        sent: float | None = None,
    ) -> None:
        """Hand one message over, which left its sender when `sent` says; None: now.

        Raises:
            CommandRefusedError: the emergency stop holds the input, or another client its lease.
            MessageError: it does not match the input's structure, or has no form there.
            BridgeError: the component took it at once, and failed, or is not there.
        """
        self._require_released()
        if self._check is not None:
            self._check(message)
        if self._policy is None:
            self._require_taken(self.route.deliver(message))
            return
        # Asked here, so that the sender learns at once who holds it; once more when its turn has
        # come, as it may have been taken over while the command waited.
        if self._lease is not None:
            self._lease.ask(sender, take_over=take_over)
            self._last_sender = sender
        # Its number before its time: what is numbered after a stop was sent after it.
        number = next(self._numbers)
        command = _Command(message, sender, number, boot_seconds() if sent is None else sent)
        self._require_taken(self.route.deliver(command))

    def _require_taken(self, failure: Exception | None) -> None:
        """Have the sender know what a message came to that waits in no queue; it is counted."""
        if failure is None or isinstance(failure, CommandRefusedError):
            return  # what the last hop refuses is mostly known later: that is in the status
        if isinstance(failure, MessageError):
            raise MessageError(f"{self.place}: {failure}") from failure
        if isinstance(failure, UoarmError):
            raise failure
        raise BridgeError(f"{self.place} raised {text_of(failure)}") from failure

    @property
    def can_stop(self) -> bool:
        return self._policy is not None and self._policy.stop is not None

    def stop(self, sender: LeaseHolder, timeout: float) -> None:
        """Stop the input, and give its lease back; nothing where another client holds that.

        What was sent before and waits in a queue is not sent any more.

        Raises:
            BridgeError: the framework has not taken the stop message; it goes on being sent.
        """
        if self._lease is not None and not self._lease.is_open_to(sender):
            return
        try:
            self._halt(timeout)
        finally:
            if self._lease is not None:
                self._lease.give_back(sender)

    def leave(self, sender: LeaseHolder) -> None:
        """Give the lease back, if this sender holds it, and stop what it moves. Never raises."""
        if self._lease is None or not self._lease.give_back(sender):
            return
        try:
            self._halt(_LAST_SECONDS)
        except UoarmError as error:
            _log.warning("%s", error)

    def _halt(self, timeout: float) -> None:
        with self._stopping:
            self._stopped = next(self._numbers)
        status = self._live.halt(self._name, timeout)
        if status is not None and status.phase is CommandPhase.STOPPING:
            cause = status.cause or f"not within {timeout:g} s"
            text = f"{self.place}: it has not taken its stop message: {cause}"
            raise BridgeError(text, FailureReason.UNAVAILABLE)

    def _admit(self, command: _Command) -> tuple[Message, float]:
        """Let a command pass whose turn has come; return it and its age in seconds."""
        if command.number <= self._stopped:
            text = f"{self.place}: its sender stopped the input while the command waited"
            raise CommandRefusedError(text, "stopped")
        if self._lease is not None:
            self._lease.require(command.sender)
        return command.message, boot_seconds() - command.sent

    def _hand_command(self, command: _Command) -> None:
        try:
            self._pass_on(command)
        except CommandRefusedError:
            raise
        except BaseException:
            self._halt_again(command)  # it may have arrived all the same
            raise
        self._halt_again(command)

    def _halt_again(self, command: _Command) -> None:
        """Stop once more where the stop may have overtaken a command that was admitted before."""
        if command.number <= self._stopped:
            self._live.halt(self._name, _LAST_SECONDS)

    def flush(self, timeout: float) -> bool:
        """Wait until nothing waits; False when time ran out, or what was sent was not taken.

        Each failure is reported by one flush, the next after it.
        """
        drained = self.route.drain(timeout)
        report, self._failures = self._failures, self.route.failures
        return drained and self._failures == report

    def close(self) -> None:
        """Send nothing more; what the application holds a lease of is given back, and stopped."""
        self.route.close()
        if self._last_sender is not None:
            self.leave(self._last_sender)


@define(eq=False)
class ApplicationPorts:
    """What receives from one provider, and what feeds it.

    A plan that is replaced upstream of its provider leaves its ports to the next plan, so that
    nothing is lost or received twice on the way out of a component that stays.

    Args:
        provider: the open component that provides the function asked for.
        route: takes the messages of its output; None where the application receives none.
        outlet: what they come from; None likewise.
    """

    provider: LiveComponent
    route: Route | None
    outlet: Outlet | None
    senders: dict[str, Sender] = field(factory=dict, init=False)

    def attach(self) -> None:
        """Receive from the next message on."""
        if self.route is not None and self.outlet is not None:
            self.outlet.attach(self.route)

    @contextmanager
    def letting_through(self) -> Iterator[None]:
        """Give the application the retained message, if any, after it receives from these."""
        if self.route is None or self.outlet is None:
            yield
        else:
            with self.outlet.letting_through(self.route):
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
        """Wait until nothing waits; False when time ran out, or what was sent was not taken."""
        flushed = [sender.flush(timeout) for sender in tuple(self.senders.values())]
        return all(flushed)

    def leave(self, sender: LeaseHolder) -> None:
        """Give back what leases a sender holds, and stop what it moves with them."""
        for way in tuple(self.senders.values()):
            way.leave(sender)

    def lifetimes(self) -> dict[str, float]:
        """Return for how many seconds a command lives, by input that has it."""
        return {
            name: way.lifetime for name, way in self.senders.items() if way.lifetime is not None
        }

    def routes(self) -> tuple[Route, ...]:
        received = () if self.route is None else (self.route,)
        return (*received, *(sender.route for sender in tuple(self.senders.values())))

    def close(self) -> None:
        """Send and receive nothing more. May be called again."""
        for sender in tuple(self.senders.values()):
            sender.close()
        if self.route is not None and self.outlet is not None:
            self.outlet.detach(self.route)
            self.route.close()
