"""What happens before a WebSocket is open: pages over HTTP, and opening handshakes."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from functools import cache
from http import HTTPStatus
from pathlib import Path
from weakref import WeakKeyDictionary

import orjson
from attrs import define, field, frozen
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.exceptions import NegotiationError
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from uoarm._origin import install_command
from uoarm._plugins import PluginProblem, installed, values_of
from uoarm._raised import text_of
from uoarm._wire import FORMS
from uoarm.server._failures import coded_text
from uoarm.server._limits import Limits
from uoarm.server.access import (
    Admission,
    Audit,
    Credentials,
    Operation,
    RefusedError,
    RequestHead,
    WrongTokenError,
    read_head,
)
from uoarm.server.front_end import CONTRACT_VERSION, FrontEnd, FrontEndHooks
from uoarm.server.http._metrics import Totals
from uoarm.server.session import address_of, host_of
from uoarm.server.streams import Shares

_GROUP = "uoarm.front_ends"
_KNOWN = {"foxglove": "uoarm-foxglove", "rosbridge": "uoarm-rosbridge"}


class FrontEnds:
    """Front ends that can be served, by name.

    One that fails to load is listed in `problems` and harms no other.

    Args:
        given: instead of the installed ones.
    """

    def __init__(self, given: Iterable[FrontEnd] | None = None) -> None:
        self._by_name: dict[str, FrontEnd] = {}
        self._problems: list[PluginProblem] = []
        if given is not None:
            for front_end in given:
                self._admit(front_end.name, front_end)
            return
        for point in sorted(installed(_GROUP), key=lambda point: point.name):
            try:
                answer = values_of(point, FrontEndHooks, "uoarm_front_ends", FrontEnd)
            except Exception as error:  # noqa: BLE001 - a broken plugin may raise anything
                self.drop(point.name, text_of(error))
                continue
            for front_end in answer:
                self._admit(point.name, front_end)

    @property
    def usable(self) -> tuple[FrontEnd, ...]:
        """Those that can be served."""
        return tuple(self._by_name.values())

    @property
    def problems(self) -> tuple[PluginProblem, ...]:
        """Those that cannot, each with its cause."""
        return tuple(self._problems)

    def at(self, path: str) -> FrontEnd | None:
        """Return the front end whose endpoint a path is."""
        return next(
            (
                front_end
                for front_end in self._by_name.values()
                if front_end.path == path and front_end.start is not None
            ),
            None,
        )

    def find(self, name: str) -> FrontEnd | None:
        """Return the front end of a name that can be served."""
        return self._by_name.get(name)

    def drop(self, name: str, cause: str) -> None:
        """Serve one no more, for a cause."""
        self._by_name.pop(name, None)
        self._problems.append(PluginProblem(name, cause))

    def missing(self, name: str) -> str:
        """Say why there is no front end of this name, and what to do."""
        for problem in self._problems:
            if problem.name == name:
                return f"the front end {name!r} cannot be used: {problem.cause}"
        if name in _KNOWN:
            return f"the front end {name!r} is not installed: {install_command(_KNOWN[name])}"
        there = ", ".join(self._by_name) or "none"
        return f"there is no front end {name!r} (installed: {there})"

    def _admit(self, plugin: str, one: FrontEnd) -> None:
        same = [other for other in self.usable if one.name == other.name or one.path == other.path]
        if one.contract != CONTRACT_VERSION:
            self._problems.append(
                PluginProblem(
                    plugin,
                    f"front end {one.name!r} implements contract version {one.contract}, "
                    f"this uoarm has version {CONTRACT_VERSION}: install matching versions",
                )
            )
        elif one.path in _OWN_PATHS:
            cause = f"front end {one.name!r} wants {one.path}, which is the server's own"
            self._problems.append(PluginProblem(plugin, cause))
        elif same:
            cause = f"front end {one.name!r} at {one.path} is already there: {same[0].summary}"
            self._problems.append(PluginProblem(plugin, cause))
        else:
            self._by_name[one.name] = one


_NATIVE_PATHS = frozenset({"/", "/uoarm"})
_OWN_PATHS = _NATIVE_PATHS | {"/healthz", "/metrics"}
_VERSIONS = "uoarm.v"
_TYPES = {
    ".css": "text/css; charset=utf-8",
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".mjs": "text/javascript; charset=utf-8",
    ".ts": "text/plain; charset=utf-8",
    ".svg": "image/svg+xml",
    ".txt": "text/plain; charset=utf-8",
    ".json": "application/json",
}
# A page served here may load what is served here, and talk to this server only.
_PAGE_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data:; object-src 'none'; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}


@frozen
class AcceptedHandshake:
    """A handshake that was accepted.

    Attributes:
        front_end: whose protocol the path asks for; None: the native one.
    """

    credentials: Credentials
    front_end: FrontEnd | None


@define(eq=False)
class HandshakeHandler:
    """Answers requests before the handshake; one for each port.

    Args:
        connected: addresses of the clients connected now, shared between ports.
        health: makes the answer of `/healthz`.
        metrics: makes the answer of `/metrics`.
        others: what other protocols are spoken; a single one has every path for its endpoint.
    """

    _admission: Admission
    _audit: Audit
    _limits: Limits
    _totals: Totals
    _connected: Shares
    _health: Callable[[], Mapping[str, object]] = field(kw_only=True)
    _metrics: Callable[[], Awaitable[bytes]] = field(kw_only=True)
    _others: FrontEnds | FrontEnd = field(kw_only=True)
    _entries: WeakKeyDictionary[ServerConnection, AcceptedHandshake] = field(
        factory=WeakKeyDictionary, init=False
    )

    def entry(self, connection: ServerConnection) -> AcceptedHandshake:
        """Return what was decided about a connection whose handshake is done."""
        return self._entries[connection]

    async def process_request(
        self, connection: ServerConnection, request: Request
    ) -> Response | None:
        """Answer a page or a refusal; None lets the handshake go on."""
        try:
            head = read_head(request)
            self._admission.check_page(head)
            if isinstance(self._others, FrontEnds) and not head.upgrade:
                return await self._page(connection, head)
            self._enter(connection, head)
        except RefusedError as error:
            self._totals.refuse()
            self._audit.arrival(address_of(connection), "", "", str(error))
            if isinstance(error, WrongTokenError):
                await self._wait(connection)
            response = _response(
                error.status, "text/plain; charset=utf-8", f"{coded_text(error)}\n".encode()
            )
            if error.status is HTTPStatus.UNAUTHORIZED:
                response.headers["WWW-Authenticate"] = 'Bearer realm="uoarm"'
            return response
        return None

    def select_subprotocol(
        self, connection: ServerConnection, offered: Sequence[Subprotocol]
    ) -> Subprotocol | None:
        """Choose a form; a client that offers none of any version gets JSON of this one.

        On the endpoint of a front end one of its own goes first.

        Raises:
            NegotiationError: it speaks other versions of the native protocol only.
        """
        entry = self._entries.get(connection)
        front_end = None if entry is None else entry.front_end
        if front_end is not None:
            own = next(
                (subprotocol for subprotocol in offered if subprotocol in front_end.subprotocols),
                None,
            )
            if own is not None:
                return own
        chosen = next((subprotocol for subprotocol in offered if subprotocol in FORMS), None)
        if chosen is None and entry is not None and front_end is None:
            others = [subprotocol for subprotocol in offered if subprotocol.startswith(_VERSIONS)]
            if others:
                raise NegotiationError(f"this server speaks {', '.join(FORMS)}, not {others[0]}")
        return chosen

    def _enter(self, connection: ServerConnection, head: RequestHead) -> None:
        front_end = self._front_end_at(head.path)
        address = host_of(connection)
        if not self._connected.admits(address):
            raise RefusedError(HTTPStatus.SERVICE_UNAVAILABLE, "too many clients are connected")
        if self._connected.of(address) >= self._limits.connections_per_address:
            raise RefusedError(
                HTTPStatus.TOO_MANY_REQUESTS, "too many clients of this address are connected"
            )
        self._entries[connection] = AcceptedHandshake(
            self._credentials(connection, head), front_end
        )

    def _front_end_at(self, path: str) -> FrontEnd | None:
        if not isinstance(self._others, FrontEnds):
            return self._others
        front_end = self._others.at(path)
        if front_end is None and path not in _NATIVE_PATHS:
            there = " or ".join(["/", *(end.path for end in self._others.usable if end.start)])
            raise RefusedError(HTTPStatus.NOT_FOUND, f"there is no endpoint here; try {there}")
        return front_end

    def _credentials(self, connection: ServerConnection, head: RequestHead) -> Credentials:
        certificate = connection.transport.get_extra_info("peercert") or {}
        return self._admission.admit(head, certificate)

    async def _wait(self, connection: ServerConnection) -> None:
        """Hold the answer to a wrong token back, as long as there must be between two of them."""
        address = host_of(connection)
        pause = self._admission.wrong_tokens.begin(address, time.monotonic())
        if pause is None:
            connection.transport.abort()
            return
        try:
            await asyncio.sleep(pause)
        finally:
            self._admission.wrong_tokens.end(address)

    async def _page(self, connection: ServerConnection, head: RequestHead) -> Response:
        path = head.path
        if path == "/healthz":
            return _response(HTTPStatus.OK, _TYPES[".json"], orjson.dumps(self._health()))
        if path == "/metrics":
            role = self._admission.role(self._credentials(connection, head))
            if role is None or not role.allows_all(Operation.SEE):
                raise RefusedError(HTTPStatus.FORBIDDEN, "metrics need a role that may see all")
            return _response(HTTPStatus.OK, "text/plain; version=0.0.4", await self._metrics())
        found = _static_files().get("index.html" if path == "/" else path.removeprefix("/"))
        if found is None:
            raise RefusedError(HTTPStatus.NOT_FOUND, "there is no such page")
        return _response(HTTPStatus.OK, *found)


@cache
def _static_files() -> Mapping[str, tuple[str, bytes]]:
    """Return the pages that ship with the server: only these names can ever be asked for."""
    folder = Path(__file__).parents[1] / "static"
    return {
        path.relative_to(folder).as_posix(): (_TYPES[path.suffix], path.read_bytes())
        for path in folder.rglob("*")
        if path.suffix in _TYPES
    }


def _response(status: HTTPStatus, kind: str, body: bytes) -> Response:
    headers = Headers(
        {
            "Content-Type": kind,
            "Content-Length": str(len(body)),
            "Connection": "close",
            **_PAGE_HEADERS,
        }
    )
    return Response(status.value, status.phrase, headers, body)
