"""The server: sockets, clients and their ends, all in one event loop."""

from __future__ import annotations

import asyncio
import logging
import secrets
import time
from collections import Counter
from collections.abc import Callable, Coroutine
from functools import cache
from typing import Any

from websockets.asyncio.server import Server as Listening
from websockets.asyncio.server import ServerConnection, serve
from websockets.frames import CloseCode

from uoarm.manager import RobotManager
from uoarm.server._address import host_of
from uoarm.server._admission import Admission
from uoarm.server._audit import Audit
from uoarm.server._client import Client, Session
from uoarm.server._desk import Desk
from uoarm.server._doors import Doors
from uoarm.server._lobby import Lobby
from uoarm.server._metrics import Metrics, Totals
from uoarm.server._native import NativeSession
from uoarm.server._settings import Settings
from uoarm.server.rosbridge import Hub, RosbridgeSession
from uoarm.wire import FORMS, TEXT_FORM

__all__ = ["Server"]

_log = logging.getLogger("uoarm.server")
_GLANCE_SECONDS = 0.5
_UNFINISHED = 64


class Server:
    """Serves one robot to WebSocket clients. Make, start and stop it in one event loop.

    Args:
        robot: stays open when the server stops.
        settings: where, and for whom.

    Raises:
        ConfigurationError: the settings are not safe, or a file of theirs has mistakes.
    """

    def __init__(self, robot: RobotManager, settings: Settings) -> None:
        settings.check()
        self._robot = robot
        self._settings = settings
        self._limits = settings.limits
        self._admission = Admission(
            settings.access,
            origins=settings.origins,
            hosts=settings.hosts,
            local=settings.local,
        )
        self._tls = settings.tls()
        self._audit = Audit()
        self._totals = Totals()
        self._hub = Hub()
        self._connected: Counter[str] = Counter()
        self._clients: dict[Client, None] = {}
        self._lobby = Lobby(self._limits, self._end)
        self._listening: list[Listening] = []
        self._sockets: set[ServerConnection] = set()
        self._desk: Desk | None = None
        self._watch: asyncio.Task[None] | None = None

    @property
    def ports(self) -> tuple[int, ...]:
        """The ports it listens on: the main one, then that of rosbridge."""
        return tuple(
            socket.getsockname()[1]
            for listening in self._listening
            for socket in list(listening.sockets)[:1]
        )

    async def start(self) -> None:
        """Listen.

        Raises:
            OSError: a port is taken.
        """
        desk = self._desk = Desk(self._robot, self._limits)
        metrics = Metrics(desk, self._totals, lambda: self._clients, self._lobby)
        try:
            await self._listen(self._settings.port, desk, metrics.text, only_rosbridge=False)
            if self._settings.rosbridge_port is not None:
                port = self._settings.rosbridge_port
                await self._listen(port, desk, metrics.text, only_rosbridge=True)
        except BaseException:
            await self.stop()
            raise
        self._watch = asyncio.ensure_future(self._keep_watch())

    async def stop(self) -> None:
        """Take no more clients, let what waits be written, close properly; bounded in time."""
        if self._watch is not None:
            self._watch.cancel()
        for listening in self._listening:
            listening.close(close_connections=False)
        limit = self._limits.stop_seconds / 4
        await _all_within(limit, [client.outbox.emptied() for client in self._clients])
        await _all_within(
            limit, [one.close(CloseCode.GOING_AWAY, "the server stops") for one in self._sockets]
        )
        for socket in tuple(self._sockets):
            socket.transport.abort()
        await _all_within(limit, [listening.wait_closed() for listening in self._listening])
        self._lobby.close()
        if self._desk is not None:
            await self._desk.close()

    async def _listen(
        self, port: int, desk: Desk, metrics: Callable[[], bytes], *, only_rosbridge: bool
    ) -> None:
        limits = self._limits
        doors = Doors(
            self._admission,
            self._audit,
            limits,
            self._totals,
            self._connected,
            health=self._health,
            metrics=metrics,
            only_rosbridge=only_rosbridge,
        )

        async def handle(socket: ServerConnection) -> None:
            await self._handle(socket, doors, desk)

        self._listening.append(
            await serve(
                handle,
                self._settings.host,
                port,
                ssl=self._tls,
                process_request=doors.process_request,
                select_subprotocol=doors.select_subprotocol,
                create_connection=self._make_connection,  # type: ignore[arg-type] # it is only called
                compression=None,
                server_header=None,
                open_timeout=limits.handshake_seconds,  # of TLS, and then of HTTP
                ping_interval=limits.ping_seconds,
                ping_timeout=limits.stall_seconds,
                close_timeout=limits.stop_seconds,
                max_size=limits.message_bytes,
            )
        )

    def _make_connection(self, *arguments: Any, **options: Any) -> ServerConnection:
        return _Counted(
            self._sockets, self._limits.connections + _UNFINISHED, *arguments, **options
        )

    async def _handle(self, socket: ServerConnection, doors: Doors, desk: Desk) -> None:
        entry = doors.entry(socket)
        role = self._admission.role(entry.shown)
        if role is None:
            await socket.close(CloseCode.POLICY_VIOLATION, "the token is no longer valid")
            return
        client = Client(socket, secrets.token_hex(6), entry.shown, role, self._limits)
        host = host_of(socket)
        session = self._session(client, desk, socket, rosbridge=entry.rosbridge)
        self._connected[host] += 1
        self._totals.clients += 1
        self._audit.arrival(client.address, client.identity, role.name)
        try:
            await self._attend(client, session, socket)
            kept = await self._lobby.successor(client)
            if kept is not None:
                self._audit.resumed(client.address, kept.client.identity)
                await self._attend(kept.client, kept.session, socket)
        finally:
            self._connected -= Counter({host: 1})

    async def _attend(self, client: Client, session: Session, socket: ServerConnection) -> None:
        """Serve a client until its connection ends, then keep its session or end it."""
        self._clients[client] = None
        try:
            await client.run(session, socket)
        finally:
            del self._clients[client]
            if self._lobby.park(client):
                self._audit.dropped(client.identity)
            else:
                self._end(client, session)

    def _end(self, client: Client, session: Session) -> None:
        session.close()
        self._totals.add(client)
        self._audit.departure(client.identity)

    def _session(
        self, client: Client, desk: Desk, socket: ServerConnection, *, rosbridge: bool
    ) -> Session:
        if rosbridge:
            return RosbridgeSession(client, desk, self._hub, self._audit)
        form = FORMS.get(socket.subprotocol or "", TEXT_FORM)
        return NativeSession(client, desk, form, self._audit, self._lobby)

    async def _keep_watch(self) -> None:
        """Look after clients that are stuck and rights that have changed."""
        while True:
            await asyncio.sleep(_GLANCE_SECONDS)
            try:
                self._look_after_clients(time.monotonic())
            except Exception:  # noqa: BLE001 - the watch must outlive whatever goes wrong
                _log.exception("looking after the clients failed; it is tried again")

    def _look_after_clients(self, now: float) -> None:
        self._admission.refresh()
        role = cache(self._admission.role)
        self._lobby.refresh(now, role)
        for client in list(self._clients):
            if role(client.shown) != client.role:
                client.dismiss("its rights have changed or ended; connect again")
            client.check(now)

    def _health(self) -> dict[str, object]:
        return {"status": "ok", "clients": len(self._clients)}


class _Counted(ServerConnection):
    """A connection that is known from its first byte on, and refused when there are too many."""

    def __init__(
        self, sockets: set[ServerConnection], limit: int, *arguments: Any, **options: Any
    ) -> None:
        super().__init__(*arguments, **options)
        self._sockets = sockets
        self._limit = limit

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self._sockets.add(self)
        if len(self._sockets) > self._limit:
            self.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        self._sockets.discard(self)
        super().connection_lost(exc)


async def _all_within(seconds: float, steps: list[Coroutine[Any, Any, None]]) -> None:
    tasks = [asyncio.ensure_future(step) for step in steps]
    if tasks:
        _, late = await asyncio.wait(tasks, timeout=seconds)
        for task in late:
            task.cancel()
