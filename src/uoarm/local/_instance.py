"""Instances: one running Python component, shared by all its open ports."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import attrs

from uoarm.errors import BridgeError, FailureReason
from uoarm.local._target import Target
from uoarm.model import Deliver, Endpoint, Message, Options

__all__ = ["Emit", "Instance"]


@attrs.frozen
class Emit:
    """A message for a named output, for components with several."""

    port: str
    message: Message


class Instance:
    """One component: its object, what it emits to, and its source thread.

    Args:
        target: the Python object.
        parameters: handed to a class when it is built, to a function at each call.
    """

    def __init__(self, target: Target, parameters: Options) -> None:
        self._target = target
        self._parameters = dict(parameters)
        self._emitters: dict[str, Deliver] = {}
        self._stop = threading.Event()
        self._object: Any = target.value(**self._parameters) if target.is_class else target.value

    def emit_to(self, port: str, deliver: Deliver | None) -> None:
        """Send what the component emits at a port to `deliver`; None: nobody listens."""
        if deliver is None:
            self._emitters.pop(port, None)
        else:
            self._emitters[port] = deliver

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

    def start(self, finished: Callable[[Exception | None], None]) -> threading.Thread:
        """Start the source's thread; `finished` hears of its end unless it was stopped."""
        thread = threading.Thread(
            target=self._run,
            args=(self._iterator(), finished),
            name=f"uoarm-{self._target.name}",
            daemon=True,
        )
        thread.start()
        return thread

    def stop(self) -> None:
        """Tell the source to end; it does so after the message that it has under way."""
        self._stop.set()

    def close(self) -> None:
        """End the component: stop its source and call its own `close` if it has one."""
        self.stop()
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

    def _run(
        self, messages: Iterator[Message], finished: Callable[[Exception | None], None]
    ) -> None:
        failure: Exception | None = None
        try:
            for message in messages:
                if self._stop.is_set():
                    break
                self._emit(message)
        except Exception as error:  # noqa: BLE001 - a component may raise anything
            failure = error
        finally:
            _close_generator(messages)
        if not self._stop.is_set():
            finished(failure)

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
        deliver = self._emitters.get(port)
        if deliver is not None and message is not None:
            deliver(_plain(message))


def _plain(message: Any) -> Message:
    """Return a record as a dict, anything else as it is."""
    if attrs.has(type(message)):
        return attrs.asdict(message)
    if dataclasses.is_dataclass(message) and not isinstance(message, type):
        return dataclasses.asdict(message)
    return message


def _close_generator(messages: Iterator[Message]) -> None:
    close = getattr(messages, "close", None)
    if callable(close):
        close()
