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
_MOST_HELD_OCTETS = 32 << 20
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
        self._strangers = _Strangers(loop)
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


class _Strangers:
    """Connections that have not said yet what they are for, and callers of the API.

    They share one room, which is bounded in number and in octets: who has been silent longest, or
    holds most, makes room for the others. Used in the loop's thread alone.
    """

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._held: dict[_Stranger, int] = {}  # octets by connection, the latest to say a word last
        self._octets = 0

    def enter(self, stranger: _Stranger) -> None:
        """Take one in; another may have to go."""
        if len(self._held) >= _MOST_STRANGERS:
            self._turn_away(next(iter(self._held)))
        self._held[stranger] = 0

    def spoke(self, stranger: _Stranger, octets: int) -> None:
        """Take note that one said a word, and of how much of it waits now."""
        if stranger not in self._held:
            return
        self._octets += octets - self._held.pop(stranger)
        self._held[stranger] = octets
        while self._octets > _MOST_HELD_OCTETS:
            self._turn_away(max(self._held, key=self._held.__getitem__))

    def has(self, stranger: _Stranger) -> bool:
        """Whether one is still here."""
        return stranger in self._held

    def leave(self, stranger: _Stranger) -> bool:
        """Let one go; returns whether it was still here."""
        octets = self._held.pop(stranger, None)
        self._octets -= octets or 0
        return octets is not None

    def _turn_away(self, stranger: _Stranger) -> None:
        self.leave(stranger)
        self._loop.discard(stranger)


Given = tuple[socket.socket, Loop, _Strangers]


class _Listener(Handler):
    """Takes connections."""

    def __init__(
        self,
        listening: socket.socket,
        loop: Loop,
        strangers: _Strangers,
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
        with suppress(OSError):
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._loop.add(self._make((connection, self._loop, self._strangers)))


class _Stranger(Handler):
    """A connection that has a time limit, and a share of the room for all of its kind."""

    def __init__(
        self, connection: socket.socket, loop: Loop, strangers: _Strangers, seconds: float
    ) -> None:
        super().__init__(connection)
        self._loop, self._strangers = loop, strangers
        strangers.enter(self)
        loop.later(seconds, self._turn_away)

    def failed(self, cause: str) -> None:
        del cause
        self._strangers.leave(self)

    def _turn_away(self) -> None:
        if self._strangers.leave(self):
            self._loop.discard(self)


class _Api(_Stranger):
    """Calls of the API, one after the other, on one connection."""

    def __init__(
        self, connection: socket.socket, loop: Loop, strangers: _Strangers, answer: Answer
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
        messages = self._reader.received(octets)
        for message in messages:
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
        self._strangers.spoke(self, self._reader.held + len(self._out))

    def writable(self) -> bool:
        with suppress(BlockingIOError):
            while self._out:
                del self._out[: self.socket.send(self._out)]
        if not self._out and self._ends:
            self._turn_away()
        return bool(self._out)

    def _look(self, calls: int) -> None:
        """Close what began to say something and does not go on."""
        if calls == self._calls and (not self._reader.is_between_messages or self._out):
            self._turn_away()
            return
        before = self._calls
        if self._strangers.has(self):
            self._loop.later(_ARRIVAL_SECONDS, lambda: self._look(before))


class _Arriving(_Stranger):
    """A connection of TCPROS until its header has come."""

    def __init__(
        self, connection: socket.socket, loop: Loop, strangers: _Strangers, arrived: Arrived
    ) -> None:
        super().__init__(connection, loop, strangers, _ARRIVAL_SECONDS)
        self._reader = FrameReader(_MAX_HEADER_OCTETS)
        self._arrived = arrived

    def readable(self) -> None:
        count = self.socket.recv_into(self._reader.buffer())
        if not count:
            raise ConnectionError("closed")
        frames = self._reader.received(count)
        self._strangers.spoke(self, self._reader.held)
        if not frames:
            return
        if len(frames) > 1 or not self._reader.is_between_frames:
            raise ProtocolError("it goes on before its header is answered")
        header = decode_header(frames[0])
        if not self._strangers.leave(self):
            return
        self._loop.release(self)
        try:
            self._arrived(self.socket, header)
        except BaseException:
            self.socket.close()
            raise
