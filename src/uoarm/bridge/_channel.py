"""Channels: one open native link each, with a close that always ends."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping

from uoarm import _bounded
from uoarm.bridge._border import translated
from uoarm.model import Endpoint, Message

__all__ = ["Channel", "Sink"]

_CLOSE_SECONDS = 5.0


class Channel(ABC):
    """One open native link of a bridge.

    Must implement: `_close`. May implement: `facts`, `drain`.
    """

    def __init__(self, endpoint: Endpoint) -> None:
        self.endpoint = endpoint
        self._closing = threading.Lock()
        self._closed = False
        self._let_go = False
        self._when_closed: Callable[[Channel], None] | None = None

    @property
    def closed(self) -> bool:
        """Whether `close` was called, whatever it came to."""
        return self._closed

    @property
    def is_closing(self) -> bool:
        """Whether `close` was called and the framework has not let go yet."""
        return self._closed and not self._let_go

    def close(self, *, timeout: float = _CLOSE_SECONDS) -> None:
        """Close the link. May be called from any thread, `deliver`'s too; once is enough.

        The channel counts as closed from the beginning of the call, also when it raises.

        Raises:
            BridgeTimeoutError: the framework did not let go within `timeout` seconds.
            BridgeError: the framework failed while closing.
        """
        with self._closing:
            if self._closed:
                return
            self._closed = True
        if self._when_closed is not None:
            self._when_closed(self)
        step = f"bridge {self.endpoint.bridge!r}: closing {self.endpoint}"
        with translated(step):
            _bounded.run(step, timeout, self._close_native)

    def _close_native(self) -> None:
        try:
            self._close()
        finally:
            self._let_go = True

    def facts(self) -> Mapping[str, object]:
        """Return what the framework knows of the link now, for the status; quick, any thread.

        Two names have a meaning for the manager: `under_way` counts messages that the channel
        took and that have not arrived, `lost_on_link` those that never will. When a component
        dies, both are counted as lost, so they can be asked for after `close`, too.
        """
        return {}

    def drain(self, timeout: float) -> bool:
        """Wait until what is under way has arrived; False when `timeout` seconds were too few.

        For channels whose `send` or framework hands messages to another process, so that an
        orderly end loses nothing. Must not be called from within `deliver`.
        """
        del timeout
        return True

    @abstractmethod
    def _close(self) -> None:
        """Let go of the native link; called once, in a thread of the core.

        It must not wait for a `deliver` under way, since that may be what asked for the close:
        tell the delivering thread to end, let it finish alone, begin no other `deliver`.
        """


class Sink(Channel):
    """A channel into a component.

    Must implement: `_close`, `send`.

    Attributes:
        blocking: whether `send` may wait or compute. The manager calls a sink that does not
            block in the thread in which the message arrived; before any other it puts a
            bounded queue with one worker. True unless the bridge says otherwise.
    """

    blocking: bool = True

    @abstractmethod
    def send(self, message: Message) -> None:
        """Hand one message to the component.

        Called by one thread at a time, without any wrapper: what it raises is counted,
        translated and shown in the status by the route that called it.
        """
