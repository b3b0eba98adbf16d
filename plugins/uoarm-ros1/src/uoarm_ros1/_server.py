"""What a node listens on, and the one thread that waits for its sockets and for times."""

from __future__ import annotations

import heapq
import logging
import selectors
import socket
import threading
import time
import weakref
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from itertools import count
from typing import Any

from uoarm.bridge import LimitedLog, TurnCounter, Turns, close_in_children, on_failure
from uoarm.model import Budget
from uoarm_ros1._tcpros import ProtocolError, TcprosReader, decode_header
from uoarm_ros1._xmlrpc import Fault, HttpReader, decode_call, encode_reply, http_reply

_log = logging.getLogger("uoarm.ros1")
_JOIN_SECONDS = 2.0


class Handler(ABC):
    """What the loop calls for one socket, in its own thread.

    Must implement `readable`. May implement `writable` and `failed`. Where nothing was there to
    take, `readable` must raise BlockingIOError, so that the loop counts a turn for nothing.
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


class SocketLoop:
    """The thread. Every method may be called from any thread, and returns at once but `close`."""

    def __init__(self, name: str) -> None:
        self._records = LimitedLog(_log)
        self._selector = selectors.DefaultSelector()
        self._wake, self._woken = socket.socketpair()
        for end in (self._wake, self._woken):
            end.setblocking(False)
        self._selector.register(self._woken, selectors.EVENT_READ)
        self._posted: deque[Callable[[], object]] = deque()
        self._times: list[tuple[float, int, Callable[[], object]]] = []
        self._numbers = count()
        self._counter = TurnCounter()
        self._closing = self._ended = False
        self._handlers: set[Handler] = set()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def turns(self) -> Turns:
        """How often the thread has turned, and how often for nothing."""
        return self._counter.turns

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
        close_in_children(handler.socket)
        self.post(lambda: self._add(handler))

    def write(self, handler: Handler) -> None:
        """Call `writable` of a handler when its socket takes octets."""
        self.post(lambda: self._change(handler, selectors.EVENT_READ | selectors.EVENT_WRITE))

    def discard(self, handler: Handler) -> None:
        """Watch a socket no more, and close it."""
        self.post(lambda: self._remove(handler, close=True))

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
                ready = self._selector.select(None if left is None else max(0.0, left))
                worked = not ready  # then a time has come
                for key, events in ready:
                    if key.data is None:
                        worked = True
                        with suppress(OSError):
                            self._woken.recv(4096)
                    else:
                        worked |= self._handle(key.data, events)
                self._call_what_is_due()
                rest = self._counter.add(empty=not worked)
                if rest:
                    time.sleep(rest)
        finally:
            for handler in tuple(self._handlers):
                self._end(handler, "the node is closed")
            self._ended = True  # what is posted from here on is called by who posts it
            self._call_posted()
            self._selector.close()
            self._wake.close()
            self._woken.close()

    def _handle(self, handler: Handler, events: int) -> bool:
        """Have a socket read and written; returns whether there was anything to do."""
        try:
            if events & selectors.EVENT_WRITE and not handler.writable():
                self._change(handler, selectors.EVENT_READ)
            if events & selectors.EVENT_READ and handler in self._handlers:
                handler.readable()
        except BlockingIOError:
            return False
        except Exception as error:  # noqa: BLE001 - of one peer: the others do not notice
            self._end(handler, str(error) or type(error).__name__)
        return True

    def _call_what_is_due(self) -> None:
        self._call_posted()
        while self._times and self._times[0][0] <= time.monotonic():
            self._call(heapq.heappop(self._times)[2])

    def _call_posted(self) -> None:
        with suppress(IndexError):
            while True:
                self._call(self._posted.popleft())

    def _call(self, action: Callable[[], object]) -> None:
        try:
            action()
        except Exception as error:  # noqa: BLE001 - the others do not notice
            self._records.write(logging.ERROR, "an action of the loop raised", error)


_MOST_STRANGERS = 256
"""Connections at a time whose header has not come, and of callers of the API."""

_ARRIVAL_SECONDS = 5.0
_IDLE_SECONDS = 600.0
_MAX_HEADER_OCTETS = 1 << 20
# A call may hold the description of a robot, a text; the loop waits while its values are read.
_CALL_BUDGET = Budget(octets=8 << 20, elements=20_000, depth=64)
_MAX_UNREAD_OCTETS = 16 << 20
_MOST_HELD_OCTETS = 32 << 20
_CHUNK = 65_536
_BACKLOG = 128

Answer = Callable[[str, list[Any]], Any]
Arrived = Callable[[socket.socket, dict[str, str]], None]


class NodeServer:
    """Two listening sockets of one address.

    Args:
        address: on which they listen.
        answer: makes of a method and its arguments what it returns; in the loop's thread.
        unread: takes the body of a call that cannot be read; in the loop's thread.
        arrived: takes a connection, which does not block, and its header; in the loop's thread.

    Attributes:
        api_port: for calls of the API.
        port: for connections of TCPROS.
    """

    def __init__(
        self,
        loop: SocketLoop,
        address: str,
        answer: Answer,
        arrived: Arrived,
        unread: Callable[[bytes], object] = lambda _: None,
    ) -> None:
        self._loop = loop
        self._unidentified = _UnidentifiedConnections(loop)
        family = socket.AF_INET6 if ":" in address else socket.AF_INET
        sockets = []
        try:
            for _ in range(2):
                sockets.append(socket.socket(family, socket.SOCK_STREAM))
                sockets[-1].bind((address, 0))
                sockets[-1].listen(_BACKLOG)
        except OSError:
            for opened in sockets:
                opened.close()
            raise
        self.api_port, self.port = (opened.getsockname()[1] for opened in sockets)
        kinds: tuple[Callable[[Given], _UnidentifiedConnection], ...] = (
            lambda given: _Api(*given, answer, unread),
            lambda given: _Arriving(*given, arrived),
        )
        self._listeners = [
            _Listener(opened, loop, self._unidentified, make)
            for opened, make in zip(sockets, kinds, strict=True)
        ]
        for listener in self._listeners:
            loop.add(listener)


class _UnidentifiedConnections:
    """Connections that have not said yet what they are for, and callers of the API.

    They share one room, which is bounded in number and in octets: who has been silent longest, or
    holds most, makes room for the others. Used in the loop's thread alone.
    """

    def __init__(self, loop: SocketLoop) -> None:
        self._loop = loop
        self._held: dict[
            _UnidentifiedConnection, int
        ] = {}  # octets by connection, the latest to say a word last
        self._octets = 0

    def enter(self, stranger: _UnidentifiedConnection) -> None:
        """Take one in; another may have to go."""
        if len(self._held) >= _MOST_STRANGERS:
            self._turn_away(next(iter(self._held)))
        self._held[stranger] = 0

    def spoke(self, stranger: _UnidentifiedConnection, octets: int) -> None:
        """Take note that one said a word, and of how much of it waits now."""
        if stranger not in self._held:
            return
        self._octets += octets - self._held.pop(stranger)
        self._held[stranger] = octets
        while self._octets > _MOST_HELD_OCTETS:
            self._turn_away(max(self._held, key=self._held.__getitem__))

    def has(self, stranger: _UnidentifiedConnection) -> bool:
        """Whether one is still here."""
        return stranger in self._held

    def leave(self, stranger: _UnidentifiedConnection) -> bool:
        """Let one go; returns whether it was still here."""
        octets = self._held.pop(stranger, None)
        self._octets -= octets or 0
        return octets is not None

    def _turn_away(self, stranger: _UnidentifiedConnection) -> None:
        self.leave(stranger)
        self._loop.discard(stranger)


Given = tuple[socket.socket, SocketLoop, _UnidentifiedConnections]


class _Listener(Handler):
    """Takes connections."""

    def __init__(
        self,
        listening: socket.socket,
        loop: SocketLoop,
        unidentified: _UnidentifiedConnections,
        make: Callable[[Given], _UnidentifiedConnection],
    ) -> None:
        super().__init__(listening)
        self._loop, self._unidentified, self._make = loop, unidentified, make

    def readable(self) -> None:
        try:
            connection, _ = self.socket.accept()
        except BlockingIOError:
            raise  # the peer is gone again
        except OSError:
            # No descriptor is left, or the peer is gone again: others may be closed meanwhile.
            self._loop.pause(self, 0.1)
            return
        with suppress(OSError):
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._loop.add(self._make((connection, self._loop, self._unidentified)))


class _UnidentifiedConnection(Handler):
    """A connection that has a time limit, and a share of the room for all of its kind."""

    def __init__(
        self,
        connection: socket.socket,
        loop: SocketLoop,
        unidentified: _UnidentifiedConnections,
    ) -> None:
        super().__init__(connection)
        self._loop, self._unidentified = loop, unidentified
        unidentified.enter(self)
        self._look_later()

    def failed(self, cause: str) -> None:
        del cause
        self._unidentified.leave(self)

    def _look_later(self) -> None:
        # Not kept for it: what has ended is gone at once, with all that came over it.
        look = weakref.WeakMethod(self._look)
        self._loop.later(_ARRIVAL_SECONDS, lambda: (alive := look()) and alive())

    def _look(self) -> None:
        """Close what is late."""
        self._turn_away()

    def _turn_away(self) -> None:
        if self._unidentified.leave(self):
            self._loop.discard(self)


class _Api(_UnidentifiedConnection):
    """Calls of the API, one after the other, on one connection."""

    def __init__(
        self,
        connection: socket.socket,
        loop: SocketLoop,
        unidentified: _UnidentifiedConnections,
        answer: Answer,
        unread: Callable[[bytes], object],
    ) -> None:
        super().__init__(connection, loop, unidentified)
        # A master keeps its connections for the next call.
        self._until = time.monotonic() + _IDLE_SECONDS
        self._reader = HttpReader(_CALL_BUDGET.octets)
        self._answer, self._unread = answer, unread
        self._out = bytearray()
        self._ends = False
        self._calls = self._seen = 0

    def readable(self) -> None:
        octets = self.socket.recv(_CHUNK)
        if not octets:
            raise ConnectionError("closed")
        messages = self._reader.received(octets)
        for message in messages:
            self._calls += 1
            try:
                method, arguments = decode_call(message.body, _CALL_BUDGET)
                body = encode_reply(self._answer(method, arguments))
            except (ProtocolError, ValueError) as error:
                body = encode_reply(Fault(str(error)))
                self._unread(message.body)
            self._ends = self._ends or not message.keeps
            self._out += http_reply(body, keeps=message.keeps)
            if len(self._out) > _MAX_UNREAD_OCTETS:  # hundreds of calls may come in one piece
                raise ProtocolError("it does not read its answers")
        if self._out and self.writable():
            self._loop.write(self)
        self._unidentified.spoke(self, self._reader.held + len(self._out))

    def writable(self) -> bool:
        with suppress(BlockingIOError):
            while self._out:
                del self._out[: self.socket.send(self._out)]
        if not self._out and self._ends:
            self._turn_away()
        return bool(self._out)

    def _look(self) -> None:
        """Close what began to say something and does not go on, and what is here too long."""
        is_between = self._reader.is_between_messages and not self._out
        stands_still = self._seen == self._calls and not is_between
        if stands_still or time.monotonic() >= self._until:
            self._turn_away()
        elif self._unidentified.has(self):
            self._seen = self._calls
            self._look_later()


class _Arriving(_UnidentifiedConnection):
    """A connection of TCPROS until its header has come."""

    def __init__(
        self,
        connection: socket.socket,
        loop: SocketLoop,
        unidentified: _UnidentifiedConnections,
        arrived: Arrived,
    ) -> None:
        super().__init__(connection, loop, unidentified)
        self._reader = TcprosReader(_MAX_HEADER_OCTETS)
        self._arrived = arrived

    def readable(self) -> None:
        count = self.socket.recv_into(self._reader.buffer())
        if not count:
            raise ConnectionError("closed")
        frames = self._reader.received(count)
        self._unidentified.spoke(self, self._reader.held)
        if not frames:
            return
        if len(frames) > 1 or not self._reader.is_between_frames:
            raise ProtocolError("it goes on before its header is answered")
        header = decode_header(frames[0])
        if not self._unidentified.leave(self):
            return
        self._loop.release(self)
        with on_failure(self.socket.close):
            self._arrived(self.socket, header)
