"""One client, whatever it speaks: over a WebSocket, or with requests that have no connection.

A WebSocket is read at a bounded rate, written from the outbox of its client, and cut off when it is
stuck. A protocol over plain HTTP has no session to hang rights, memory and limits on: so all its
requests with the same credentials are of one client.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import secrets
import time
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from contextlib import asynccontextmanager
from http import HTTPStatus
from typing import Any, Protocol

from attrs import define, evolve, field
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.frames import CloseCode
from websockets.http11 import Request

from uoarm._raised import Log, foreign
from uoarm._support.aio_deadlines import result_within
from uoarm.model import BudgetUse, StopReport
from uoarm.server._limits import Limits
from uoarm.server.access import (
    AccessRole,
    Admission,
    ApprovalError,
    Audit,
    Credentials,
    Grant,
    Operation,
    RefusedError,
    Supervision,
    WrongTokenError,
    hash_token,
    read_head,
)
from uoarm.server.session._connection import TurnConnection, address_of
from uoarm.server.session._incoming import FrameDecoder, RateLimiter
from uoarm.server.streams import Account, FeedRegistry, Outbox, Shares, acting


class AdmittedClient:
    """A client that was let in, whatever it speaks.

    Args:
        grant: its rights, and whose it is.

    Attributes:
        identity: name of the session, for logs and the client itself.
        principal: the person or program that it is of.
    """

    def __init__(self, grant: Grant, limits: Limits, account: Account, audit: Audit) -> None:
        self.identity = secrets.token_hex(6)
        self.principal = grant.principal
        self.role: AccessRole = grant.role
        self.limits = limits
        self.account = account
        self._audit = audit

    def require(self, operation: Operation, function: str) -> None:
        """Refuse what its role does not allow; the audit log has either outcome.

        Raises:
            DeniedError: it may not.
        """
        allowed = self.role.allows(operation, function)
        self._audit.note(self.identity, self.role, operation, function, allowed=allowed)
        self.role.require(operation, function)

    def require_all(self, operation: Operation) -> None:
        """Refuse what its role may not do to everything, as `require` does for a function."""
        allowed = self.role.allows_all(operation)
        self._audit.note(self.identity, self.role, operation, "*", allowed=allowed)
        self.role.require_all(operation)

    def note_stop(self, report: StopReport) -> None:
        """Write to the audit log what a stop came to that it asked for."""
        self._audit.stopped(self.identity, self.role.name, report)


class StatelessClient(AdmittedClient):
    """All requests with the same credentials. Made by `StatelessClients`.

    What needs an approval is not refused here: the front end asks for one.

    Attributes:
        has_ended: whether its rights have ended or changed: who comes then is another client.
    """

    def __init__(self, grant: Grant, limits: Limits, account: Account, audit: Audit) -> None:
        super().__init__(grant, limits, account, audit)
        self.has_ended = False
        self._rates = RateLimiter(limits, time.monotonic())
        self._on_end: list[Callable[[], None]] = []

    def on_end(self, action: Callable[[], None]) -> None:
        """Have something done when its rights have ended or the server stops."""
        self._on_end.append(action)

    def act(self) -> None:
        """Have what the task that calls does from now on count as done for this client."""
        acting.set(self.account)

    async def pace(self, octets: int, elements: int) -> None:
        """Wait as long as the rates of one client say that it comes too fast."""
        wait = self._rates.spend(time.monotonic(), octets=octets, elements=elements)
        if wait:
            await asyncio.sleep(wait)

    def end(self) -> None:
        """Let go of all that is held for it. Idempotent."""
        if not self.has_ended:
            self.has_ended = True
            actions, self._on_end = self._on_end, []
            for action in actions:
                action()
            self.account.close()
            self._audit.departure(self.identity)


@define(eq=False)
class StatelessClients:
    """The stateless clients of a server, in the thread of its loop.

    Args:
        connected: addresses of clients; each request counts as one while it lasts.
        refused: called for each request that is refused.
    """

    _admission: Admission
    _audit: Audit
    _registry: FeedRegistry
    _connected: Shares
    _refused: Callable[[], None]
    _clients: dict[Credentials, tuple[Grant, StatelessClient]] = field(factory=dict, init=False)

    @asynccontextmanager
    async def admitted(
        self,
        path: str,
        headers: Iterable[tuple[str, str]],
        certificate: Mapping[str, Any] | None,
        address: str,
    ) -> AsyncIterator[StatelessClient]:
        """Give the client of a request for as long as it lasts.

        Args:
            path: with the query.
            headers: names and values, as they came.
            certificate: of the client, as `ssl` has it.
            address: of the client.

        Raises:
            RefusedError: it is not let in; a wrong token is answered ever more slowly.
        """
        try:
            head = read_head(Request(path, Headers(headers)))
            self._admission.check_page(head)
            self._check_room(address)
            credentials = self._admission.admit(head, certificate or {})
            # All managers that import have the same rights: whichever of them it says it is.
            importer = "another manager" if credentials.importer else ""
            client = self._of(evolve(credentials, importer=importer), address)
        except RefusedError as error:
            self._refused()
            self._audit.arrival(address, "", "", str(error))
            if isinstance(error, WrongTokenError):
                await self._wait(address)
            raise
        self._connected.take(address)
        try:
            yield client
        finally:
            self._connected.take(address, -1)

    def local(self, token: str) -> StatelessClient:
        """Return the client at the standard input and output of this process.

        Raises:
            RefusedError: there is an access file, and the token is none of it.
        """
        credentials = Credentials(hash_token(token) if token else "")
        if self._admission.grant(credentials) is None:
            raise RefusedError(
                HTTPStatus.UNAUTHORIZED, "the access file has no such token: set UOARM_TOKEN"
            )
        return self._of(credentials, "stdio")

    def check(self) -> None:
        """End the clients whose rights have ended or changed."""
        for credentials, (grant, client) in list(self._clients.items()):
            if self._admission.grant(credentials) != grant:
                del self._clients[credentials]
                client.end()

    def close(self) -> None:
        for _, client in self._clients.values():
            client.end()
        self._clients.clear()

    def _check_room(self, address: str) -> None:
        if not self._connected.admits(address):
            raise RefusedError(HTTPStatus.SERVICE_UNAVAILABLE, "too many clients are connected")
        if self._connected.of(address) >= self._registry.limits.connections_per_address:
            raise RefusedError(
                HTTPStatus.TOO_MANY_REQUESTS, "too many requests of this address are under way"
            )

    def _of(self, credentials: Credentials, address: str) -> StatelessClient:
        grant = self._admission.grant(credentials)
        assert grant is not None, "it was admitted"
        known = self._clients.get(credentials)
        if known is not None and known[0] == grant:
            return known[1]
        if known is not None:
            known[1].end()
        registry = self._registry
        client = StatelessClient(grant, registry.limits, registry.memory.open(), self._audit)
        self._clients[credentials] = grant, client
        self._audit.arrival(address, client.identity, grant.role.name)
        return client

    async def _wait(self, address: str) -> None:
        pause = self._admission.wrong_tokens.begin(address, time.monotonic())
        if pause is None:
            raise RefusedError(HTTPStatus.TOO_MANY_REQUESTS, "too many wrong tokens")
        try:
            await asyncio.sleep(pause)
        finally:
            self._admission.wrong_tokens.end(address)


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
