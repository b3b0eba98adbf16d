"""What is open at the other manager: streams, which channels share, and the channels."""

from __future__ import annotations

import asyncio
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from typing import Any, TypeAlias

from uoarm.bridge import ChannelHealth, ChannelMonitor, Delivery, Sink, Source
from uoarm.client import RemoteRobot, RemoteStream
from uoarm.errors import BridgeTimeoutError, ConnectionClosedError, UoarmError
from uoarm.model import Endpoint, Health, Message
from uoarm_remote._discovery import wanted_name
from uoarm_remote._link import ManagerLink
from uoarm_remote._options import FunctionOptions

__all__ = ["FunctionSink", "FunctionSource", "FunctionStreams"]

Report: TypeAlias = Callable[[Health, str], object]
_KILL_SECONDS = 1.0
_STANDING = 64


class _Stream:
    """One request at the other manager. Everything in the link's loop."""

    def __init__(self) -> None:
        self.opening = asyncio.Lock()
        self.stream: RemoteStream[Message] | None = None
        self.members: dict[FunctionSource | FunctionSink, None] = {}
        self.standing: deque[Message] = deque(maxlen=_STANDING)
        self.reading: asyncio.Task[None] | None = None


class FunctionStreams:
    """The requests of one bridge: the other manager has each only once from one client."""

    def __init__(self, link: ManagerLink) -> None:
        self._link = link
        self._streams: dict[tuple[str, bool, float], _Stream] = {}

    def open(self, channel: FunctionSource | FunctionSink, timeout: float) -> None:
        """Open what a channel needs, or share it; blocks.

        Raises:
            UoarmError: the other manager refused; nothing stays open.
        """
        way = self._link.way()

        async def opening(robot: RemoteRobot) -> None:
            await self._open(robot, channel, way)

        try:
            self._link.run(opening, timeout, f"Request {channel.key[0]}")
        except BaseException:
            self.close(channel)
            raise

    def close(self, channel: FunctionSource | FunctionSink) -> None:
        """Let go of what a channel has open; waits for nothing."""

        async def closing(_: RemoteRobot) -> None:
            await self._leave(channel)

        self._link.start(closing)

    async def _open(
        self,
        robot: RemoteRobot,
        channel: FunctionSource | FunctionSink,
        way: Mapping[str, Any],
    ) -> None:
        name, receive, every = channel.key
        shared = self._streams.setdefault(channel.key, _Stream())
        shared.members[channel] = None
        async with shared.opening:
            stream = shared.stream
            if stream is None or stream.ended:
                options: dict[str, Any] = {"receive": receive, "validate": "sampled"}
                if every:
                    options["every"] = every
                stream = await robot.ask("Request", name, jsonMessage=options, **way)
                shared.stream = stream
                shared.standing.clear()
                shared.reading = asyncio.ensure_future(self._read(shared, stream))
                standing: tuple[Message, ...] = ()
            else:
                standing = tuple(shared.standing)
        channel.opened(stream, standing)

    async def _read(self, shared: _Stream, stream: RemoteStream[Message]) -> None:
        """Hand on what comes, until the function has ended there."""
        try:
            while True:
                message = await stream.get()
                if stream.latched:
                    shared.standing.append(message)
                for member in tuple(shared.members):
                    member.came(message)
        except ConnectionClosedError:
            if shared.stream is stream:
                shared.stream = None
            for member in tuple(shared.members):
                member.ended(stream.state, stream.cause)

    async def _leave(self, channel: FunctionSource | FunctionSink) -> None:
        shared = self._streams.get(channel.key)
        if shared is None:
            return
        shared.members.pop(channel, None)
        async with shared.opening:  # one that joins meanwhile keeps it
            if shared.members or self._streams.get(channel.key) is not shared:
                return
            del self._streams[channel.key]
            stream, reading = shared.stream, shared.reading
        if reading is not None:
            reading.cancel()
        if stream is not None:
            with suppress(UoarmError, asyncio.TimeoutError):
                await asyncio.wait_for(stream.kill(), _KILL_SECONDS)


class _Monitored:
    """The health of a channel, by what the link and the other manager say."""

    def __init__(
        self, endpoint: Endpoint, link: ManagerLink, options: FunctionOptions, report: Report
    ) -> None:
        clock = time.monotonic
        health = ChannelHealth(
            f"{'.'.join(endpoint.address)} of {link.place}",
            clock(),
            stale_after=options.stale_after,
            grace=link.grace,
        )
        health.connected(clock())
        self.monitor = ChannelMonitor(health, report, clock)
        self.stream: RemoteStream[Message] | None = None
        self._is_broken = self._is_link_up = False

    def link_broke(self, cause: str) -> None:
        self._is_broken, self._is_link_up = True, False
        self.monitor.connected(0, cause)

    def link_is_up(self) -> None:
        self._is_link_up = True
        self._mend()

    def tick(self) -> None:
        self._mend()
        self.monitor.tick()

    def _mend(self) -> None:
        """Report that messages pass again: in a session begun anew, once it is open there."""
        is_open = self.stream is not None and not self.stream.is_away
        if self._is_broken and self._is_link_up and is_open:
            self._is_broken = False
            self.monitor.connected()

    def ended(self, state: str, cause: str) -> None:
        """Take in that the function has ended there."""
        health = Health.FINISHED if state == "finished" else Health.LOST
        self.monitor.peer_reported(health, cause or f"it was {state} there")


class FunctionSource(Source):
    """An output of a function of the other manager.

    The link's thread only appends what comes, so that a consumer that is stuck holds up nothing
    else. When the backlog is full, the oldest is dropped and counted.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        options: FunctionOptions,
        link: ManagerLink,
        deliver: Delivery,
        report: Callable[[Source, Health, str], object],
    ) -> None:
        super().__init__(endpoint)
        self.key = (wanted_name(endpoint), True, options.every)
        self.health = _Monitored(endpoint, link, options, partial(report, self))
        self._link, self._deliver, self._most = link, deliver, options.backlog
        self._streams: FunctionStreams | None = None
        # Guards what waits and whether it is closed: the link appends, the thread of this source
        # takes, any thread closes. It is not held while a message is delivered.
        self._changed = threading.Condition()
        self._waiting: deque[tuple[Message] | tuple[str, str]] = deque()
        self._is_closed = False
        self._dropped = 0

    def open(self, streams: FunctionStreams, timeout: float) -> None:
        """Open it; raises as `FunctionStreams.open`."""
        self._streams = streams
        streams.open(self, timeout)
        name = f"uoarm-remote {self.key[0]}"
        threading.Thread(
            target=_deliver_all, args=(weakref.ref(self),), name=name, daemon=True
        ).start()
        self._link.join(self.health)

    def opened(self, stream: RemoteStream[Message], standing: tuple[Message, ...]) -> None:
        """Take in that it is open; in the link's loop, before its first message."""
        self.health.stream = stream
        self.latched, self.depth = stream.latched, _STANDING if stream.latched else 1
        for message in standing:
            self.came(message)

    def came(self, message: Message) -> None:
        """Take one message; returns at once."""
        with self._changed:
            if len(self._waiting) >= self._most:
                self._waiting.popleft()
                self._dropped += 1
            self._waiting.append((message,))
            self._changed.notify()

    def ended(self, state: str, cause: str) -> None:
        """Take in the end, after what came before it."""
        with self._changed:
            self._waiting.append((state, cause))
            self._changed.notify()

    def facts(self) -> Mapping[str, object]:
        """Return what the status shows."""
        stream = self.health.stream
        lost, gaps = (0, 0) if stream is None else (stream.lost, stream.gaps)
        facts = self.health.monitor.facts()
        return {**facts, "lost_on_link": lost + self._dropped, "gaps": gaps}

    def next(self) -> tuple[Message] | tuple[str, str] | None:
        """Wait for what is to be handed on; None: it is closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._is_closed or self._waiting)
            return None if self._is_closed else self._waiting.popleft()

    def hand_on(self, arrived: tuple[Message] | tuple[str, str]) -> None:
        """Deliver a message, or report the end."""
        if len(arrived) == 1:
            self.health.monitor.passed()
            self._deliver(arrived[0])
        else:
            self.health.ended(*arrived)

    def _close(self) -> None:
        self.health.monitor.close()
        self._link.leave(self.health)
        with self._changed:
            self._is_closed = True
            self._changed.notify()
        if self._streams is not None:
            self._streams.close(self)


def _deliver_all(source: weakref.ref[FunctionSource]) -> None:
    """Hand on what comes, until the source is closed; the thread keeps no source alive."""
    while (target := source()) is not None and (arrived := target.next()) is not None:
        target.hand_on(arrived)
        del target, arrived


class FunctionSink(Sink):
    """An input that a function of the other manager takes from applications.

    A message is under way until the other manager has taken it; `send` waits for that. So at most
    one command is: where a command is not answered within its lifetime, the connection is broken,
    so that it does not arrive when the network is back.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        options: FunctionOptions,
        link: ManagerLink,
        report: Callable[[Sink, Health, str], object],
    ) -> None:
        super().__init__(endpoint)
        self.key = (endpoint.address[0], False, 0.0)
        self.health = _Monitored(endpoint, link, options, partial(report, self))
        self._link = link
        self._port = endpoint.address[1] if len(endpoint.address) > 1 else None
        self._streams: FunctionStreams | None = None

    def open(self, streams: FunctionStreams, timeout: float) -> None:
        """Open it; raises as `FunctionStreams.open`."""
        self._streams = streams
        streams.open(self, timeout)
        self._link.join(self.health)

    def opened(self, stream: RemoteStream[Message], standing: tuple[Message, ...]) -> None:
        """Take in that it is open; in the link's loop."""
        del standing
        self.health.stream = stream

    def came(self, message: Message) -> None:
        """Take nothing: it was asked to be sent to only."""

    def ended(self, state: str, cause: str) -> None:
        """Take in the end; in the link's loop."""
        self.health.ended(state, cause)

    def facts(self) -> Mapping[str, object]:
        """Return what the status shows."""
        return self.health.monitor.facts()

    def lifetime(self) -> float | None:
        """Return the seconds for which a command lives, here or there, whichever is less."""
        command, stream = self.endpoint.command, self.health.stream
        known = [] if command is None or command.lifetime is None else [command.lifetime]
        if stream is not None:
            port = self._port or (stream.inputs[0] if len(stream.inputs) == 1 else "default")
            known += [stream.lifetimes[port]] if port in stream.lifetimes else []
        return min(known, default=None)

    def _send(self, message: Message) -> None:
        stream = self.health.stream
        assert stream is not None, "opened before anything is sent"
        lifetime = self.lifetime()

        async def sending(_: RemoteRobot) -> None:
            await stream.send(message, self._port)

        try:
            self._link.run(sending, lifetime or self._link.timeout, f"Data {self.key[0]}")
        except BridgeTimeoutError:
            if lifetime is not None:
                self._link.drop()
            raise
        self.health.monitor.passed()

    def _close(self) -> None:
        self.health.monitor.close()
        self._link.leave(self.health)
        if self._streams is not None:
            self._streams.close(self)
