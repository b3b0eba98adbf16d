"""The bridge contract: public final methods around the few raw steps that a bridge supplies.

Must implement: `_describe`, `_open_source`, `_open_sink`, `_close`.
May implement, when the capability says so: `_discover`, `_call`, `_serve`, `_link`.
"""

from __future__ import annotations

import logging
import os
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TypeVar, final

from uoarm import _bounded
from uoarm.bridge._border import translated
from uoarm.bridge._channel import Channel, Sink
from uoarm.bridge._description import Capabilities, Description, Discovered, HealthEvent
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Deliver, Endpoint, Health, Message, MessageStructure, Options

__all__ = ["CONTRACT_VERSION", "Bridge", "Handler"]

CONTRACT_VERSION = 1

T = TypeVar("T")
C = TypeVar("C", bound=Channel)
Handler = Callable[[Message], Message]

_log = logging.getLogger("uoarm")


class Bridge(ABC):
    """One framework, one version, one configuration.

    The public methods are final. They check the state, keep the time limit, translate foreign
    exceptions and remember what is open; a bridge supplies the steps that begin with `_`.
    Every public method may be called from any thread, several at a time.

    Args:
        name: name of this instance in the configuration.
        options: its settings, already checked against the plugin's options schema.
    """

    capabilities: Capabilities = Capabilities()

    def __init__(self, name: str, options: Options) -> None:
        self.name = name
        self.options = options
        self._lock = threading.Lock()
        self._open: set[Channel] = set()
        self._is_closed = False
        self._listener: Callable[[HealthEvent], None] | None = None

    @final
    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return self._is_closed

    @final
    @property
    def open_channels(self) -> int:
        """How many channels are open now."""
        return len(self._open)

    @property
    def process_id(self) -> int | None:
        """The id of the process in which the framework's side runs; None on another machine."""
        return os.getpid()

    @final
    def describe(self, endpoint: Endpoint, *, timeout: float = 5.0) -> Description:
        """Return the message structures of an endpoint that is available now.

        Raises:
            BridgeError: it does not exist, is not available, or cannot be understood.
            BridgeTimeoutError: no answer within `timeout` seconds.
        """
        found = self._step(f"describing {endpoint}", timeout, lambda: self._describe(endpoint))
        if not isinstance(found, Description):
            raise self._broken("_describe", "a Description", found)
        return found

    @final
    def discover(self, *, timeout: float = 5.0) -> tuple[Discovered, ...]:
        """Return the components that are visible now.

        Raises:
            BridgeError: the framework failed, or cannot list its components.
            BridgeTimeoutError: no answer within `timeout` seconds.
        """
        self._require(self.capabilities.discover, "discover components")
        return tuple(self._step("discovering components", timeout, self._discover))

    @final
    def open_source(
        self,
        endpoint: Endpoint,
        structure: MessageStructure,
        deliver: Deliver,
        *,
        timeout: float = 5.0,
    ) -> Channel:
        """Open an output of a component; its messages go to `deliver`.

        `deliver` is called in the bridge's thread, for one channel one message at a time, and
        never after `close` has returned (unless `close` was called from within it).

        Raises:
            BridgeError: the framework refused or failed; nothing stays open.
            BridgeTimeoutError: not open within `timeout` seconds; what opens later is closed.
        """
        return self._opened(
            Channel,
            f"opening {endpoint}",
            timeout,
            lambda: self._open_source(endpoint, structure, deliver),
        )

    @final
    def open_sink(
        self, endpoint: Endpoint, structure: MessageStructure, *, timeout: float = 5.0
    ) -> Sink:
        """Open an input of a component.

        Raises:
            BridgeError: the framework refused or failed; nothing stays open.
            BridgeTimeoutError: not open within `timeout` seconds; what opens later is closed.
        """
        return self._opened(
            Sink, f"opening {endpoint}", timeout, lambda: self._open_sink(endpoint, structure)
        )

    @final
    def call(self, endpoint: Endpoint, message: Message, *, timeout: float = 10.0) -> Message:
        """Send one request to a service and return its reply.

        Raises:
            BridgeError: the service failed or is gone.
            BridgeTimeoutError: no reply within `timeout` seconds.
        """
        self._require(self.capabilities.call, "call services")
        return self._step(
            f"calling {endpoint}", timeout, lambda: self._call(endpoint, message, timeout)
        )

    @final
    def serve(self, endpoint: Endpoint, handler: Handler, *, timeout: float = 5.0) -> Channel:
        """Offer a service to the framework; requests go to `handler`, in the bridge's thread.

        Raises:
            BridgeError: the framework refused or failed; nothing stays open.
            BridgeTimeoutError: not open within `timeout` seconds; what opens later is closed.
        """
        self._require(self.capabilities.serve, "serve")
        return self._opened(
            Channel, f"serving {endpoint}", timeout, lambda: self._serve(endpoint, handler)
        )

    @final
    def link(self, source: Endpoint, sink: Endpoint, *, timeout: float = 5.0) -> Channel | None:
        """Connect two endpoints of this bridge natively; None when these two cannot be.

        Raises:
            BridgeError: the framework refused or failed; nothing stays open.
            BridgeTimeoutError: not open within `timeout` seconds; what opens later is closed.
        """
        if not self.capabilities.link:
            return None
        step = f"linking {source} to {sink}"
        channel = self._step(step, timeout, lambda: self._link(source, sink), on_late=_put_away)
        return None if channel is None else self._adopt(Channel, "_link", channel)

    @final
    def watch(self, listener: Callable[[HealthEvent], None] | None) -> None:
        """Have health events told to one listener; None ends it. The listener must not block."""
        self._listener = listener

    @final
    def close(self, *, timeout: float = 5.0) -> None:
        """Close every channel, then the bridge. Once is enough.

        Raises:
            BridgeError: something failed while closing; the rest was closed all the same.
        """
        with self._lock:
            if self._is_closed:
                return
            self._is_closed = True
            channels = list(self._open)
        failures: list[BridgeError] = []
        for channel in channels:
            try:
                channel.close(timeout=timeout)
            except BridgeError as error:
                failures.append(error)
        step = f"bridge {self.name!r}: closing"
        with translated(step):
            _bounded.run(step, timeout, self._close)
        if failures:
            raise failures[0]

    def report(
        self,
        health: Health,
        cause: str,
        *,
        channel: Channel | None = None,
        component: str | None = None,
    ) -> None:
        """Tell the manager of a change; for bridges, from any thread."""
        listener = self._listener
        if listener is not None and not self._is_closed:
            listener(HealthEvent(self.name, health, cause, channel, component))

    @abstractmethod
    def _describe(self, endpoint: Endpoint) -> Description:
        """Return the endpoint's structures, or raise BridgeError with NOT_FOUND, UNAVAILABLE."""

    @abstractmethod
    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Deliver
    ) -> Channel:
        """Open an output. Return only when a message sent from then on will arrive."""

    @abstractmethod
    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        """Open an input. Return only when a message sent from then on will arrive."""

    @abstractmethod
    def _close(self) -> None:
        """Let go of the framework; every channel has been closed before."""

    def _discover(self) -> tuple[Discovered, ...]:
        raise NotImplementedError

    def _call(self, endpoint: Endpoint, message: Message, timeout: float) -> Message:
        raise NotImplementedError

    def _serve(self, endpoint: Endpoint, handler: Handler) -> Channel:
        raise NotImplementedError

    def _link(self, source: Endpoint, sink: Endpoint) -> Channel | None:
        raise NotImplementedError

    def _step(
        self,
        what: str,
        timeout: float,
        action: Callable[[], T],
        on_late: Callable[[T], None] | None = None,
    ) -> T:
        if self._is_closed:
            raise BridgeError(f"bridge {self.name!r} is closed: {what}", FailureReason.CLOSED)
        step = f"bridge {self.name!r}: {what}"
        with translated(step):
            return _bounded.run(step, timeout, action, on_late=on_late)

    def _opened(self, kind: type[C], what: str, timeout: float, action: Callable[[], C]) -> C:
        channel = self._step(what, timeout, action, on_late=_put_away)
        return self._adopt(kind, what, channel)

    def _adopt(self, kind: type[C], what: str, channel: C) -> C:
        if not isinstance(channel, kind):
            raise self._broken(what, f"a {kind.__name__}", channel)
        with self._lock:
            keep = not self._is_closed
            if keep:
                self._open.add(channel)
                channel._when_closed = self._forget  # noqa: SLF001 - a channel's one owner
        if not keep:
            _put_away(channel)
            raise BridgeError(f"bridge {self.name!r} was closed: {what}", FailureReason.CLOSED)
        return channel

    def _forget(self, channel: Channel) -> None:
        with self._lock:
            self._open.discard(channel)

    def _require(self, able: bool, what: str) -> None:  # noqa: FBT001
        if not able:
            text = f"bridge {self.name!r} cannot {what}"
            raise BridgeError(text, FailureReason.UNSUPPORTED)

    def _broken(self, what: str, expected: str, got: object) -> BridgeError:
        text = (
            f"bridge {self.name!r} breaks the contract: {what} returned "
            f"{type(got).__name__}, expected {expected}"
        )
        return BridgeError(text, FailureReason.CONTRACT)


def _put_away(channel: Channel | None) -> None:
    """Close a channel that nobody waits for any more."""
    if not isinstance(channel, Channel):
        return
    try:
        channel.close()
    except BridgeError:
        _log.warning("a channel that came too late could not be closed", exc_info=True)
