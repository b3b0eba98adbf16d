"""Senders: the way from an application into an input that no other function feeds."""

from __future__ import annotations

from uoarm._control._live import LiveComponent
from uoarm._dataplane import Clock, Route, make_check
from uoarm.model import Message, QueuePolicy, RouteStatus, ValidationMode

__all__ = ["Sender"]


class Sender:
    """One application's route into one input.

    Args:
        live: the open component.
        name: its input.
        user: id of the connection, for the status map.
        validate: OFF trusts the application; anything else checks every message it sends.
        clock: seconds.

    Raises:
        BridgeError: the bridge could not open the input.
    """

    def __init__(
        self, live: LiveComponent, name: str, user: str, validate: ValidationMode, clock: Clock
    ) -> None:
        port = next(one for one in live.component.inputs if one.name == name)
        sink = live.open_input(name)
        place = f"{live.component.name}.{name}"
        mode = ValidationMode.OFF if validate is ValidationMode.OFF else ValidationMode.ALWAYS
        self._check = make_check(live.structures[f"input.{name}"], mode, place)
        queue = port.queue or (QueuePolicy() if sink.blocking else None)
        send = live.sender(name, lambda: self._route.closed)
        self._route = Route(user, place, send, clock=clock, queue=queue)

    def send(self, message: Message) -> None:
        """Hand one message over.

        Raises:
            MessageError: it does not match the input's structure.
        """
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
