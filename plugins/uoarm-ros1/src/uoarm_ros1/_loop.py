"""One thread that waits for many sockets and for times; what it calls returns at once."""

from __future__ import annotations

import heapq
import logging
import selectors
import socket
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from itertools import count

__all__ = ["Handler", "Loop"]

_log = logging.getLogger("uoarm.ros1")
_JOIN_SECONDS = 2.0


class Handler(ABC):
    """What the loop calls for one socket, in its own thread.

    Must implement `readable`. May implement `writable` and `failed`.
    """

    def __init__(self, connection: socket.socket) -> None:
        self.socket = connection

    @abstractmethod
    def readable(self) -> None:
        """Take what came; raises OSError or ProtocolError where the socket is of no more use."""

    def writable(self) -> bool:
        """Write what waits; returns whether more is left."""
        return False

    def failed(self, cause: str) -> None:  # noqa: B027 - may be left out
        """Take note that the socket is closed now, and why."""


class Loop:
    """The thread. Every method may be called from any thread, and returns at once but `close`."""

    def __init__(self, name: str) -> None:
        self._selector = selectors.DefaultSelector()
        self._wake, self._woken = socket.socketpair()
        for end in (self._wake, self._woken):
            end.setblocking(False)
        self._selector.register(self._woken, selectors.EVENT_READ)
        self._posted: deque[Callable[[], object]] = deque()
        self._times: list[tuple[float, int, Callable[[], object]]] = []
        self._numbers = count()
        self._closing = self._ended = False
        self._handlers: set[Handler] = set()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def post(self, action: Callable[[], object]) -> None:
        """Have something called in the thread, in the order of posting."""
        self._posted.append(action)
        if self._ended:
            # Nothing is watched any more, but sockets that come now are closed all the same.
            self._call_posted()
            return
        with suppress(OSError):  # full: it wakes anyway; closed: the thread has ended
            self._wake.send(b"\0")

    def later(self, seconds: float, action: Callable[[], object]) -> None:
        """Have something called in the thread after a while; only from within it."""
        heapq.heappush(self._times, (time.monotonic() + seconds, next(self._numbers), action))

    def add(self, handler: Handler) -> None:
        """Watch a socket, which does not block from now on."""
        handler.socket.setblocking(False)
        self.post(lambda: self._add(handler))

    def write(self, handler: Handler) -> None:
        """Call `writable` of a handler when its socket takes octets."""
        self.post(lambda: self._change(handler, selectors.EVENT_READ | selectors.EVENT_WRITE))

    def discard(self, handler: Handler, *, close: bool = True) -> None:
        """Watch a socket no more, and close it unless its owner does so."""
        self.post(lambda: self._remove(handler, close=close))

    def pause(self, handler: Handler, seconds: float) -> None:
        """Watch a socket again after a while; only from within the thread."""
        self._remove(handler, close=False)
        self.later(seconds, lambda: self._add(handler))

    def release(self, handler: Handler) -> None:
        """Hand a socket over to another owner; only from within the thread."""
        self._remove(handler, close=False)

    def close(self) -> None:
        """End the thread and close every socket."""
        self._closing = True
        self.post(lambda: None)
        if threading.current_thread() is not self._thread:
            self._thread.join(_JOIN_SECONDS)

    def _add(self, handler: Handler) -> None:
        if self._closing:
            handler.socket.close()
            return
        self._handlers.add(handler)
        try:
            self._selector.register(handler.socket, selectors.EVENT_READ, handler)
        except (OSError, ValueError, KeyError) as error:
            self._end(handler, str(error))

    def _change(self, handler: Handler, events: int) -> None:
        if handler in self._handlers:
            with suppress(OSError, ValueError, KeyError):
                self._selector.modify(handler.socket, events, handler)

    def _remove(self, handler: Handler, *, close: bool) -> None:
        if handler in self._handlers:
            self._handlers.discard(handler)
            with suppress(OSError, ValueError, KeyError):
                self._selector.unregister(handler.socket)
        if close:
            handler.socket.close()

    def _end(self, handler: Handler, cause: str) -> None:
        self._remove(handler, close=True)
        handler.failed(cause)

    def _run(self) -> None:
        try:
            while not self._closing:
                left = self._times[0][0] - time.monotonic() if self._times else None
                for key, events in self._selector.select(None if left is None else max(0.0, left)):
                    if key.data is None:
                        with suppress(OSError):
                            self._woken.recv(4096)
                    else:
                        self._handle(key.data, events)
                self._call_what_is_due()
        finally:
            for handler in tuple(self._handlers):
                self._end(handler, "the node is closed")
            self._ended = True  # what is posted from here on is called by who posts it
            self._call_posted()
            self._selector.close()
            self._wake.close()
            self._woken.close()

    def _handle(self, handler: Handler, events: int) -> None:
        try:
            if events & selectors.EVENT_WRITE and not handler.writable():
                self._change(handler, selectors.EVENT_READ)
            if events & selectors.EVENT_READ and handler in self._handlers:
                handler.readable()
        except BlockingIOError:
            pass
        except Exception as error:  # noqa: BLE001 - of one peer: the others do not notice
            self._end(handler, str(error) or type(error).__name__)

    def _call_what_is_due(self) -> None:
        self._call_posted()
        while self._times and self._times[0][0] <= time.monotonic():
            self._call(heapq.heappop(self._times)[2])

    def _call_posted(self) -> None:
        with suppress(IndexError):
            while True:
                self._call(self._posted.popleft())

    @staticmethod
    def _call(action: Callable[[], object]) -> None:
        try:
            action()
        except Exception:  # noqa: BLE001 - the others do not notice
            _log.exception("an action of the loop raised")
