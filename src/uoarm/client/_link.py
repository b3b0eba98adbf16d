"""The connection to a server: one WebSocket, and after a drop another one with the same session.

Where the session is gone, as after a restart of the server, a new one is begun, if that is wanted.
"""

from __future__ import annotations

import asyncio
import secrets
import threading
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

from attrs import define, field
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus
from websockets.frames import CloseCode

from uoarm._backoff import Backoff
from uoarm._raised import on_failure, text_of
from uoarm._support.aio_deadlines import result_within
from uoarm._wire import LARGEST, Form
from uoarm.bridge import boot_seconds
from uoarm.client._requests import KEPT, RESUMED, checked, error_of
from uoarm.client._socket import ClientSocket, Received
from uoarm.errors import (
    ConnectionClosedError,
    ControlMessageError,
    MessageError,
    UoarmError,
)
from uoarm.model import BudgetUse

# What reading a message raises that is none, or lacks what the protocol says it has.
_STRANGE = (ControlMessageError, AttributeError, LookupError, TypeError, ValueError)
CONNECTING_ERRORS = (OSError, ConnectionClosed, InvalidHandshake, asyncio.TimeoutError)
_KEEP, _RESUME = "keep", "resume"
_MOST_WAITING = 4096
_LONGEST_KEPT = 3600.0  # seconds for which a server is believed to keep a session
# Closed for what this client did or may not do: it would be so again.
_FINAL = frozenset({
    CloseCode.NORMAL_CLOSURE, CloseCode.PROTOCOL_ERROR, CloseCode.UNSUPPORTED_DATA,
    CloseCode.INVALID_DATA, CloseCode.POLICY_VIOLATION, CloseCode.MESSAGE_TOO_BIG,
    CloseCode.MANDATORY_EXTENSION,
})  # fmt: skip
# A proxy whose server is away, or a server that is full, answers with these.
_TRY_AGAIN = frozenset({429, 502, 503, 504})

Open = Callable[[], Awaitable[ClientSocket]]
Take = Callable[[Mapping[str, Any]], None]


def _backoff() -> Backoff:
    # Clients that lost the same server come back at different moments.
    return Backoff(first=0.05, most=5.0, jitter=0.5, seed=secrets.randbits(32))


@define(eq=False)
class Link:
    """Sends and receives control messages; all methods but `send_at_once` in one loop.

    Args:
        form: in which messages are.
        take: gets each message of the server but those about resuming.
        again_seconds: how long to try to begin a new session where this one is gone; 0: not at all.
        lost: called with why the session is gone, before a new one is begun.
        begun: called when a new one was.
        went_on: called with the server's counters of this client where the same one goes on, before
            anything of it comes.
        changed: called with why the connection dropped, at once, and with "" when messages pass
            again, in the same session or another.

    Attributes:
        place: the server, as errors name it.
        session: how many sessions were begun after the first.
        most: octets of a message that the server takes; None: it has not said so yet.
        trouble: why the connection dropped and is not there again yet; "": it is.
    """

    _open: Open
    _form: Form
    _take: Take
    _again_seconds: float = 0.0
    _lost: Callable[[str], object] = str
    _begun: Callable[[], None] = lambda: None
    _went_on: Callable[[Sequence[Mapping[str, Any]]], object] = len
    _changed: Callable[[str], object] = str
    place: str = field(default="the server", init=False)
    _socket: ClientSocket | None = field(default=None, init=False)
    _ready: asyncio.Event = field(factory=asyncio.Event, init=False)
    _unanswered: dict[str, None] = field(factory=dict, init=False)
    # Guards, between the loop and threads that send at once, over what is sent: what a thread
    # sent over the connection before is among the unanswered when the session is taken up.
    _changing: threading.Lock = field(factory=threading.Lock, init=False)
    _at_once: ClientSocket | None = field(default=None, init=False)  # None: the loop must send
    _key: str = field(default="", init=False)
    _seconds: float = field(default=0.0, init=False)
    _backoff: Backoff = field(factory=_backoff, init=False)
    _resume: bool = field(default=False, init=False)
    _is_final: bool = field(default=False, init=False)
    resumed: int = field(default=0, init=False)
    session: int = field(default=0, init=False)
    most: int | None = field(default=None, init=False)
    closed: str = field(default="", init=False)
    trouble: str = field(default="", init=False)

    async def start(self, *, resume: bool) -> None:
        """Connect; with `resume` ask the server to keep the session over drops."""
        self._socket = await self._open()
        self._begin_to_send()
        self._resume = resume
        if resume:
            with suppress(ConnectionClosed):  # so soon; `receive` finds it as it does a later end
                await self._write(self._socket, _timed(_KEEP))

    async def send(self, fields: Mapping[str, Any], session: int | None = None) -> None:
        """Send one message that will be answered; waits while the connection is renewed.

        Args:
            fields: of the message.
            session: in which alone it is sent; None: the one of now.

        Raises:
            MessageError: it has no form, or is longer than the server takes.
            ConnectionClosedError: it has ended for good; or another session was begun meanwhile:
                what was asked of the one before has failed, and is not done after that.
        """
        frame = self._framed(fields)
        session = self.session if session is None else session
        await self._ready.wait()
        if self.closed or self._socket is None:
            raise ConnectionClosedError(self.closed)
        if session != self.session:
            raise ConnectionClosedError("the server has begun anew meanwhile; it was not sent")
        self._unanswered[fields["id"]] = None
        try:
            await self._socket.send_whole(frame, text=self._form.text)
        except ConnectionClosed as error:
            if not self._key or session != self.session:
                raise ConnectionClosedError(f"{self.place} is gone: {error}") from error
            # Whether it arrived is known when the session goes on: then it has its answer.

    @property
    def holds_up(self) -> bool:
        """Whether `send` waits now: for another connection, or until the server reads."""
        return not self._ready.is_set() or (self._socket is not None and self._socket.paused)

    def send_at_once(self, fields: Mapping[str, Any], session: int) -> bool:
        """Send one message that will be answered, in this thread; in a session, and no other.

        Returns:
            False where it was not sent: it is to be sent with `send`.

        Raises:
            MessageError: it has no form, or is longer than the server takes.
        """
        if self._form.text:
            return False
        frame, identity = self._framed(fields), fields["id"]
        with self._changing:
            socket = self._at_once if session == self.session else None
            if socket is None:
                return False
            self._unanswered[identity] = None  # before its answer can come
            if socket.try_send(frame):
                return True
            self._unanswered.pop(identity, None)
        return False

    def _framed(self, fields: Mapping[str, Any]) -> bytes:
        frame = self._form.write(fields)
        if self.most is not None and len(frame) > self.most:
            # The server would end the connection for it, and all that is open in it.
            text = f"the message has {len(frame):,} octets; the server takes {self.most:,} at most"
            raise MessageError(text)
        return frame

    def _begin_to_send(self) -> None:
        self._ready.set()
        with self._changing:
            self._at_once = self._socket

    def _end_sending(self) -> None:
        self._ready.clear()
        with self._changing:
            self._at_once = None

    def is_unanswered(self, identity: str) -> bool:
        """Say whether a question was sent, or may have been, and its answer has not come."""
        return identity in self._unanswered

    async def run(self) -> None:
        """Read until the connection has ended for good; `closed` then says why."""
        try:
            while not self.closed:
                cause = await self._read()
                if cause and self._again_seconds and not self._is_final:
                    cause = await self._begin_anew(cause)
                self.closed = cause
        finally:
            self.closed = self.closed or "the client was closed"
            self._end_sending()
            self._ready.set()

    def drop(self) -> None:
        """Break the connection, so that what it has not sent yet is never sent; then go on."""
        if self._socket is not None:
            self._socket.drop()

    async def close(self) -> None:
        """Say goodbye, so that the server keeps nothing."""
        if self._socket is not None:
            await self._socket.close()

    async def _read(self) -> str:
        """Read one connection to its end; returns why nothing follows it, or nothing."""
        assert self._socket is not None, "start comes first"
        try:
            await self._socket.hand_over(self._take_frame)
        except ConnectionClosed as error:
            self._is_final = _is_for_good(error)
            if error.rcvd is not None or not self._key:
                return f"the connection to {self.place} ended: {error}"
            cause = f"the connection to {self.place} dropped: {error.__cause__ or error}"
            self._changed(cause)
            return await self._renew(cause)
        except _STRANGE as error:
            self._is_final = True
            await self._socket.close(CloseCode.PROTOCOL_ERROR)
            return self._strange(error)
        self._is_final = self._socket.close_code in _FINAL
        reason = self._socket.close_reason
        return f"{self.place} closed the connection" + (f": {reason}" if reason else "")

    async def _begin_anew(self, cause: str) -> str:
        """Begin another session; returns why that failed, or nothing."""
        self._end_sending()
        self._key = ""
        self._unanswered.clear()
        self._changed(cause)
        self._lost(cause)
        # After that: a thread that sees this one sees no stream as open that was of the one before.
        self.session += 1
        why = await self._retry(self._greet, self._again_seconds, cause)
        if not why:
            self._begin_to_send()
            self._changed("")
            self._begun()
        return why

    async def _greet(self) -> str:
        """Connect, and take the greeting of a new session; returns nothing."""
        socket = await self._open()
        with on_failure(socket.transport.abort):
            self._take_frame(await socket.next_message())
            if self._resume:
                await self._write(socket, _timed(_KEEP))
        self._socket = socket
        return ""

    async def _renew(self, cause: str) -> str:
        """Go on with the session over a new connection; returns why that failed, or nothing."""
        self._end_sending()
        why = await self._retry(self._go_on, self._seconds, cause)
        if not why:
            self.resumed += 1
            self._begin_to_send()
            self._changed("")
        return why

    async def _retry(
        self, attempt: Callable[[], Awaitable[str]], seconds: float, cause: str
    ) -> str:
        """Try for so many seconds, as long as it may succeed; returns why it has not, or nothing.

        Who is not let in any more is not let in a second later: another token is to be shown.
        """
        loop = asyncio.get_running_loop()
        deadline, failed = loop.time() + seconds, 0
        why = self.trouble = cause
        while loop.time() < deadline:
            try:
                refused = await result_within(deadline - loop.time(), attempt())
            except CONNECTING_ERRORS as error:
                why = self.trouble = f"{cause}; connecting again failed: {error}"
                if _is_for_good(error):
                    self._is_final = True
                    return why
                failed += 1
                await asyncio.sleep(min(self._backoff.pause(failed), deadline - loop.time()))
            except _STRANGE as error:
                self._is_final = True
                return f"{cause}; {self._strange(error)}"
            else:
                self.trouble = ""
                return f"{cause}; {refused}" if refused else ""
        return why

    async def _go_on(self) -> str:
        """Take the session up over a new connection; returns the server's refusal, or nothing."""
        socket = await self._open()
        with on_failure(socket.transport.abort):
            refused = await self._take_up(socket)
        if refused:
            await socket.close()
        else:
            self._socket = socket
        return refused

    async def _take_up(self, socket: ClientSocket) -> str:
        unanswered = list(self._unanswered)
        waiting, beyond = unanswered[:_MOST_WAITING], unanswered[_MOST_WAITING:]
        await socket.next_message()  # the greeting of a new session
        options = {"key": self._key, "waiting": waiting}
        await self._write(socket, {**_timed(_RESUME), "jsonMessage": options})
        while (report := self._fields(await socket.next_message())).get("id") != _RESUME:
            self._receive(report)
        message = report.get("jsonMessage")
        if report["op"] != "Reply":
            return str(error_of(message))
        self._went_on(checked(message, RESUMED, "Reply to Resume")["own"])
        for identity in beyond:
            lost = {"code": "closed", "text": "too much waited when the connection dropped"}
            self._receive({"op": "Error", "id": identity, "jsonMessage": lost})
        return ""

    def _take_frame(self, frame: Received) -> None:
        self._receive(self._fields(frame))

    def _fields(self, frame: Received) -> Mapping[str, Any]:
        return self._form.read(frame, BudgetUse(LARGEST), with_numpy=True)

    def _receive(self, received: Mapping[str, Any]) -> None:
        identity = received.get("id")
        if identity == _KEEP:
            if received["op"] == "Reply":
                kept = checked(received.get("jsonMessage"), KEPT, "Reply to Resume")
                self._key, self._seconds = kept["key"], min(kept["seconds"], _LONGEST_KEPT)
            return
        if identity is not None:
            self._unanswered.pop(identity, None)
        self._take(received)

    def _strange(self, error: Exception) -> str:
        text = str(error) if isinstance(error, UoarmError) else text_of(error)
        return f"{self.place} sent what is no message: {text[:250]}"

    async def _write(self, socket: ClientSocket, fields: Mapping[str, Any]) -> None:
        await socket.send(self._form.write(fields), text=self._form.text)


def _is_for_good(error: Exception) -> bool:
    """Whether a server that ended or refused a connection would do so again."""
    if isinstance(error, InvalidStatus):
        return error.response.status_code not in _TRY_AGAIN
    return (
        isinstance(error, ConnectionClosed) and error.rcvd is not None and error.rcvd.code in _FINAL
    )


def _timed(identity: str) -> dict[str, Any]:
    """Return a question about the session, by whose time that of commands is known."""
    return {"op": "Resume", "id": identity, "x-sent": boot_seconds()}
