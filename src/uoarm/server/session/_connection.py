"""One socket of the server: read in small turns, so that no client keeps the loop for itself."""

from __future__ import annotations

import asyncio
import socket
import struct
import time
import zlib
from collections import deque
from collections.abc import Iterable
from contextlib import suppress
from functools import lru_cache
from typing import Any

from websockets.asyncio.server import ServerConnection
from websockets.extensions.permessage_deflate import (
    PerMessageDeflate,
    ServerPerMessageDeflateFactory,
)
from websockets.frames import DATA_OPCODES, Frame, Opcode
from websockets.http11 import Request

__all__ = ["DEFLATE", "TurnConnection", "address_of", "host_of"]

DEFLATE = ServerPerMessageDeflateFactory(
    server_no_context_takeover=True, client_no_context_takeover=True
)
"""The extension permessage-deflate (RFC 7692), with nothing kept from one message to the next."""

_SLICE = 2048
"""Octets given to the parser in one go: 300 frames without content, which are parsed in 3 ms."""
_TURN_SECONDS = 0.001
_UNKNOWN = "unknown"
_CONTROL_PER_SECOND = 200.0
_LARGE = 2**16
_UNSENT_OCTETS = 2**16
"""What the kernel takes beyond what is under way, of a client that gets small messages only."""
_ALL_OCTETS = 2**31 - 1
_UNSENT_LIMIT: int | None = getattr(socket, "TCP_NOTSENT_LOWAT", None)
_WHOLE = 0x80
_COMPRESSED = 0x40
_DEFLATED = range(512, 2**15)
"""Octets of texts that are compressed: longer ones are pictures mostly, and would keep the loop."""
_DEFLATE_LEVEL = 1
_EMPTY_BLOCK = 4
_OPCODES = Opcode.BINARY, Opcode.TEXT  # by whether it is text


class TurnConnection(ServerConnection):
    """A connection that is known from its first byte on, and refused when there are too many.

    What arrives is parsed for a millisecond at a time; what is left waits for the loop's next turn,
    with the socket unread meanwhile. Pings and pongs beyond 200 a second make the client be read
    more slowly: each ping costs an answer, and no well-behaved client sends them by the thousand.

    Args:
        sockets: all connections of the server, this one among them while it lasts.
        limit: how many there may be.
        arguments: of `ServerConnection`.
        options: of `ServerConnection`.
    """

    def __init__(
        self, sockets: set[TurnConnection], limit: int, *arguments: Any, **options: Any
    ) -> None:
        super().__init__(*arguments, **options)
        self._sockets = sockets
        self._limit = limit
        self._unread: deque[bytes] = deque()
        self._begin = 0
        self._timer: asyncio.Handle | None = None
        self._full = False
        self._allowance = _CONTROL_PER_SECOND
        self._counted = time.monotonic()
        self._gets_large = False

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin; see `asyncio.Protocol`."""
        super().connection_made(transport)
        self.recv_messages.pause = self._hold
        self.recv_messages.resume = self._go_on
        self._sockets.add(self)
        self._limit_unsent(_UNSENT_OCTETS)
        if len(self._sockets) > self._limit:
            self.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """End; see `asyncio.Protocol`."""
        self._sockets.discard(self)
        self._unread.clear()
        if self._timer is not None:
            self._timer.cancel()
        super().connection_lost(exc)

    async def send_frames(self, frames: Iterable[tuple[bytes, bool]]) -> None:
        """Send messages, each with whether it is text, with one write to the socket.

        Waits until the socket takes more. Only one task may send. Of what goes to many clients no
        copy is made for each, as the library would: nothing masks it. Where that was negotiated,
        texts are compressed, for each client anew.

        Raises:
            ConnectionClosed: the connection is closed.
        """
        contents = [(content, _WHOLE | _OPCODES[text]) for content, text in frames]
        for extension in self.protocol.extensions:
            assert isinstance(extension, PerMessageDeflate), "no other is negotiated"
            bits = extension.local_max_window_bits
            contents = [_deflated(content, first, bits) for content, first in contents]
        async with self.send_context():
            writes = self.protocol.writes
            for content, first in contents:
                if len(content) >= _LARGE and not self._gets_large:
                    self._gets_large = True
                    self._limit_unsent(_ALL_OCTETS)
                writes.append(_head(len(content), first))
                if content:  # nothing stands for the end of the stream
                    writes.append(content)

    def send_data(self) -> None:
        """Write what the protocol has to send; see `websockets.asyncio.connection.Connection`."""
        waiting = self.protocol.writes
        if len(waiting) < 2 or b"" in waiting:  # noqa: PLR2004 - the latter is the stream's end
            super().send_data()
            return
        small: list[bytes] = []
        for one in self.protocol.data_to_send():
            if len(one) < _LARGE:
                small.append(one)
            else:  # joining it to others would copy it
                self.transport.write(b"".join(small))
                self.transport.write(one)
                small.clear()
        if small:
            self.transport.write(b"".join(small))

    @property
    def unread_octets(self) -> int:
        """Octets that arrived and that no session has read."""
        parsed = sum(len(one.data) for one in self.recv_messages.frames.queue)
        return parsed + sum(map(len, self._unread)) - self._begin

    def data_received(self, data: bytes) -> None:
        """Take what arrived; see `asyncio.Protocol`."""
        self._unread.append(data)
        if self._timer is None:
            self._turn()

    def process_event(self, event: Frame | Request) -> None:  # type: ignore[override]
        """Count a frame, and let the library act on it."""
        if isinstance(event, Frame) and event.opcode not in DATA_OPCODES:
            self._allowance -= 1
        super().process_event(event)

    def _turn(self) -> None:
        """Parse for a moment."""
        self._timer = None
        end = time.perf_counter() + _TURN_SECONDS
        while self._unread and not self._full and self._pause() <= 0:
            super().data_received(self._next_slice())
            if time.perf_counter() >= end:
                break
        if self.transport.is_closing():
            return
        if not self._unread:
            if not self._full:
                self.transport.resume_reading()
            return
        self.transport.pause_reading()
        if not self._full:
            self._timer = self.loop.call_later(max(0.0, self._pause()), self._turn)

    def _limit_unsent(self, octets: int) -> None:
        """Have the kernel keep no more than this unsent, where it can be told.

        Its own limit grows to megabytes, seconds of small messages for a client that reads slowly;
        what waits here instead can be dropped when it is old. Large messages need it: in small
        portions half as many go through.
        """
        if _UNSENT_LIMIT is not None:
            near = self.transport.get_extra_info("socket")
            with suppress(OSError):  # it was closed meanwhile
                near.setsockopt(socket.IPPROTO_TCP, _UNSENT_LIMIT, octets)

    def _next_slice(self) -> bytes:
        first, begin = self._unread[0], self._begin
        self._begin = begin + _SLICE
        if self._begin >= len(first):
            self._unread.popleft()
            self._begin = 0
        return first[begin : begin + _SLICE]

    def _pause(self) -> float:
        """Return the seconds until another control frame may come; none are left at 0."""
        now = time.monotonic()
        earned = (now - self._counted) * _CONTROL_PER_SECOND
        self._allowance = min(_CONTROL_PER_SECOND, self._allowance + earned)
        self._counted = now
        return -self._allowance / _CONTROL_PER_SECOND

    def _hold(self) -> None:
        """Parse nothing more: enough messages wait for the session."""
        self._full = True

    def _go_on(self) -> None:
        self._full = False
        if self._timer is None:
            self._timer = self.loop.call_soon(self._turn)


@lru_cache(1024)
def _head(length: int, first: int) -> bytes:
    """Return what stands before the content of a message that is one unmasked frame."""
    if length < 126:  # noqa: PLR2004 - three forms of the length, RFC 6455, 5.2
        return struct.pack("!BB", first, length)
    if length < 2**16:
        return struct.pack("!BBH", first, 126, length)
    return struct.pack("!BBQ", first, 127, length)


def _deflated(content: bytes, first: int, bits: int) -> tuple[bytes, int]:
    """Return a frame's content and first octet, compressed where that makes a text shorter.

    As RFC 7692 has it (7.2.1): the empty block at the end is left out.
    """
    if first != _WHOLE | Opcode.TEXT or len(content) not in _DEFLATED:
        return content, first
    packer = zlib.compressobj(_DEFLATE_LEVEL, wbits=-bits)
    shorter = (packer.compress(content) + packer.flush(zlib.Z_SYNC_FLUSH))[:-_EMPTY_BLOCK]
    return (shorter, first | _COMPRESSED) if len(shorter) < len(content) else (content, first)


def host_of(connection: ServerConnection) -> str:
    """Return the host alone."""
    name = connection.remote_address
    return str(name[0]) if isinstance(name, tuple) else _UNKNOWN


def address_of(connection: ServerConnection) -> str:
    """Return `host:port`."""
    name = connection.remote_address
    return ":".join(str(part) for part in name[:2]) if isinstance(name, tuple) else _UNKNOWN
