"""What is open at the other manager: streams, which channels share, and the channels."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable, Coroutine, Iterator, Mapping
from contextlib import suppress
from functools import partial
from typing import Any, TypeAlias

from uoarm.bridge import (
    ChannelHealth,
    ChannelMonitor,
    Delivery,
    ReceiveQueue,
    Sink,
    Source,
    on_failure,
)
from uoarm.client import RemoteRobot, RemoteStream
from uoarm.errors import BridgeTimeoutError, UoarmError
from uoarm.model import Endpoint, Health, Message, MessageStructure, Role, message_octets
from uoarm.schema import SchemaError, check
from uoarm_remote._discovery import read_plan, wanted_name
from uoarm_remote._link import ManagerLink
from uoarm_remote._options import FunctionOptions

Report: TypeAlias = Callable[[Health, str], object]
_Arrival: TypeAlias = "tuple[Message] | tuple[str, str]"  # a message, or state and cause of an end
_STANDING = 64
_UNPROVEN = 1024
_HELD_OCTETS = 67_108_864


class _NewestMessages:
    """The last messages that came: so many at most, and so much memory; the newest always stays."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._messages: deque[tuple[Message, int]] = deque()
        self._octets = 0

    def __len__(self) -> int:
        return len(self._messages)

    def __iter__(self) -> Iterator[Message]:
        return (message for message, _ in self._messages)

    def append(self, message: Message) -> int:
        """Keep a message; return how many have made room for it."""
        octets, before = message_octets(message), len(self)
        self._messages.append((message, octets))
        self._octets += octets
        while len(self) > self._most or (len(self) > 1 and self._octets > _HELD_OCTETS):
            self._octets -= self._messages.popleft()[1]
        return before + 1 - len(self)


class _Stream:
    """One request at the other manager. Everything in the link's loop."""

    def __init__(self) -> None:
        self.opening = asyncio.Lock()
        self.stream: RemoteStream[Message] | None = None
        self.members: dict[FunctionSource | FunctionSink, bool] = {}  # and whether each is open
        self.standing = _NewestMessages(_STANDING)
        # What has come since the other manager began anew, until it is known that all of it fits.
        self.unproven: _NewestMessages | None = None
        self.proving: asyncio.Task[None] | None = None

    def hand_on(self, stream: RemoteStream[Message], message: Message) -> None:
        """Hand a message to all that are open."""
        if self.unproven is not None:
            stream.lost += self.unproven.append(message)
            return
        if stream.latched:
            self.standing.append(message)
        for member, is_open in tuple(self.members.items()):
            if is_open:
                member.came(message)

    def end(self, stream: RemoteStream[Message]) -> None:
        """Notify all that are open that the function has ended there."""
        if self.stream is stream:
            self.stream = None
        for member, is_open in tuple(self.members.items()):
            if is_open:
                member.ended(stream.state, stream.cause)


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

        with on_failure(self.close, channel):
            self._link.run(opening, timeout, f"Request {channel.key[0]}")

    def close(self, channel: FunctionSource | FunctionSink) -> None:
        """Let go of what a channel has open; waits for nothing."""
        self._link.start(partial(self._leave, channel))

    async def _open(
        self,
        robot: RemoteRobot,
        channel: FunctionSource | FunctionSink,
        way: Mapping[str, Any],
    ) -> None:
        name, receive, every = channel.key
        shared = self._streams.setdefault(channel.key, _Stream())
        shared.members[channel] = False  # from now on what is open stays, for this one
        async with shared.opening:
            stream = shared.stream
            if stream is None or stream.ended:
                options: dict[str, Any] = {"receive": receive, "validate": "sampled"}
                if every:
                    options["every"] = every
                stream = await robot.ask("Request", name, jsonMessage=options, **way)
                shared.stream = stream
                shared.standing = _NewestMessages(_STANDING)
                self._opened(shared, channel, stream)
                shared.unproven = None
                prove = partial(self._prove, robot, shared, stream, way)
                stream.hand_over(
                    partial(shared.hand_on, stream),
                    partial(shared.end, stream),
                    partial(self._begin_to_prove, shared, stream, prove),
                )
            else:
                self._opened(shared, channel, stream)

    def _begin_to_prove(
        self,
        shared: _Stream,
        stream: RemoteStream[Message],
        prove: Callable[[], Coroutine[Any, Any, None]],
    ) -> None:
        stream.lost += len(shared.unproven or ())  # of a manager that has begun anew once more
        shared.unproven = _NewestMessages(_UNPROVEN)
        shared.standing = _NewestMessages(_STANDING)
        if shared.proving is not None:
            shared.proving.cancel()
        shared.proving = asyncio.ensure_future(prove())

    async def _prove(
        self,
        robot: RemoteRobot,
        shared: _Stream,
        stream: RemoteStream[Message],
        way: Mapping[str, Any],
    ) -> None:
        """Compare the structures of a manager that began anew with those that were proven."""
        try:
            plan = await robot.ask("Resolve", str(stream.request["type"]).partition(".")[0], **way)
        except UoarmError as error:
            plan = error
        loop = asyncio.get_running_loop()
        for member in tuple(shared.members):
            # The proof may take as long as its budget allows.
            why = await loop.run_in_executor(None, member.health.mismatch, plan)
            if why:
                shared.members.pop(member, None)
                member.ended("failed", f"the other manager has begun anew: {why}")
        waiting, shared.unproven = shared.unproven or (), None
        for message in waiting:
            shared.hand_on(stream, message)

    def _opened(
        self,
        shared: _Stream,
        channel: FunctionSource | FunctionSink,
        stream: RemoteStream[Message],
    ) -> None:
        channel.opened(stream, tuple(shared.standing))
        if channel in shared.members:  # not given up meanwhile
            shared.members[channel] = True

    async def _leave(self, channel: FunctionSource | FunctionSink) -> None:
        shared = self._streams.get(channel.key)
        if shared is None:
            return
        shared.members.pop(channel, None)
        async with shared.opening:  # one that joins meanwhile keeps it
            if shared.members or self._streams.get(channel.key) is not shared:
                return
            stream, shared.stream = shared.stream, None
            if stream is not None:
                # Where the link is down, this waits until it is up; what is opened again waits for
                # it: the other manager has one connection of a function for one client.
                with suppress(UoarmError):
                    await stream.kill()
            if not shared.members:
                del self._streams[channel.key]


class _Monitored:
    """The health of a channel, by what the link and the other manager say."""

    def __init__(
        self,
        endpoint: Endpoint,
        structure: MessageStructure,
        link: ManagerLink,
        options: FunctionOptions,
        report: Report,
    ) -> None:
        self._endpoint, self._structure, self._place = endpoint, structure, link.place
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

    def mismatch(self, plan: Mapping[str, Any] | UoarmError) -> str:
        """Say why messages are not surely those that were proven, by a plan of now; "": they are.

        Takes as long as a proof may.
        """
        proven = self._structure.schema
        try:
            if isinstance(plan, UoarmError):
                raise plan
            found = read_plan(plan, self._endpoint, self._place).message
            assert found is not None, "it is no service"
            is_input = self._endpoint.role is Role.INPUT
            verdict = check(*((proven, found.schema) if is_input else (found.schema, proven)))
        except (SchemaError, UoarmError) as error:
            return str(error)
        if verdict.compatible:
            return ""
        reasons = "; ".join(
            f"{reason.path or 'the message'}: {reason.sentence}" for reason in verdict.reasons
        )
        return f"its structure is another: {reasons or verdict.undecided:.500}"

    def ended(self, state: str, cause: str) -> None:
        """Take in that the function has ended there."""
        health = Health.FINISHED if state == "finished" else Health.LOST
        self.monitor.peer_reported(health, cause or f"it was {state} there")


class FunctionSource(Source):
    """An output of a function of the other manager.

    What comes waits in a queue, so that a consumer that is stuck holds up nothing else.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        structure: MessageStructure,
        options: FunctionOptions,
        link: ManagerLink,
        deliver: Delivery,
        report: Callable[[Source, Health, str], object],
    ) -> None:
        super().__init__(endpoint)
        self.key = (wanted_name(endpoint), True, options.every)
        self.health = _Monitored(endpoint, structure, link, options, partial(report, self))
        self._link, self._deliver = link, deliver
        self._streams: FunctionStreams | None = None
        self._queue: ReceiveQueue[_Arrival] = ReceiveQueue(
            f"uoarm-remote {self.key[0]}",
            self._hand_on,
            options.backlog,
            most_size=options.backlog_bytes,
            size=_size_of,
        )

    def open(self, streams: FunctionStreams, timeout: float) -> None:
        """Open it; raises as `FunctionStreams.open`."""
        self._streams = streams
        with on_failure(self._queue.close):
            streams.open(self, timeout)
        self._link.join(self.health)

    def opened(self, stream: RemoteStream[Message], standing: tuple[Message, ...]) -> None:
        """Take in that it is open; in the link's loop, before its first message."""
        self.health.stream = stream
        self.latched, self.depth = stream.latched, _STANDING if stream.latched else 1
        for message in standing:
            self.came(message)

    def came(self, message: Message) -> None:
        """Take one message; returns at once."""
        self._queue.put((message,))

    def ended(self, state: str, cause: str) -> None:
        """Take in the end, after what came before it."""
        self._queue.put((state, cause))

    def facts(self) -> Mapping[str, object]:
        """Return what the status shows."""
        stream = self.health.stream
        lost, gaps = (0, 0) if stream is None else (stream.lost, stream.gaps)
        facts = self.health.monitor.facts()
        return {**facts, "lost_on_link": lost + self._queue.dropped, "gaps": gaps}

    def _hand_on(self, arrived: _Arrival) -> None:
        if len(arrived) == 1:
            self.health.monitor.passed()
            self._deliver(arrived[0])
        else:
            self.health.ended(*arrived)

    def _close(self) -> None:
        self.health.monitor.close()
        self._link.leave(self.health)
        self._queue.close()
        if self._streams is not None:
            self._streams.close(self)


def _size_of(arrived: _Arrival) -> int:
    return message_octets(arrived[0]) if len(arrived) == 1 else 0


class FunctionSink(Sink):
    """An input that a function of the other manager takes from applications.

    A message is under way until the other manager has taken it; `send` waits for that. So at most
    one command is: where a command is not answered within its lifetime, the connection is broken,
    so that it does not arrive when the network is back.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        structure: MessageStructure,
        options: FunctionOptions,
        link: ManagerLink,
        report: Callable[[Sink, Health, str], object],
    ) -> None:
        super().__init__(endpoint)
        self.key = (endpoint.address[0], False, 0.0)
        self.health = _Monitored(endpoint, structure, link, options, partial(report, self))
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

        try:
            self._link.ask_at_once(
                "Data",
                partial(stream.question, message, self._port),
                lifetime or self._link.timeout,
            )
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
