"""What a node listens on: calls of its API, and connections of subscribers and clients."""

from __future__ import annotations

import socket
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from uoarm_ros1._loop import Handler, Loop
from uoarm_ros1._protocol import (
    Fault,
    FrameReader,
    HttpReader,
    ProtocolError,
    decode_call,
    decode_header,
    encode_reply,
    http_reply,
)

__all__ = ["Server"]

_MOST_STRANGERS = 256
"""Connections at a time whose header has not come, and of callers of the API."""

_ARRIVAL_SECONDS = 5.0
_IDLE_SECONDS = 600.0
_MAX_HEADER_OCTETS = 1 << 20
_MAX_CALL_OCTETS = 8 << 20
_MAX_UNREAD_OCTETS = 16 << 20
_CHUNK = 65_536
_BACKLOG = 128

Answer = Callable[[str, list[Any]], Any]
Arrived = Callable[[socket.socket, dict[str, str]], None]


class Server:
    """Two listening sockets of one address.

    Args:
        loop: that watches them.
        address: on which they listen.
        answer: makes of a method and its arguments what it returns; in the loop's thread.
        arrived: takes a connection, which does not block, and its header; in the loop's thread.

    Attributes:
        api_port: for calls of the API.
        port: for connections of TCPROS.
    """

    def __init__(self, loop: Loop, address: str, answer: Answer, arrived: Arrived) -> None:
        self._loop = loop
        self._strangers = _Count(_MOST_STRANGERS)
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
        self._listeners = (
            _Listener(sockets[0], loop, self._strangers, lambda given: _Api(*given, answer)),
            _Listener(sockets[1], loop, self._strangers, lambda given: _Arriving(*given, arrived)),
        )
        for listener in self._listeners:
            loop.add(listener)


class _Count:
    """How many there are, and the most that may be; used in the loop's thread alone."""

    def __init__(self, most: int) -> None:
        self.most = most
        self.now = 0


Given = tuple[socket.socket, Loop, _Count]


class _Listener(Handler):
    """Takes connections, and closes those that are too many."""

    def __init__(
        self,
        listening: socket.socket,
        loop: Loop,
        strangers: _Count,
        make: Callable[[Given], _Stranger],
    ) -> None:
        super().__init__(listening)
        self._loop, self._strangers, self._make = loop, strangers, make

    def readable(self) -> None:
        try:
            connection, _ = self.socket.accept()
        except BlockingIOError:
            return
        except OSError:
            # No descriptor is left, or the peer is gone again: others may be closed meanwhile.
            self._loop.pause(self, 0.1)
            return
        if self._strangers.now >= self._strangers.most:
            connection.close()
            return
        with suppress(OSError):
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._loop.add(self._make((connection, self._loop, self._strangers)))


class _Stranger(Handler):
    """A connection that has a time limit."""

    def __init__(
        self, connection: socket.socket, loop: Loop, strangers: _Count, seconds: float
    ) -> None:
        super().__init__(connection)
        self._loop, self._strangers = loop, strangers
        self._is_over = False
        strangers.now += 1
        loop.later(seconds, self._time_over)

    def failed(self, cause: str) -> None:
        del cause
        self._leave()

    def _leave(self) -> None:
        if not self._is_over:
            self._is_over = True
            self._strangers.now -= 1

    def _time_over(self) -> None:
        if not self._is_over:
            self._leave()
            self._loop.discard(self)


class _Api(_Stranger):
    """Calls of the API, one after the other, on one connection."""

    def __init__(
        self, connection: socket.socket, loop: Loop, strangers: _Count, answer: Answer
    ) -> None:
        # A master keeps its connections for the next call; one that is idle too long is closed.
        super().__init__(connection, loop, strangers, _IDLE_SECONDS)
        self._reader = HttpReader(_MAX_CALL_OCTETS)
        self._answer = answer
        self._out = bytearray()
        self._ends = False
        self._calls = 0
        loop.later(_ARRIVAL_SECONDS, lambda: self._look(0))

    def readable(self) -> None:
        octets = self.socket.recv(_CHUNK)
        if not octets:
            raise ConnectionError("closed")
        for message in self._reader.received(octets):
            self._calls += 1
            try:
                method, arguments = decode_call(message.body)
                body = encode_reply(self._answer(method, arguments))
            except (ProtocolError, ValueError) as error:
                body = encode_reply(Fault(str(error)))
            self._ends = self._ends or not message.keeps
            self._out += http_reply(body, keeps=message.keeps)
        if len(self._out) > _MAX_UNREAD_OCTETS:
            raise ProtocolError("it does not read its answers")
        if self._out and self.writable():
            self._loop.write(self)

    def writable(self) -> bool:
        with suppress(BlockingIOError):
            while self._out:
                del self._out[: self.socket.send(self._out)]
        if not self._out and self._ends:
            self._leave()
            self._loop.discard(self)
        return bool(self._out)

    def _look(self, calls: int) -> None:
        """Close what began to say something and does not go on."""
        if self._is_over:
            return
        if calls == self._calls and (not self._reader.is_between_messages or self._out):
            self._time_over()
            return
        before = self._calls
        self._loop.later(_ARRIVAL_SECONDS, lambda: self._look(before))


class _Arriving(_Stranger):
    """A connection of TCPROS until its header has come."""

    def __init__(
        self, connection: socket.socket, loop: Loop, strangers: _Count, arrived: Arrived
    ) -> None:
        super().__init__(connection, loop, strangers, _ARRIVAL_SECONDS)
        self._reader = FrameReader(_MAX_HEADER_OCTETS)
        self._arrived = arrived

    def readable(self) -> None:
        count = self.socket.recv_into(self._reader.buffer())
        if not count:
            raise ConnectionError("closed")
        frames = self._reader.received(count)
        if not frames:
            return
        if len(frames) > 1 or not self._reader.is_between_frames:
            raise ProtocolError("it goes on before its header is answered")
        header = decode_header(frames[0])
        self._leave()
        self._loop.release(self)
        try:
            self._arrived(self.socket, header)
        except BaseException:
            self.socket.close()
            raise
