"""Streamable HTTP: each request admitted as a handshake is, bounded before it is parsed."""

from __future__ import annotations

import asyncio
import contextlib
import functools
from collections.abc import Awaitable, Callable, Iterator, MutableMapping
from typing import Any

import uvicorn
from mcp.server.auth.middleware.bearer_auth import AuthenticatedUser
from mcp.server.auth.provider import AccessToken
from mcp.server.lowlevel import Server
from mcp.server.streamable_http import GET_STREAM_KEY, MCP_SESSION_ID_HEADER
from mcp.server.streamable_http_manager import StreamableHTTPSessionManager
from mcp.shared.inbound import MCP_PROTOCOL_VERSION_HEADER
from mcp_types.version import HANDSHAKE_PROTOCOL_VERSIONS
from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from uoarm.errors import ControlMessageError
from uoarm.model import Budget, BudgetUse, scan_json
from uoarm.server import Limits
from uoarm.server.front_end import (
    BusyError,
    Charge,
    Discoveries,
    HttpPlace,
    LimitError,
    MemoryUse,
    RefusedError,
    StatelessClient,
    coded_text,
)
from uoarm_mcp._schemas import id_of
from uoarm_mcp._service import CLIENT, AgentService

PATH = "/mcp"
_BODY_OCTETS = 1_048_576
_CERTIFICATE = "uoarm.certificate"
_MOST_SESSIONS = 64
_IDLE_SECONDS = 600.0
_KEPT_SECONDS = 60
_HEAD_OCTETS = 65_536
_MOST_AHEAD = 16
_PIECE_OCTETS = 65_536
_WELL = 200
_SHOWN = 200
_SESSION = MCP_SESSION_ID_HEADER.encode()
_REVISION = MCP_PROTOCOL_VERSION_HEADER.encode()
_LAST_EVENT = b"last-event-id"
_WITH_SESSIONS = frozenset(revision.encode() for revision in HANDSHAKE_PROTOCOL_VERSIONS)

_Scope = MutableMapping[str, Any]
_Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
_Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]


async def serve_http(place: HttpPlace, version: str) -> None:
    """Serve agents until this is cancelled."""
    service = AgentService(place.backend, Discoveries(place.backend), version)
    sessions = GuestSessions(service.protocol)
    config = uvicorn.Config(
        AdmittingApp(place, service, sessions),
        http=functools.partial(_BoundedProtocol, place.backend.limits),  # type: ignore[arg-type]
        ws="none",
        lifespan="off",
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,
        date_header=False,
        timeout_keep_alive=_KEPT_SECONDS,
        timeout_graceful_shutdown=1,
    )
    config.load()
    config.ssl = place.tls
    server = _QuietServer(config)
    serving = asyncio.ensure_future(server.serve(list(place.sockets)))
    try:
        await asyncio.shield(serving)
    finally:
        service.close()
        server.end()
        with contextlib.suppress(Exception):
            await asyncio.wait({serving}, timeout=place.backend.limits.stop_seconds / 8)
        serving.cancel()
        await sessions.close()
        for connection in tuple(server.server_state.connections):
            connection.transport.abort()  # of a client that does not read


class GuestSessions:
    """The sessions of earlier revisions, of each client its own, so that no one takes all of them.

    They end with the client's rights. A client that goes away without ending its own may come back
    as often as it likes: the one that was used least recently makes room, unless all are in use.

    Args:
        protocol: what they speak.
    """

    def __init__(self, protocol: Server[Any]) -> None:
        self._protocol = protocol
        # Requests under way by session, the one that was used last at the end. A session that is
        # being opened has its place by an object of its own.
        self._used: dict[StatelessClient, dict[object, int]] = {}
        self._managers: dict[StatelessClient, asyncio.Future[StreamableHTTPSessionManager]] = {}
        self._running: dict[StatelessClient, asyncio.Task[None]] = {}

    async def answer(
        self, client: StatelessClient, scope: _Scope, receive: _Receive, send: _Send
    ) -> None:
        """Answer one request of a client."""
        manager, used = await self._of(client), self._used[client]
        headers = dict(scope["headers"])
        session, revision = headers.get(_SESSION), headers.get(_REVISION)
        place, is_well = object(), False
        idle: object = None
        if session is None and (revision is None or revision in _WITH_SESSIONS):
            if len(used) >= _MOST_SESSIONS:
                idle = next((known for known, requests in used.items() if not requests), None)
                # First, or another request would end the same one, or use it, meanwhile.
                used.pop(idle, None)
            used[place] = 1
        elif session in used:
            used[session] = used.pop(session) + 1

        async def noting(message: MutableMapping[str, Any]) -> None:
            nonlocal is_well
            if message["type"] == "http.response.start" and message["status"] == _WELL:
                is_well = True
                begun = dict(message["headers"]).get(_SESSION)
                if begun is not None and used.pop(place, 0):
                    used[begun] = 0
            await send(message)

        try:
            if idle is not None:
                await _end_session(manager, scope, idle)
            await manager.handle_request(scope, receive, noting)
        finally:
            used.pop(place, 0)
            if session in used:
                used[session] -= 1
                if scope["method"] == "DELETE" and is_well:
                    del used[session]

    async def _of(self, client: StatelessClient) -> StreamableHTTPSessionManager:
        if client not in self._managers:
            self._managers[client] = asyncio.get_running_loop().create_future()
            self._used[client] = {}
            self._running[client] = asyncio.ensure_future(self._run(client))
            client.on_end(lambda: self._end(client))
        return await asyncio.shield(self._managers[client])

    async def close(self) -> None:
        """End all of them. Idempotent."""
        running = list(self._running.values())
        for client in list(self._running):
            self._end(client)
        if running:
            await asyncio.wait(running)

    async def _run(self, client: StatelessClient) -> None:
        manager = StreamableHTTPSessionManager(
            self._protocol,
            session_idle_timeout=_IDLE_SECONDS,
            max_request_body_size=_BODY_OCTETS,
            max_sessions=_MOST_SESSIONS,
            json_response=True,  # a call answers at once or with a handle: nothing is streamed
        )
        async with manager.run():
            self._managers[client].set_result(manager)
            await asyncio.Event().wait()  # until it is cancelled

    def _end(self, client: StatelessClient) -> None:
        self._managers.pop(client, None)
        self._used.pop(client, None)
        if client in self._running:
            self._running.pop(client).cancel()


async def _end_session(
    manager: StreamableHTTPSessionManager, scope: _Scope, session: object
) -> None:
    """End a session as its client does, since the SDK has no other way that is public."""

    async def receive() -> MutableMapping[str, Any]:
        return {"type": "http.request", "body": b"", "more_body": False}

    async def send(_: MutableMapping[str, Any]) -> None:
        """Let no one have the answer."""

    ending = {**scope, "method": "DELETE", "headers": [(_SESSION, session)]}
    await manager.handle_request(ending, receive, send)


class AdmittingApp:
    """Lets a request in as the server lets in a WebSocket, and bounds what it brings."""

    def __init__(self, place: HttpPlace, service: AgentService, sessions: GuestSessions) -> None:
        self._place = place
        self._service = service
        self._sessions = sessions
        self._under_way: dict[StatelessClient, set[asyncio.Task[Any]]] = {}
        # Requests of sessions, by client, session and id.
        self._asked: set[tuple[StatelessClient, bytes | None, str]] = set()

    async def __call__(self, scope: _Scope, receive: _Receive, send: _Send) -> None:
        """Answer one request."""
        if scope["type"] != "http":
            return
        # The parser leaves the blanks at the end of a value, which are no part of it.
        # No event is kept: a stream begins anew, where the SDK would not answer at all.
        scope["headers"] = [
            (name, value.strip(b" \t")) for name, value in scope["headers"] if name != _LAST_EVENT
        ]
        headers = [
            (name.decode("latin-1"), value.decode("latin-1")) for name, value in scope["headers"]
        ]
        query = scope.get("query_string", b"").decode("latin-1")
        path = f"{scope['path']}{query and '?'}{query}"
        address = (scope.get("client") or ("unknown",))[0]
        certificate = scope.get(_CERTIFICATE)
        try:
            async with self._place.stateless_clients.admitted(
                path, headers, certificate, address
            ) as client:
                if scope["path"].rstrip("/") != PATH:
                    await _answer(send, 404, f"there is no endpoint here; it is {PATH}")
                    return
                held = client.account.hold(MemoryUse.ASKED)
                try:
                    await self._serve(client, held, scope, receive, send)
                finally:
                    held.release()
        except RefusedError as error:
            await _answer(send, error.status.value, coded_text(error))

    async def _serve(
        self, client: StatelessClient, held: Charge, scope: _Scope, receive: _Receive, send: _Send
    ) -> None:
        limits = self._place.backend.limits
        most = min(_BODY_OCTETS, limits.message_bytes)
        budget = Budget(most, limits.elements, limits.depth, limits.dimensions)
        spending = BudgetUse(budget)
        try:
            body = await asyncio.wait_for(_body(receive, most, held), limits.message_seconds)
            text = (body or b"").decode()
            if text:
                scan_json(text, spending)
        except asyncio.TimeoutError:
            await _answer(send, 408, f"the request took more than {limits.message_seconds:g} s")
            return
        except ControlMessageError as error:
            await _answer(send, 413, coded_text(error))
            return
        except BusyError as error:
            await _answer(send, 503, coded_text(error))
            return
        except UnicodeDecodeError:
            await _answer(send, 400, "the request is not UTF-8")
            return
        if body is None:
            return
        try:
            identity = id_of(text, budget) if text else ""
        except ControlMessageError as error:
            await _answer(send, 400, coded_text(error))
            return
        await client.pace(len(body), spending.elements)
        headers = dict(scope["headers"])
        if headers.get(b"mcp-method") == b"tools/call":
            await self._service.prepare(client, headers.get(b"mcp-name", b"").decode("latin-1"))
        asked = client, headers.get(_SESSION), identity
        # The SDK would answer one of the two only; a session's stream of notices has an id, too.
        if asked in self._asked or (identity == GET_STREAM_KEY and _SESSION in headers):
            await _answer(send, 400, f"the id {identity[:_SHOWN]!r} is that of a request under way")
            return
        if identity and _SESSION in headers:
            self._asked.add(asked)
        try:
            await self._run(client, scope, body, receive, send)
        finally:
            self._asked.discard(asked)

    async def _run(
        self,
        client: StatelessClient,
        scope: _Scope,
        body: bytes,
        receive: _Receive,
        send: _Send,
    ) -> None:
        """Answer a request that was read, until its client's rights end, or the client goes."""
        token = AccessToken(token="-", client_id=client.identity, scopes=[])  # noqa: S106
        admitted = {**scope, CLIENT: client, "user": AuthenticatedUser(token)}
        sending = _Sending(client, send)
        task = asyncio.ensure_future(
            self._sessions.answer(client, admitted, _again(body, receive), sending.send)
        )
        if client not in self._under_way:
            self._under_way[client] = set()
            client.on_end(lambda: self._end(client))
        self._under_way[client].add(task)
        leaving = None
        if dict(scope["headers"]).get(_REVISION) not in (None, *_WITH_SESSIONS):
            # Of later revisions a response that its client closes is a request that it cancels;
            # the SDK looks for that in streams only.
            leaving = asyncio.ensure_future(_cancel_when_gone(receive, task))
        try:
            await task
        except asyncio.CancelledError:
            task.cancel()
            if leaving is not None and leaving.done():
                return
            if not client.has_ended:
                raise
            if sending.has_begun:
                await send({"type": "http.response.body", "body": b""})
            else:
                await _answer(send, 401, "the rights of this client have ended")
        finally:
            if leaving is not None:
                leaving.cancel()
            sending.close()
            if client in self._under_way:
                self._under_way[client].discard(task)

    def _end(self, client: StatelessClient) -> None:
        for task in self._under_way.pop(client, set()):
            task.cancel()


class _Sending:
    """An answer on its way to a client, whose memory it is until the client has read it.

    It goes out in pieces, each when those before it were read: the parser takes it whole.
    """

    def __init__(self, client: StatelessClient, send: _Send) -> None:
        self.has_begun = False
        self._client = client
        self._send = send
        self._charge: Charge | None = None
        self._is_refused = False

    async def send(self, message: MutableMapping[str, Any]) -> None:
        """Send a part of it; there is another answer where the client has too much memory held."""
        if self._is_refused:
            return
        if message["type"] == "http.response.start":
            self.has_begun = True
            size = int(dict(message["headers"]).get(b"content-length", 0))
            try:
                self._charge = self._client.account.charge(MemoryUse.ANSWERS, size)
            except (BusyError, LimitError) as error:
                self._is_refused = True
                await _answer(self._send, 503, coded_text(error))
                return
        rest = memoryview(message.get("body", b""))
        while len(rest) > _PIECE_OCTETS:
            piece, rest = bytes(rest[:_PIECE_OCTETS]), rest[_PIECE_OCTETS:]
            await self._send({"type": message["type"], "body": piece, "more_body": True})
        await self._send({**message, "body": bytes(rest)} if "body" in message else message)

    def close(self) -> None:
        """Let go of it: it was read, or never will be."""
        if self._charge is not None:
            self._charge.release()


async def _body(receive: _Receive, most: int, held: Charge) -> bytes | None:
    """Return the body of a request, which is charged as it comes; None: its client has gone."""
    parts, size = [], 0
    while True:
        message = await receive()
        if message["type"] == "http.disconnect":
            return None
        part = message.get("body", b"")
        size += len(part)
        if size > most:
            raise ControlMessageError(f"a request may have {most:,} octets")
        if not held.grow(len(part)):
            held.release()  # at once, or those beside it would be refused as well
            raise BusyError("the requests under way hold all the memory that they may")
        parts.append(part)
        if not message.get("more_body"):
            return b"".join(parts)


async def _cancel_when_gone(receive: _Receive, task: asyncio.Future[None]) -> None:
    """Cancel the answer to a request, whose body was read, when its client has gone."""
    await receive()
    task.cancel()


def _again(body: bytes, receive: _Receive) -> _Receive:
    """Return what gives a body that was read, and then what comes after it."""
    given = False

    async def again() -> MutableMapping[str, Any]:
        nonlocal given
        if given:
            return await receive()
        given = True
        return {"type": "http.request", "body": body, "more_body": False}

    return again


async def _answer(send: _Send, status: int, text: str) -> None:
    body = f"{text}\n".encode()
    headers = [
        (b"content-type", b"text/plain; charset=utf-8"),
        (b"content-length", str(len(body)).encode()),
        (b"connection", b"close"),
    ]
    if status == 401:  # noqa: PLR2004 - of HTTP
        headers.append((b"www-authenticate", b'Bearer realm="uoarm"'))
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})


class _BoundedProtocol(HttpToolsProtocol):
    """HTTP/1.1 whose heads come in time and whose answers are read; it knows the certificate.

    The parser keeps heads of any length and requests sent ahead of any number, and waits for the
    rest of a head, and for a client that does not read, for ever. All are bounded here, where a
    connection that goes beyond is cut.
    """

    def __init__(self, limits: Limits, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._limits = limits
        self._head_octets = 0  # came since the last request was whole, and were no body
        self._late: asyncio.TimerHandle | None = None
        self._unread: asyncio.TimerHandle | None = None

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        if len(self.connections) > self._limits.connections:
            transport.abort()
            return
        certificate = transport.get_extra_info("peercert")
        app = self.app

        async def certified(scope: Any, receive: Any, send: Any) -> None:
            await app({**scope, _CERTIFICATE: certificate}, receive, send)

        self.app = certified
        self._await_head()

    def data_received(self, data: bytes) -> None:
        self._head_octets += len(data)
        super().data_received(data)
        if self._head_octets > _HEAD_OCTETS or len(self.pipeline) > _MOST_AHEAD:
            self.transport.abort()

    def on_message_begin(self) -> None:
        super().on_message_begin()
        if self._late is None:
            self._await_head()

    def on_headers_complete(self) -> None:
        if self._late is not None:
            self._late.cancel()
            self._late = None
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        self._head_octets -= len(body)
        super().on_body(body)

    def on_message_complete(self) -> None:
        self._head_octets = 0
        super().on_message_complete()

    def on_response_complete(self) -> None:
        super().on_response_complete()
        self._await_reader()

    def pause_writing(self) -> None:
        super().pause_writing()
        self._await_reader()

    def resume_writing(self) -> None:
        super().resume_writing()
        self._await_reader()

    def connection_lost(self, exc: Exception | None) -> None:
        for timer in (self._late, self._unread):
            if timer is not None:
                timer.cancel()
        super().connection_lost(exc)

    def _await_head(self) -> None:
        self._late = self.loop.call_later(self._limits.handshake_seconds, self._cut_late)

    def _cut_late(self) -> None:
        if self.flow.read_paused:  # the rest may have come, and is taken after requests before it
            self._await_head()
        else:
            self.transport.abort()

    def _await_reader(self) -> None:
        """Cut the connection if nothing of what waits now is read: while much waits, none comes."""
        if self._unread is not None:
            self._unread.cancel()
        left = self.transport.get_write_buffer_size()
        self._unread = None
        if left:
            self._unread = self.loop.call_later(self._limits.stall_seconds, self._cut_unread, left)

    def _cut_unread(self, left: int) -> None:
        if self.transport.get_write_buffer_size() >= left:
            self.transport.abort()
        else:
            self._await_reader()


class _QuietServer(uvicorn.Server):
    """One that leaves the process's signals to the server that it is a part of.

    And that waits for its end: the library's looks ten times a second whether it has come, to make
    the head `date` anew, which is not sent here.
    """

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self._ending = asyncio.Event()

    def end(self) -> None:
        """Begin to end."""
        self.should_exit = self.force_exit = True
        self._ending.set()

    async def main_loop(self) -> None:
        """Serve until the end; see `uvicorn.Server`."""
        await self.on_tick(0)
        await self._ending.wait()

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield
