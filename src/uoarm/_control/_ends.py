"""Ends: where an application touches a plan, at its provider's output and inputs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from attrs import define, field

from uoarm._control._live import LiveComponent
from uoarm._control._sender import Sender
from uoarm._dataplane import Clock, Route
from uoarm.errors import UsageError
from uoarm.model import ValidationMode

__all__ = ["Ends"]


@define(eq=False)
class Ends:
    """What receives from one provider, and what feeds it.

    A plan that is replaced upstream of its provider leaves its ends to the next plan, so that
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
        """Return the routes at these ends."""
        received = () if self.route is None else (self.route,)
        return (*received, *tuple(self.senders.values()))

    def close(self) -> None:
        """Send and receive nothing more. May be called again."""
        for sender in tuple(self.senders.values()):
            sender.close()
        if self.route is not None and self.output is not None:
            self.provider.outlets[self.output].detach(self.route)
            self.route.close()
