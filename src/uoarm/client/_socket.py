"""The WebSocket of a client: messages are handed over as they come, and written in any thread."""

from __future__ import annotations

import asyncio
import secrets
import socket
import ssl
import struct
import threading
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any, TypeAlias

from typing_extensions import Self
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import (
    ConnectionClosed,
    ConnectionClosedOK,
    InvalidHandshake,
    InvalidURI,
)
from websockets.frames import DATA_OPCODES, CloseCode, Frame, Opcode
from websockets.protocol import Event, State
from websockets.typing import Subprotocol

from uoarm._secrets import without_secrets
from uoarm._wire import Form
from uoarm.bridge import close_in_children, redirection
from uoarm.errors import UsageError

if TYPE_CHECKING:
    from websockets.typing import BytesLike  # not in the oldest version

try:
    from websockets.speedups import apply_mask
except ImportError:  # it was built without a compiler
    from websockets.utils import apply_mask

Received: TypeAlias = "str | bytes | bytearray"
Take: TypeAlias = Callable[[Received], object]
_RESET = struct.pack("ii", 1, 0)  # SO_LINGER: on, for no time
_GOODBYE_SECONDS = 1.5  # for which a server that does not answer holds up the end
_MOST_WAITING = 16
_MOST_FRAGMENTS = 65_536
_WHOLE_BINARY, _MASKED = 0x80 | Opcode.BINARY, 0x80


class ClientSocket(ClientConnection):
    """A connection without tasks between the socket and who takes its messages.

    The library wakes a task for each message, and each writer of one waits for its turn in the
    loop. Here a message is handed over in the turn of the loop in which its octets came, and
    `try_send` writes in the thread of its caller. All other methods are for the loop's thread.
    """

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._waiting: deque[Received] = deque()  # until they are taken, or handed over
        self._fragments: list[bytes] = []
        self._is_text = False
        self._taker: asyncio.Future[None] | None = None
        self._take: Take | None = None
        self._ended: asyncio.Future[None] | None = None
        self._discards = False
        self._cause: Exception | None = None  # of its end
        self._came_at = self.loop.time()
        # Guards what is written, between the loop and threads that write by themselves: a frame
        # goes out whole before the next begins. Held for as long as the kernel takes octets
        # without waiting; reentrant, since a transport with TLS that is closed within a write calls
        # back for the end of the stream.
        self._writing = threading.RLock()
        self._near: socket.socket | None = None  # a second descriptor, for these threads
        self._is_lost = False
        # Of a frame that the kernel took a part of; goes before all others.
        self._rest: list[bytes | memoryview] = []

    @classmethod
    async def open(
        cls,
        url: str,
        form: Form,
        headers: Mapping[str, str],
        tls: ssl.SSLContext | None,
        largest: int,
        *,
        timeout: float,
        silence: float,
    ) -> Self:
        """Connect to a server, within `timeout` seconds.

        Args:
            url: `ws://` or `wss://`.
            form: in which messages are; a text is compressed.
            headers: of the handshake.
            tls: for `wss://`, where the system's authorities do not do.
            largest: octets of a message that is taken.
            timeout: seconds for the handshake.
            silence: seconds without a sign of life after which the connection counts as dropped.

        Raises:
            OSError, TimeoutError, websockets.exceptions.InvalidHandshake, UsageError: as `connect`
                says.
        """
        # None would mean that there is to be no TLS.
        secured: Any = {} if tls is None else {"ssl": tls}
        try:
            opened = await connect(
                url,
                create_connection=cls,
                subprotocols=[Subprotocol(form.subprotocol)],
                additional_headers=headers,
                max_size=largest,
                compression="deflate" if form.text else None,
                open_timeout=timeout,
                ping_interval=silence / 3,
                ping_timeout=silence * 2 / 3,
                close_timeout=_GOODBYE_SECONDS,
                **secured,
            )
        except OSError:  # also a certificate that is not trusted, which is a ValueError, too
            raise
        except (InvalidURI, ValueError) as error:
            if where := redirection(error, url):  # as for a path without the slash at its end
                raise InvalidHandshake(where) from error
            wanted = "url: expected ws://HOST:PORT/ or wss://HOST:PORT/"
            raise UsageError(f"{wanted}: {without_secrets(str(error))}") from error
        assert isinstance(opened, cls), "as it was asked to make"
        return opened

    async def next_message(self) -> Received:
        """Return the next message, before any is handed over.

        Raises:
            ConnectionClosed: no more will come.
        """
        while not self._waiting:
            if self.protocol.state is State.CLOSED:
                await asyncio.shield(self.connection_lost_waiter)
                raise self._end()
            self._taker = self.loop.create_future()
            try:
                await self._taker
            finally:
                self._taker = None
        message = self._waiting.popleft()
        if not self.transport.is_closing():
            self.transport.resume_reading()
        return message

    async def hand_over(self, take: Take) -> None:
        """Have each message taken as it comes, until the connection was closed in order.

        Raises:
            ConnectionClosedError: it ended otherwise.
            Exception: what `take` raised; nothing is taken after it.
        """
        self._ended = self.loop.create_future()
        self._take = take
        try:
            while self._waiting and self._take is not None:
                self._hand(self._waiting.popleft())
            if not self.transport.is_closing():
                self.transport.resume_reading()
            if not self._ended.done():
                ends = (self._ended, self.connection_lost_waiter)
                await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
            if self._ended.done():
                self._ended.result()
            with suppress(ConnectionClosedOK):
                raise self._end()
        finally:
            self._take, self._discards = None, True
            self._ended.cancel()

    def _end(self) -> ConnectionClosed:
        """Return how it ended, with the cause; the library's own name for it has changed."""
        error = self.protocol.close_exc
        error.__cause__ = self._cause
        return error

    async def send_whole(self, content: bytes, *, text: bool) -> None:
        """Send one message, and wait only where the socket does not take more; raises as `send`."""
        is_open = self.protocol.state is State.OPEN and not self.transport.is_closing()
        if self.paused or not is_open:
            await self.send(content, text=text)
            return
        if text:
            self.protocol.send_text(content)
        else:
            self.protocol.send_binary(content)
        self.send_data()

    def try_send(self, content: bytes) -> bool:
        """Write one binary message in this thread, whichever it is, and wait for nothing.

        False where nothing was written: the connection is not open, has TLS, or others wait to be
        written before.
        """
        frame = _masked(content)
        with self._writing:
            near = self._to_write()
            if near is None:
                return False
            try:
                sent = near.sendmsg(frame)
            except OSError:  # it takes nothing now; or the loop learns of the error, too
                return False
            for part in frame:
                if sent < len(part):
                    self._rest.append(memoryview(part)[sent:])
                sent = max(0, sent - len(part))
            if self._rest:
                self.loop.call_soon_threadsafe(self.send_data)
        return True

    def _to_write(self) -> socket.socket | None:
        """Return what a thread may write to, which holds the lock; None: the loop must."""
        transport = self.transport
        if self._is_lost or self._rest or self.protocol.state is not State.OPEN:
            return None
        if transport.is_closing() or transport.get_write_buffer_size():
            return None
        if self._near is None and transport.get_extra_info("sslcontext") is None:
            self._near = transport.get_extra_info("socket").dup()
            self._near.setblocking(False)
            close_in_children(self._near)
        return self._near

    async def keepalive(self) -> None:
        """Drop the connection when nothing comes any more, not even what answers a ping.

        Without a word: the library would say goodbye to who does not answer, and wait for that for
        seconds more; and a server that did get it would end the session. The answer to a ping may
        be behind much else, which is a sign of life, too.
        """
        interval, limit = self.ping_interval, self.ping_timeout
        if interval is None or limit is None:
            return
        with suppress(ConnectionClosed):
            while True:
                await asyncio.sleep(interval)
                answer = asyncio.ensure_future(await self.ping())
                while not answer.done() and (left := self.silent_at - self.loop.time()) > 0:
                    await asyncio.wait((answer,), timeout=left)
                if not answer.done():
                    self._cause = TimeoutError(f"nothing came for {interval + limit:g} s")
                    self.drop()
                    return

    @property
    def silent_at(self) -> float:
        """When the peer counts as silent, in seconds of the loop, unless something comes."""
        return self._came_at + (self.ping_interval or 0.0) + (self.ping_timeout or 0.0)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Begin; see `asyncio.BaseProtocol`.

        In a child that held the socket it would not be reset by `drop`, nor end with its parent.
        """
        near = getattr(transport.get_extra_info("socket"), "_sock", None)  # none of other loops
        if near is not None:
            close_in_children(near)
        super().connection_made(transport)

    def data_received(self, data: bytes) -> None:
        """Take what arrived; see `asyncio.Protocol`."""
        self._came_at = self.loop.time()
        super().data_received(data)

    def drop(self) -> None:
        """Break the connection, so that what it has not sent yet is never sent.

        The system keeps what the network has not taken and sends it when that is back, though the
        socket is closed; it throws it away only where the connection is reset.
        """
        if not self.transport.is_closing():
            near: socket.socket = self.transport.get_extra_info("socket")
            near.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
            self.transport.abort()

    def send_data(self) -> None:
        """Write what the protocol has to send; see `websockets.asyncio.connection.Connection`."""
        with self._writing:
            rest, self._rest = self._rest, []
            for part in rest:
                self.transport.write(part)
            super().send_data()

    def connection_lost(self, exc: Exception | None) -> None:
        """End; see `asyncio.Protocol`."""
        self._cause = self._cause or exc
        with self._writing:
            self._is_lost = True
            self._rest.clear()
            if self._near is not None:
                self._near.close()
                self._near = None
        super().connection_lost(exc)
        if not self.transport.is_closing():  # as of TLS with CPython 3.10
            self.transport.close()
        self._wake()

    def process_event(self, event: Event) -> None:
        """Take a data frame, or have the library act on another one."""
        if not isinstance(event, Frame) or event.opcode not in DATA_OPCODES:
            super().process_event(event)
            return
        if event.opcode is not Opcode.CONT:
            self._is_text = event.opcode is Opcode.TEXT
        if event.fin and not self._fragments:  # without a copy, where it need not be
            self._came(event.data)
            return
        self._fragments.append(bytes(event.data))
        if event.fin:
            content = b"".join(self._fragments)
            self._fragments.clear()
            self._came(content)
        elif len(self._fragments) > _MOST_FRAGMENTS:
            self._fragments.clear()
            self._refuse(CloseCode.MESSAGE_TOO_BIG, "too many fragments")

    def _came(self, content: BytesLike) -> None:
        if self._discards:  # nothing is waited for but the peer's goodbye, which is behind it
            return
        try:
            message: Received
            if self._is_text:
                message = str(content, "utf-8")
            else:
                message = bytes(content) if isinstance(content, memoryview) else content
        except UnicodeDecodeError as error:
            self._refuse(CloseCode.INVALID_DATA, f"{error.reason} at position {error.start}")
            return
        if self._take is not None:
            self._hand(message)
            return
        self._waiting.append(message)
        if len(self._waiting) > _MOST_WAITING:
            self.transport.pause_reading()
        self._wake()

    def _refuse(self, code: CloseCode, why: str) -> None:
        self._discards = True
        self.protocol.fail(code, why)
        self.send_data()

    def _hand(self, message: Received) -> None:
        assert self._take is not None, "set by who calls this"
        try:
            self._take(message)
        except BaseException as error:  # noqa: BLE001 - raised where the messages are waited for
            self._take, self._discards = None, True
            if self._ended is not None and not self._ended.done():
                self._ended.set_exception(error)

    def _wake(self) -> None:
        if self._taker is not None and not self._taker.done():
            self._taker.set_result(None)


def _masked(content: bytes) -> tuple[bytes, bytes]:
    """Return a whole frame in two parts: the library makes three copies of its content."""
    length, mask = len(content), secrets.token_bytes(4)
    if length < 126:  # noqa: PLR2004 - three forms of the length, RFC 6455, 5.2
        head = struct.pack("!BB", _WHOLE_BINARY, _MASKED | length)
    elif length < 2**16:
        head = struct.pack("!BBH", _WHOLE_BINARY, _MASKED | 126, length)
    else:
        head = struct.pack("!BBQ", _WHOLE_BINARY, _MASKED | 127, length)
    return head + mask, apply_mask(content, mask)
