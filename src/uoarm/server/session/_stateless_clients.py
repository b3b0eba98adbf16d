"""Clients that come with requests: admitted as any other, but with no connection of their own.

A protocol over plain HTTP has no session to hang rights, memory and limits on. So all requests with
the same credentials are of one client.
"""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from contextlib import asynccontextmanager
from http import HTTPStatus
from typing import Any

from attrs import define, field
from websockets.datastructures import Headers
from websockets.http11 import Request

from uoarm.model import StopReport
from uoarm.server._limits import Limits
from uoarm.server.access import (
    AccessRole,
    Admission,
    Audit,
    Credentials,
    Grant,
    Operation,
    RefusedError,
    WrongTokenError,
    hash_token,
    read_head,
)
from uoarm.server.session._incoming import RateLimiter
from uoarm.server.streams import Account, FeedRegistry, Shares, acting


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
            client = self._of(self._admission.admit(head, certificate or {}), address)
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
