"""One WebSocket connection: read at a bounded rate, written from its outbox, cut off when stuck."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import time
from collections.abc import Callable
from typing import Protocol

from websockets.exceptions import ConnectionClosed
from websockets.frames import CloseCode

from uoarm._raised import Log, foreign
from uoarm._support.aio_deadlines import result_within
from uoarm.model import BudgetUse
from uoarm.server._limits import Limits
from uoarm.server.access import (
    ApprovalError,
    Audit,
    Credentials,
    Grant,
    Operation,
    Supervision,
)
from uoarm.server.session._connection import TurnConnection, address_of
from uoarm.server.session._incoming import FrameDecoder, RateLimiter
from uoarm.server.session._stateless_clients import AdmittedClient
from uoarm.server.streams import Account, Outbox, acting

_log = Log("uoarm.server")
_TURN_SECONDS = 0.001
_WRITE_OCTETS = 2**16
"""Written in one go: small frames cost a third of the time then; a reply waits for no more."""


class Session(Protocol):
    """What a protocol does with a client's frames. Called in the loop's thread; must not wait."""

    def octets(self, frame: str | bytes) -> int:
        """Return how much `decode` would have to decode, with what came before the frame."""

    def decode(self, frame: str | bytes, spending: BudgetUse) -> tuple[Callable[[], None], int]:
        """Return what is to be done about a frame, in the loop; answers then go to the outbox.

        And how many octets of memory its message holds, which `Client.in_hand` says meanwhile.

        Called in any thread, for one frame after the other. What it, or the action, raises ends the
        connection: a mistake of the client is to be answered.

        Args:
            frame: text or octets, at most `Limits.message_bytes`.
            spending: counts what its message costs, against the budget for one message.
        """

    def close(self) -> None:
        """Give back everything that only this client used."""


class ConnectedClient(AdmittedClient):
    """Transport of one client, the same for every protocol.

    Args:
        socket: after its handshake.
        grant: its rights, and whose it is.

    Attributes:
        is_cut: whether the server ended its connection.
        is_kept: whether its session outlives a drop of its connection.
        is_leaving: set when its connection goes on with another session.
        has_dropped: whether its connection ended without a word.
        in_hand: octets of memory that the message holds which is being acted on.
    """

    def __init__(
        self,
        socket: TurnConnection,
        credentials: Credentials,
        grant: Grant,
        limits: Limits,
        decoder: FrameDecoder,
        account: Account,
        audit: Audit,
        supervision: Supervision,
    ) -> None:
        super().__init__(grant, limits, account, audit)
        self.credentials = credentials
        self._supervision = supervision
        self._decoder = decoder
        self.outbox = Outbox(limits.queue_bytes, limits.control_messages, account)
        self.received = 0
        self.is_cut = False
        self.is_kept = False
        self.is_leaving = False
        self.has_dropped = False
        self.in_hand = 0
        self._socket = socket
        self._writing_since: float | None = None
        self._closing: set[asyncio.Task[None]] = set()

    @property
    def address(self) -> str:
        return address_of(self._socket)

    @property
    def unread_octets(self) -> int:
        """Octets that arrived and were not read yet."""
        return self._socket.unread_octets

    def require(self, operation: Operation, function: str) -> None:
        """Refuse what its role does not allow, and what it may do with an approval only.

        Raises:
            DeniedError: it may not.
        """
        needs = self.role.supervised and self._supervision.reason(operation, function)
        if needs:
            self._audit.note(self.identity, self.role, operation, function, allowed=False)
            raise ApprovalError(
                f"role {self.role.name!r} is supervised and needs an approval, which it asks for "
                f"by the Model Context Protocol only: {needs}"
            )
        super().require(operation, function)

    def note_release(self, cause: str = "") -> None:
        """Write to the audit log that it released, or why that failed."""
        self._audit.released(self.identity, self.role.name, cause)

    async def run(
        self,
        session: Session,
        socket: TurnConnection,
        soon: Callable[[Callable[[], None]], object],
    ) -> None:
        """Serve until the client or the server ends the connection, or another session goes on.

        Args:
            session: acts on what comes.
            socket: after its handshake.
            soon: runs an action in the loop, after what happens there now.
        """
        self._socket = socket
        self.outbox.write_with(self._write_now, soon)
        acting.set(self.account)
        socket.charge_to(self.account)
        self.has_dropped = False
        self.outbox.renew()
        writer = asyncio.ensure_future(self._write())
        try:
            await self._read(session)
            if self.is_leaving:
                await result_within(self.limits.handshake_seconds, self.outbox.emptied())
        except ConnectionClosed as error:
            is_closed = error.rcvd is not None or error.sent is not None  # by one of the sides
            self.has_dropped = not self.is_cut and not is_closed
        except asyncio.TimeoutError:
            self.cut("it does not read its replies")
        finally:
            writer.cancel()
            with contextlib.suppress(asyncio.CancelledError, ConnectionClosed):
                await writer
            self.outbox.write_with(None, None)
            self._writing_since = None
            socket.charge_to(None)

    def check(self, now: float) -> None:
        """Cut the client off when it has not read for too long, or left too many replies."""
        since = self._writing_since
        unread = self.outbox.unread_seconds() if since is None else now - since
        if self.outbox.overflowed:
            self.cut("it does not read its replies")
        elif unread > self.limits.stall_seconds:
            if self.is_kept:
                self.release()
            else:
                self.cut(f"it has read nothing for {unread:.0f} s")

    def release(self) -> None:
        """End the connection as if it had dropped."""
        self._socket.transport.abort()

    def dismiss(self, cause: str) -> None:
        """Close properly, with a closing handshake that is not waited for here."""
        if self.is_cut:
            return
        self.is_cut = True
        closing = asyncio.ensure_future(self._socket.close(CloseCode.POLICY_VIOLATION, cause))
        self._closing.add(closing)
        closing.add_done_callback(self._closing.discard)

    def cut(self, cause: str) -> None:
        """End the connection at once, without a closing handshake."""
        _log.warning("client %s at %s is cut off: %s", self.identity, self.address, cause)
        self.is_cut = True
        self._socket.transport.abort()

    async def _read(self, session: Session) -> None:
        began = time.monotonic()
        rates = RateLimiter(self.limits, began)
        while True:
            frame = await self._socket.next_message()
            self.received += 1
            octets = len(frame)
            spending = await self._take(session, frame)
            del frame  # the error that ends this loop would keep it, and may itself be kept long
            if self.is_leaving:
                return
            if self.outbox.overflowed:
                self.cut("it does not read its replies")
                return
            wait = rates.spend(time.monotonic(), octets=octets, elements=spending.elements)
            if wait or time.monotonic() - began >= _TURN_SECONDS:
                await asyncio.sleep(wait)
                began = time.monotonic()

    async def _take(self, session: Session, frame: str | bytes) -> BudgetUse:
        """Act on one frame; returns what it cost."""
        spending = BudgetUse(self.limits.budget)
        decode = functools.partial(foreign, session.decode, frame, spending)
        octets = foreign(session.octets, frame)
        act, self.in_hand = await self._decoder.run(octets, decode)
        foreign(act)
        return spending

    def _write_now(self) -> bool:
        """Write what waits, as `_write` does; False where that may have to wait for something."""
        socket, outbox = self._socket, self.outbox
        if not socket.takes_at_once():
            return False
        socket.send_now(outbox.take(_WRITE_OCTETS))
        if not socket.takes_at_once() or outbox.may_ping:
            return False
        outbox.note_written()
        return outbox.empty

    async def _write(self) -> None:
        while True:
            frames = await self.outbox.next(_WRITE_OCTETS)
            self._writing_since = time.monotonic()
            await self._socket.send_frames(frames)
            answered = self.outbox.begin_ping()
            if answered is not None:
                pong = asyncio.ensure_future(await self._socket.ping())
                pong.add_done_callback(functools.partial(_take_pong, answered))
            self._writing_since = None


def _take_pong(answered: Callable[[], None], pong: asyncio.Future[float]) -> None:
    """Have the answer to a ping taken; none comes where the connection has ended."""
    if not pong.cancelled() and pong.exception() is None:
        answered()
