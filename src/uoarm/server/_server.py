"""The server: sockets, clients and their ends, all in one event loop."""

from __future__ import annotations

import asyncio
import functools
import logging
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Iterable
from functools import cache
from typing import Any, TypeVar

from websockets.asyncio.server import Server as Listening
from websockets.asyncio.server import ServerConnection, serve
from websockets.frames import CloseCode

from uoarm._control import RobotManager
from uoarm._raised import LimitedLog, Log, foreign
from uoarm._support.process_tuning import give_memory_back
from uoarm._wire import FORMS, TEXT_FORM
from uoarm.errors import ConfigurationError, ListenError, UsageError
from uoarm.model import StatusEvent
from uoarm.server._options import ServerOptions
from uoarm.server.access import Admission, Audit, AuditFile
from uoarm.server.front_end import FrontEnd, HttpPlace, MakeSession
from uoarm.server.http import (
    BACKLOG,
    FrontEnds,
    HandshakeHandler,
    ListeningSocket,
    Metrics,
    Totals,
    connections_possible,
    listen,
)
from uoarm.server.session import (
    DEFLATE,
    ConnectedClient,
    FrameDecoder,
    NativeSession,
    Session,
    SessionStore,
    Shared,
    Sockets,
    StatelessClients,
    TurnConnection,
    host_of,
    make_folder,
)
from uoarm.server.streams import FeedRegistry, Shares

_log = Log("uoarm.server")
_GLANCE_SECONDS = 0.5
_IN_ONE_TURN = 100
T = TypeVar("T")
_CROWD = 8
_UNFINISHED = 64


class Server:
    """Serves one robot to WebSocket clients. Make, start and stop it in one event loop.

    Args:
        robot: stays open when the server stops.
        settings: where, and for whom.
        front_ends: what other protocols are spoken; None: those of all installed plugins, of which
            one that cannot be used is logged and left out.

    Raises:
        ConfigurationError: the settings are not safe, a file of theirs has mistakes, or a front end
            that has a port cannot be used.
    """

    def __init__(
        self,
        robot: RobotManager,
        settings: ServerOptions,
        front_ends: Iterable[FrontEnd] | None = None,
    ) -> None:
        self._records = LimitedLog(_log)
        settings.check()
        self._front_ends = FrontEnds(front_ends)
        for problem in self._front_ends.problems:
            _log.warning("the front end %r cannot be used: %s", problem.name, problem.cause)
        for name in settings.front_end_ports:
            if self._front_ends.find(name) is None:
                raise ConfigurationError(self._front_ends.missing(name))
        self._robot = robot
        self._settings = settings
        self._limits = settings.limits
        self._admission = Admission(
            settings.access,
            origins=settings.origins,
            hosts=settings.hosts,
            local=settings.local,
            slowest=self._limits.handshake_seconds / 2,
            exports=lambda: robot.config.exports,
        )
        self._certificate = settings.shown_certificate()
        self._tls = None if self._certificate is None else self._certificate.context
        self._audit = Audit()
        self._audit_file: AuditFile | None = None
        self._decoder = FrameDecoder()
        self._totals = Totals()
        self._make_session: dict[str, MakeSession] = {}
        room = connections_possible(self._limits.connections + _UNFINISHED)
        self._connected = Shares(max(1, min(self._limits.connections, room - room // 8)))
        self._clients: dict[ConnectedClient, None] = {}
        self._store = SessionStore(self._limits, self._end)
        self._listening: list[Listening] = []
        self._serving: list[asyncio.Task[None]] = []
        self._sockets_of_others: list[ListeningSocket] = []
        self._stateless_clients: StatelessClients | None = None
        self._ports: list[int] = []
        self._sockets = Sockets(room, self._limits)
        self._registry: FeedRegistry | None = None
        self._shared: Shared | None = None
        self._watches: list[asyncio.Task[None]] = []
        self._crowd = 0
        self._stop_observing: Callable[[], None] = lambda: None

    @property
    def ports(self) -> tuple[int, ...]:
        """The ports it listens on: the main one, then those of `Settings.front_end_ports`."""
        return tuple(self._ports)

    @property
    def front_ends(self) -> tuple[FrontEnd, ...]:
        """What other protocols it speaks."""
        return self._front_ends.usable

    @property
    def backend(self) -> FeedRegistry:
        """The robot, as front ends have it; once it is started."""
        assert self._registry is not None, "the server was started"
        return self._registry

    @property
    def stateless_clients(self) -> StatelessClients:
        """Who comes with requests, as front ends admit them; once it is started."""
        assert self._stateless_clients is not None, "the server was started"
        return self._stateless_clients

    @property
    def held_octets(self) -> int:
        """Octets of decoded values that are held for all clients; 0 before it is started."""
        return 0 if self._registry is None else self._registry.memory.held

    @property
    def unread_octets(self) -> int:
        """Octets that arrived and that no session has read."""
        return sum(socket.unread_octets for socket in self._sockets)

    async def start(self) -> None:
        """Listen.

        Raises:
            ListenError: a port is taken, or the address is none of this machine.
            ConfigurationError: the audit log, or recordings to their folder, cannot be written.
        """
        if self._settings.recordings is not None:
            try:
                make_folder(self._settings.recordings)
            except UsageError as error:
                raise ConfigurationError(str(error)) from error
        if self._settings.audit is not None:
            self._audit_file = AuditFile(self._settings.audit)
        registry = self._registry = FeedRegistry(self._robot, self._limits)
        self._shared = Shared(registry, self._settings.recordings_folder)
        self._stateless_clients = StatelessClients(
            self._admission, self._audit, registry, self._connected, self._totals.refuse
        )
        self._stop_observing = self._robot._observe(self._audit_lease)  # noqa: SLF001 - of the house
        metrics = Metrics(registry, self._totals, lambda: self._clients, self._store)
        try:
            self._start_front_ends(registry)
            await self._listen(self._settings.port, metrics.text, None)
            for name, port in self._settings.front_end_ports.items():
                front_end = self._front_ends.find(name)
                if front_end is not None and front_end.serve is not None:
                    await self._serve_http(port, front_end)
                else:
                    await self._listen(port, metrics.text, front_end)
        except BaseException:
            await self.stop()
            raise
        self._watches = [
            asyncio.ensure_future(_repeat(self._look_after_clients, "looking after the clients")),
        ]
        if self._settings.access is not None or self._certificate is not None:
            reading = _repeat(self._read_again, "reading the access file and the certificate")
            self._watches.append(asyncio.ensure_future(reading))

    async def stop(self) -> None:
        """Take no more clients, let what waits be written, close properly; bounded in time.

        What clients move stops first.
        """
        if self._registry is not None:
            self._registry.end()
        for watch in self._watches:
            watch.cancel()
        for listening in self._listening:
            listening.close(close_connections=False)
        for serving in self._serving:
            serving.cancel()
        if self._serving:
            await asyncio.wait(self._serving, timeout=self._limits.stop_seconds / 4)
        for listener in self._sockets_of_others:
            listener.close()
        if self._stateless_clients is not None:
            self._stateless_clients.close()
        if self._registry is not None:
            self._registry.views.close()  # long answers would keep outboxes from being emptied
        limit = self._limits.stop_seconds / 4
        if self._registry is not None:
            await _all_within(limit, [self._registry.mailbox.caught_up()])
        await _all_within(limit, [client.outbox.emptied() for client in self._clients])
        await _all_within(
            limit,
            [socket.close(CloseCode.GOING_AWAY, "the server stops") for socket in self._sockets],
        )
        for socket in self._sockets:
            socket.transport.abort()
        await _all_within(limit, [listening.wait_closed() for listening in self._listening])
        self._store.close()
        self._decoder.close()
        if self._registry is not None:
            await self._registry.close()
            self._stop_observing()
            await _all_within(limit, [self._registry.mailbox.caught_up()])
        if self._audit_file is not None:
            self._audit_file.close()

    def _audit_lease(self, event: StatusEvent) -> None:
        """Have the loop record who commands what: the thread that posts waits for no disk."""
        if event.change == "leased":
            self.backend.mailbox.put(functools.partial(self._audit.leased, event.cause))

    def _start_front_ends(self, registry: FeedRegistry) -> None:
        for front_end in self._front_ends.usable:
            if front_end.start is None:
                continue
            try:
                self._make_session[front_end.name] = foreign(front_end.start, registry)
            except Exception as error:
                if front_end.name in self._settings.front_end_ports:
                    raise ConfigurationError(f"{front_end}: {error}") from error
                text = f"{front_end} did not start, and is left out"
                self._records.write(logging.ERROR, text, error)
                self._front_ends.drop(front_end.name, "it did not start")

    async def _listen(
        self, port: int, metrics: Callable[[], Awaitable[bytes]], only: FrontEnd | None
    ) -> None:
        limits = self._limits
        handshakes = HandshakeHandler(
            self._admission,
            self._audit,
            limits,
            self._totals,
            self._connected,
            health=lambda: {"status": "ok", "clients": len(self._clients)},
            metrics=metrics,
            others=only or self._front_ends,
        )

        async def handle(socket: ServerConnection) -> None:
            assert isinstance(socket, TurnConnection), "_make_connection makes no others"
            await self._handle(socket, handshakes)

        for listener in await self._bind(port):
            listening = serve(
                handle,
                sock=listener,
                backlog=BACKLOG,
                ssl=self._tls,
                process_request=handshakes.process_request,
                select_subprotocol=handshakes.select_subprotocol,
                create_connection=self._make_connection,  # type: ignore[arg-type] # it is only called
                compression=None,  # `extensions` says it, without what a library compresses
                extensions=[DEFLATE] if self._settings.deflate else None,
                server_header=None,
                open_timeout=limits.handshake_seconds,  # of TLS, and then of HTTP
                ping_interval=limits.ping_seconds,
                ping_timeout=limits.stall_seconds,
                close_timeout=limits.stop_seconds,
                max_size=limits.message_bytes,
            )
            self._listening.append(await listening)

    async def _bind(self, port: int) -> list[ListeningSocket]:
        try:
            sockets = await listen(self._settings.host, port)
        except OSError as error:
            raise ListenError(self._settings.place(port), port, error) from error
        self._ports.append(sockets[0].getsockname()[1])
        return sockets

    async def _serve_http(self, port: int, front_end: FrontEnd) -> None:
        assert front_end.serve is not None, "others are not served so"
        sockets = await self._bind(port)
        self._sockets_of_others += sockets
        place = HttpPlace(self.backend, self.stateless_clients, tuple(sockets), self._tls)
        serving = asyncio.ensure_future(foreign(front_end.serve, place))
        serving.add_done_callback(functools.partial(_take_end, front_end))
        self._serving.append(serving)

    def _make_connection(self, *arguments: Any, **options: Any) -> ServerConnection:
        return TurnConnection(self._sockets, *arguments, **options)

    async def _handle(self, socket: TurnConnection, handshakes: HandshakeHandler) -> None:
        entry = handshakes.entry(socket)
        grant = self._admission.grant(entry.credentials)
        if grant is None:
            await socket.close(CloseCode.POLICY_VIOLATION, "the token is no longer valid")
            return
        client = ConnectedClient(
            socket,
            entry.credentials,
            grant,
            self._limits,
            self._decoder,
            self.backend.memory.open(),
            self._audit,
            self.backend.approvals.supervision,
        )
        host = host_of(socket)
        try:
            session = foreign(self._session, client, socket, entry.front_end)
        except Exception as error:  # noqa: BLE001 - a front end may raise anything
            client.account.close()
            who = entry.front_end or "the native protocol"
            text = f"{who} made no session for client {client.identity}"
            self._records.write(logging.ERROR, text, error)
            await socket.close(CloseCode.INTERNAL_ERROR, "the server failed")
            return
        self._connected.take(host)
        self._totals.clients += 1
        self._audit.arrival(client.address, client.identity, grant.role.name)
        try:
            await self._attend(client, session, socket)
            kept = await self._store.successor(client)
            if kept is not None:
                self._audit.resumed(client.address, kept.client.identity)
                await self._attend(kept.client, kept.session, socket)
        finally:
            self._connected.take(host, -1)

    async def _attend(
        self, client: ConnectedClient, session: Session, socket: TurnConnection
    ) -> None:
        """Serve a client until its connection ends, then keep its session or end it."""
        self._clients[client] = None
        try:
            await client.run(session, socket, self.backend.mailbox.soon)
        except Exception as error:  # noqa: BLE001 - a front end may raise anything
            text = f"{type(session).__module__} failed for client {client.identity}"
            self._records.write(logging.ERROR, text, error)
            await socket.close(CloseCode.INTERNAL_ERROR, "the server failed")
        finally:
            del self._clients[client]
            if self._store.retain(client):
                self._audit.dropped(client.identity)
            else:
                self._end(client, session)

    def _end(self, client: ConnectedClient, session: Session) -> None:
        try:
            foreign(session.close)
        except Exception as error:  # noqa: BLE001 - a front end may raise anything
            text = f"{type(session).__module__} failed when it was closed"
            self._records.write(logging.ERROR, text, error)
        client.account.close()
        self._totals.add(client)
        self._audit.departure(client.identity)

    def _session(
        self, client: ConnectedClient, socket: ServerConnection, front_end: FrontEnd | None
    ) -> Session:
        if front_end is not None:
            return self._make_session[front_end.name](client)
        form = FORMS.get(socket.subprotocol or "", TEXT_FORM)
        assert self._shared is not None, "the server was started"
        return NativeSession(client, self.backend, form, self._store, self._shared)

    async def _read_again(self) -> None:
        """Take in what has changed in the access file and in the certificate's."""
        # Reading and checking a file takes its time; a folder on the network may even hang.
        await asyncio.to_thread(self._admission.refresh)
        if self._certificate is not None:
            await asyncio.to_thread(self._certificate.refresh)
            self._certificate.warn()

    async def _look_after_clients(self) -> None:
        """Look after clients that are stuck or whose rights have changed."""
        now = time.monotonic()
        role = cache(self._admission.role)
        self._store.refresh(now, role)
        self.stateless_clients.check()
        async for socket in _in_turns(self._sockets):
            socket.check(now)
        async for client in _in_turns(self._clients):
            if role(client.credentials) != client.role:
                client.dismiss("its rights have changed or ended; connect again")
            client.check(now)
        # Have the allocator return, which it does not by itself, what a crowd of clients took.
        count = len(tuple(self._sockets))
        self._crowd = max(self._crowd, count)
        if self._crowd >= _CROWD and count <= self._crowd / 2:
            self._crowd = count
            await asyncio.to_thread(give_memory_back)


async def _in_turns(items: Iterable[T]) -> AsyncIterator[T]:
    """Go over what there is now, a few in each of the loop's turns: each costs some 5 us."""
    for number, item in enumerate(tuple(items), 1):
        yield item
        if number % _IN_ONE_TURN == 0:
            await asyncio.sleep(0)


def _take_end(front_end: FrontEnd, serving: asyncio.Task[None]) -> None:
    """Log that a front end serves no more, which it does until it is cancelled."""
    if not serving.cancelled():
        text = f"{front_end} has ended"
        LimitedLog(_log).write(logging.ERROR, text, serving.exception())


async def _repeat(action: Callable[[], Awaitable[None]], what: str) -> None:
    """Do something again and again; it must outlive whatever goes wrong once."""
    records = LimitedLog(_log)
    while True:
        await asyncio.sleep(_GLANCE_SECONDS)
        try:
            await action()
        except Exception as error:  # noqa: BLE001 - as said above
            records.write(logging.ERROR, f"{what} failed; it is tried again", error)


async def _all_within(seconds: float, steps: list[Coroutine[Any, Any, None]]) -> None:
    tasks = [asyncio.ensure_future(step) for step in steps]
    if tasks:
        _, late = await asyncio.wait(tasks, timeout=seconds)
        for task in late:
            task.cancel()
