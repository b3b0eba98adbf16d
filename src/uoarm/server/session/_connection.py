"""One socket of the server: read in small turns, so that no client keeps the loop for itself."""

from __future__ import annotations

import asyncio
import socket
import struct
import sys
import time
import zlib
from collections import Counter, deque
from collections.abc import Generator, Iterable, Iterator
from contextlib import suppress
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed, InvalidHandshake
from websockets.extensions.permessage_deflate import PerMessageDeflate
from websockets.frames import DATA_OPCODES, CloseCode, Frame, Opcode
from websockets.http11 import Request
from websockets.protocol import State

from uoarm._raised import Log
from uoarm._support.aio_deadlines import result_within
from uoarm.server._limits import Limits
from uoarm.server.session._incoming import IncomingError, IncomingFrames, ParsingTurns, Turn
from uoarm.server.streams import Account

if TYPE_CHECKING:
    from websockets.typing import BytesLike  # not in the oldest version

_log = Log("uoarm.server")
_SLICE = 2048
"""Octets given to the parser in one go: 300 frames without content, which are parsed in 3 ms."""
_TURN_SECONDS = 0.00025
_SMALL_FRAGMENT = 1024
_READ_OCTETS = 2**16
"""Read of a socket in one turn of the loop: of 200 that have more it is 200 times as much."""
_HEAD_OCTETS = 2**16
"""Of a handshake, and of what follows it before its answer."""
_ALWAYS_OCTETS = 2**16
"""Taken from each client, whatever is held for others: `Stop` is never refused for want of room."""
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


class Sockets:
    """All connections of one server, from their first octet on.

    Where there are too many, the address that has most gives way to others: with the oldest of its
    handshakes that are not finished.

    Args:
        limit: how many there may be.
        limits: of what one of them brings.

    Attributes:
        turns: in which what they bring is parsed and unpacked.
    """

    def __init__(self, limit: int, limits: Limits) -> None:
        self.limit = limit
        self.limits = limits
        self.turns = ParsingTurns()
        self._all: dict[TurnConnection, str] = {}
        self._of_host: Counter[str] = Counter()

    def __iter__(self) -> Iterator[TurnConnection]:
        return iter(tuple(self._all))

    def add(self, connection: TurnConnection) -> None:
        """Take a connection that was made, or refuse it when there are too many."""
        host = self._all[connection] = host_of(connection)
        self._of_host[host] += 1
        if len(self._all) > self.limit:
            self._refused(connection, host).transport.abort()

    def _refused(self, newest: TurnConnection, host: str) -> TurnConnection:
        largest, most = self._of_host.most_common(1)[0]
        if self._of_host[host] == most:
            return newest
        unfinished = (
            connection
            for connection, its_host in self._all.items()
            if its_host == largest
            and connection.protocol.state is State.CONNECTING
            and not connection.transport.is_closing()
        )
        return next(unfinished, newest)

    def discard(self, connection: TurnConnection) -> None:
        host = self._all.pop(connection, None)
        if host is not None:
            self._of_host[host] -= 1
            if not self._of_host[host]:
                del self._of_host[host]


class TurnConnection(ServerConnection):
    """A connection that is known from its first byte on, and refused when there are too many.

    What arrives is parsed for a quarter of a millisecond at a time; what is left waits for the
    loop's next turn, with the socket unread meanwhile. Pings, pongs and small fragments beyond 200
    a second make the client be read more slowly: each costs an answer or a turn, and no
    well-behaved client sends them by the thousand.

    All that has arrived and was not acted on is charged to the account of the client, from the
    first octet of a message on. Its messages come from `next_message`, not from `recv`.

    Args:
        sockets: all connections of the server, this one among them while it lasts.
        arguments: of `ServerConnection`.
        options: of `ServerConnection`.
    """

    def __init__(self, sockets: Sockets, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._sockets = sockets
        self._limits = sockets.limits
        self._unread: deque[bytes] = deque()
        self._unparsed = 0  # octets of these
        self._head = 0  # octets that came before the connection was open
        self._begin = 0
        self._turn = Turn(self._parse)
        self._timer: asyncio.Handle | None = None
        self._stopped: float | None = None  # since when; nothing is parsed until something is taken
        self._is_refused = False
        self._allowance = _CONTROL_PER_SECOND
        self._counted = time.monotonic()
        self._gets_large = False
        self._incoming = IncomingFrames(self._limits.message_bytes, sockets.turns.do)
        self._in_hand = 0  # octets of the message that was taken last
        self._began: float | None = None  # when what is unfinished did
        self._taker: asyncio.Future[None] | None = None
        self._account: Account | None = None
        self._needed = 0  # octets that the parser waits for
        reader = self.protocol.reader
        self._read_exact = reader.read_exact
        setattr(reader, "read_exact", self._need)  # noqa: B010 - a method of this one alone

    def _need(self, octets: int) -> Generator[None, None, bytes | bytearray]:
        self._needed = octets
        return self._read_exact(octets)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin; see `asyncio.Protocol`."""
        super().connection_made(transport)
        if hasattr(transport, "max_size"):  # asyncio's own: what is read in one go
            transport.max_size = _READ_OCTETS
        self._limit_unsent(_UNSENT_OCTETS)
        self._sockets.add(self)

    def connection_lost(self, exc: Exception | None) -> None:
        """End; see `asyncio.Protocol`. What came whole can be taken still."""
        self._sockets.discard(self)
        self._unread.clear()
        self._unparsed = 0
        if self._timer is not None:
            self._timer.cancel()
        super().connection_lost(exc)
        if not self.transport.is_closing():  # as of TLS with CPython 3.10
            self.transport.close()
        self.protocol.reader.discard()
        self._incoming.drop_unfinished()
        self._count()
        self._wake()

    async def handshake(self, *arguments: Any, **options: Any) -> None:
        """Do the opening handshake when it is its turn; see `ServerConnection`."""
        head = (self.request_rcvd, self.connection_lost_waiter)
        await asyncio.wait(head, return_when=asyncio.FIRST_COMPLETED)
        if self.request is not None:
            await self._sockets.turns.open(self._turn, host_of(self))
        # What is no handshake is raised by websockets 15 and 16, which log a traceback of each.
        with suppress(InvalidHandshake):
            await super().handshake(*arguments, **options)

    async def keepalive(self) -> None:
        """Cut the client off, without a close frame, when it does not answer a ping in time."""
        if self.ping_interval is None or self.ping_timeout is None:
            return
        with suppress(ConnectionClosed):
            while True:
                await asyncio.sleep(self.ping_interval)
                try:
                    await result_within(self.ping_timeout, self._pinged())
                except asyncio.TimeoutError:
                    _log.warning("%s is cut off: it answers no ping", address_of(self))
                    self.transport.abort()
                    return

    async def _pinged(self) -> None:
        await (await self.ping())

    def charge_to(self, account: Account | None) -> None:
        """Charge what arrives to an account from now on, and nothing more to the one before.

        With None no reader takes what came of a connection that has ended: it is let go.
        """
        if self._account is not None:
            self._account.arrived.resize(0)
        self._account = account
        self._in_hand = 0
        if account is None and self.protocol.state is State.CLOSED:
            self._incoming.clear()
        self._count()
        self._go_on()

    async def next_message(self) -> str | bytes:
        """Return the next message; the one before counts as acted on.

        Raises:
            ConnectionClosed: no more will come.
        """
        self._in_hand = 0
        self._count()
        while True:
            taken = self._incoming.take()
            if taken is not None:
                self._go_on()
                message = self._decoded(*taken)
                if message is not None:
                    self._in_hand = sys.getsizeof(message)
                    self._count()
                    return message
            elif self.protocol.state is State.CLOSED and not self._incoming.is_packed:
                await asyncio.shield(self.connection_lost_waiter)
                raise self.protocol.close_exc
            self._taker = self.loop.create_future()
            try:
                await self._taker
            finally:
                self._taker = None

    def check(self, now: float) -> None:
        """Refuse a message that does not end."""
        seconds = self._limits.message_seconds
        is_ours = self._stopped is not None or self._turn.is_waiting  # who takes so long
        if self._began is not None and not is_ours and now - self._began > seconds:
            text = f"a message was not finished within {seconds:g} s"
            self._refuse(CloseCode.POLICY_VIOLATION, text)

    async def send_frames(self, frames: Iterable[tuple[bytes, bool]]) -> None:
        """Send messages, each with whether it is text, with one write to the socket.

        Waits until the socket takes more. Only one task may send. Of what goes to many clients no
        copy is made for each, as the library would: nothing masks it. Where that was negotiated,
        texts are compressed, for each client anew.

        Raises:
            ConnectionClosed: the connection is closed.
        """
        async with self.send_context():
            self._add_frames(frames)

    def takes_at_once(self) -> bool:
        """Say whether `send_now` may be called: it is open, and nothing waits to be written."""
        return self.protocol.state is State.OPEN and not self.transport.get_write_buffer_size()

    def send_now(self, frames: Iterable[tuple[bytes, bool]]) -> None:
        """Send messages as `send_frames` does, without waiting until the socket takes more."""
        self._add_frames(frames)
        self.send_data()

    def _add_frames(self, frames: Iterable[tuple[bytes, bool]]) -> None:
        contents = [(content, _WHOLE | _OPCODES[text]) for content, text in frames]
        for extension in self.protocol.extensions:
            assert isinstance(extension, PerMessageDeflate), "no other is negotiated"
            bits = extension.local_max_window_bits
            contents = [_deflated(content, first, bits) for content, first in contents]
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
        for chunk in self.protocol.data_to_send():
            if len(chunk) < _LARGE:
                small.append(chunk)
            else:  # joining it to others would copy it
                self.transport.write(b"".join(small))
                self.transport.write(chunk)
                small.clear()
        if small:
            self.transport.write(b"".join(small))

    @property
    def unread_octets(self) -> int:
        """Octets that arrived and that no session has read."""
        return self._unparsed + len(self.protocol.reader.buffer) + self._incoming.octets

    def data_received(self, data: bytes) -> None:
        """Take what arrived; see `asyncio.Protocol`."""
        if self._is_refused:
            return
        if self.protocol.state is State.CONNECTING:
            self._head += len(data)
            if self._head > _HEAD_OCTETS:
                self.transport.abort()
                return
        self._unread.append(data)
        self._unparsed += len(data)
        self._count()
        if self._timer is None and self._stopped is None:
            self._sockets.turns.ask(self._turn)
        if self._turn.is_waiting:
            self.transport.pause_reading()

    def process_event(self, event: Frame | Request) -> None:  # type: ignore[override]
        """Take a data frame, or count another one and let the library act on it."""
        if not isinstance(event, Frame):
            super().process_event(event)
            return
        if event.opcode not in DATA_OPCODES:
            self._allowance -= 1
            super().process_event(event)
        else:
            is_whole = event.fin and event.opcode is not Opcode.CONT
            if len(event.data) < _SMALL_FRAGMENT and not is_whole:
                self._allowance -= 1
            self._incoming.add(event)
        if not self._incoming.is_within_message:
            self._began = None

    def _parse(self) -> bool:
        """Parse and unpack for a moment; returns whether to go on, when it is its turn again."""
        end = time.perf_counter() + _TURN_SECONDS
        try:
            while time.perf_counter() < end:
                if self._incoming.is_packed:
                    self._incoming.unpack()
                elif self._unread and not self._incoming.is_full and self._pause() <= 0:
                    super().data_received(self._next_slice())
                else:
                    break
        except IncomingError as error:
            self._refuse(error.code, str(error))
        self._wake()
        self._count()
        if self._incoming.is_packed:
            return True
        if self._is_refused or self.transport.is_closing():
            return False
        is_within = self._incoming.is_within_message or self._unread or self.protocol.reader.buffer
        if self._began is None and is_within:
            self._began = time.monotonic()
        if not self._unread and not self._incoming.is_full:
            self.transport.resume_reading()
            return False
        self.transport.pause_reading()
        if self._incoming.is_full:
            self._stopped = time.monotonic()
            return False
        if (pause := self._pause()) > 0:
            self._timer = self.loop.call_later(pause, self._ask)
            return False
        return True

    def _ask(self) -> None:
        self._timer = None
        self._sockets.turns.ask(self._turn)

    def _limit_unsent(self, octets: int) -> None:
        """Have the kernel keep no more than this unsent, where it can be set.

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
        # What belongs to the frame that has begun is no work for the parser.
        octets = max(_SLICE, self._needed - len(self.protocol.reader.buffer))
        self._begin = begin + octets
        if self._begin >= len(first):
            self._unread.popleft()
            self._begin = 0
        portion = first[begin : begin + octets]
        self._unparsed -= len(portion)
        return portion

    def _pause(self) -> float:
        """Return the seconds until another control frame may come; none are left at 0."""
        now = time.monotonic()
        earned = (now - self._counted) * _CONTROL_PER_SECOND
        self._allowance = min(_CONTROL_PER_SECOND, self._allowance + earned)
        self._counted = now
        return -self._allowance / _CONTROL_PER_SECOND

    def _go_on(self) -> None:
        """Parse again where what waited was in the way."""
        if self._stopped is None or self._incoming.is_full:
            return
        if self._began is not None:  # it was not its client that was slow
            self._began += time.monotonic() - self._stopped
        self._stopped = None
        self._sockets.turns.ask(self._turn)

    def _wake(self) -> None:
        """Have a waiting reader look again, where there is a message or none will come."""
        if (
            self._taker is not None
            and not self._taker.done()
            and (self._incoming.is_ready or self.protocol.state is State.CLOSED)
        ):
            self._taker.set_result(None)

    def _decoded(self, content: BytesLike, is_text: bool) -> str | bytes | None:  # noqa: FBT001
        """Return a message as the session gets it; None: it is none."""
        try:
            return str(content, "utf-8") if is_text else bytes(content)
        except UnicodeDecodeError as error:
            self._refuse(CloseCode.INVALID_DATA, f"{error.reason} at position {error.start}")
            return None

    def _count(self) -> None:
        """Charge what is held to the client, which is refused where no share has room for it."""
        if self._account is None:
            return
        held = self.unread_octets + self._in_hand
        is_more = held > max(self._account.arrived.octets, _ALWAYS_OCTETS)
        self._account.arrived.resize(held)
        if is_more and not self._is_refused and not self._account.has_share:
            self._refuse(CloseCode.TRY_AGAIN_LATER, "the server holds as much as it may")

    def _refuse(self, code: CloseCode, text: str) -> None:
        """Close for what came, with a word and without waiting for the client."""
        _log.warning("%s is cut off: %s", address_of(self), text)
        self._is_refused = True
        self._unread.clear()
        self._unparsed = self._begin = 0
        self._incoming.clear()
        self._began = self._stopped = None
        if self._account is not None:
            self._account.arrived.resize(self._in_hand)
        if self.protocol.state is not State.OPEN:
            self.transport.abort()
            return
        self.protocol.fail(code, text)
        self.protocol.reader.discard()
        self.send_data()
        # What more it sends is not read: to throw it away would cost as much as to take it.
        self.transport.pause_reading()
        abort = partial(self._sockets.turns.do, self.transport.abort)
        self.loop.call_later(self.close_timeout or 0.0, abort)


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
    name = connection.remote_address
    return str(name[0]) if isinstance(name, tuple) else _UNKNOWN


def address_of(connection: ServerConnection) -> str:
    name = connection.remote_address
    return ":".join(str(part) for part in name[:2]) if isinstance(name, tuple) else _UNKNOWN
