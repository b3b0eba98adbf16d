"""Instances: one running Python component, shared by all its open ports."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Hashable, Iterable, Iterator
from typing import Any

import attrs

from uoarm.errors import BridgeError, FailureReason
from uoarm.local._source import Source
from uoarm.local._target import Target
from uoarm.model import Deliver, Endpoint, Message, Options

__all__ = ["Emit", "Instance"]


@attrs.frozen
class Emit:
    """A message for a named output, for components with several."""

    port: str
    message: Message


class Instance:
    """One component: its object, what takes its messages, and its source thread.

    Args:
        target: the Python object.
        parameters: handed to a class when it is built, to a function at each call.
    """

    def __init__(self, target: Target, parameters: Options) -> None:
        self._target = target
        self._parameters = dict(parameters)
        self._receivers: dict[str, tuple[tuple[Hashable, Deliver], ...]] = {}
        self._source = Source(self._iterator, self._emit, f"uoarm-{target.name}")
        self._object: Any = target.value(**self._parameters) if target.is_class else target.value

    @property
    def source(self) -> Source:
        """What iterates over the component where it takes no messages."""
        return self._source

    def add_receiver(self, port: str, key: Hashable, deliver: Deliver) -> None:
        """Send what the component emits at a port to one more receiver."""
        self._receivers[port] = (*self._receivers.get(port, ()), (key, deliver))

    def remove_receiver(self, port: str, key: Hashable) -> None:
        """Send nothing more to a receiver."""
        self._receivers[port] = tuple(one for one in self._receivers[port] if one[0] is not key)

    def feed(self, endpoint: Endpoint) -> Callable[[Message], None]:
        """Return a function that hands a message to an input and emits what comes back."""
        handler = self._handler(endpoint)

        def take(message: Message) -> None:
            result = handler(message)
            if result is not None:
                self._emit_all(result)

        return take

    def answer(self, endpoint: Endpoint, message: Message) -> Message:
        """Call a service and return its reply."""
        return _plain(self._handler(endpoint)(message))

    def close(self) -> None:
        """End the component: stop its source and call its own `close` if it has one."""
        self._source.stop()
        close = getattr(self._object, "close", None)
        if self._target.is_class and callable(close):
            close()

    def _handler(self, endpoint: Endpoint) -> Callable[[Message], Any]:
        if self._target.is_class:
            name = "__call__" if endpoint.port == "default" else endpoint.port
            handler: Callable[[Message], Any] = getattr(self._object, name)
            return handler
        if not self._parameters:
            return self._object  # type: ignore[no-any-return]
        return lambda message: self._object(message, **self._parameters)

    def _iterator(self) -> Iterator[Message]:
        if self._target.is_class:
            return iter(self._object)
        made = self._object(**self._parameters)
        if not isinstance(made, Iterable):
            text = f"{self._target.name} returned {type(made).__name__}, expected messages"
            raise BridgeError(text, FailureReason.BAD_ENDPOINT)
        return iter(made)

    def _emit_all(self, result: Any) -> None:
        if isinstance(result, Iterator):
            for message in result:
                self._emit(message)
        else:
            self._emit(result)

    def _emit(self, message: Any) -> None:
        port = "default"
        if isinstance(message, Emit):
            port, message = message.port, message.message
        receivers = self._receivers.get(port)
        if receivers and message is not None:
            plain = _plain(message)
            for _, deliver in receivers:
                deliver(plain)


def _plain(message: Any) -> Message:
    """Return a record as a dict, anything else as it is."""
    if attrs.has(type(message)):
        return attrs.asdict(message)
    if dataclasses.is_dataclass(message) and not isinstance(message, type):
        return dataclasses.asdict(message)
    return message
