"""What is watched goes on with the provider that comes back."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path

import pytest
from agents import TOKENS, Agents
from mcp.client.client import Client
from mcp.server.subscriptions import ResourceUpdated
from tests.server.serving import servers  # type: ignore[import-not-found]
from uoarm_mcp._streams import AgentStreams

from uoarm import RobotManager
from uoarm.bridge import Registry
from uoarm.config import loads
from uoarm.model import LeaseHolder, ValidationMode
from uoarm.server import Server, ServerOptions
from uoarm.server.front_end import FeedKey, LimitError
from uoarm.testing import Emitter, MemoryBridge, patience, wait

ROBOT = """
version: 1
bridges: {memory: {plugin: python}}
functions:
  level: {components: [{name: level, bridge: memory, output: {endpoint: [level]}}]}
"""
URI = "uoarm://stream/level"


@pytest.fixture
def memory() -> MemoryBridge:
    return MemoryBridge()


@pytest.fixture
def emitter(memory: MemoryBridge) -> Emitter:
    return memory.emitter("level", {"type": "integer"})


@pytest.fixture
def robot(memory: MemoryBridge, emitter: Emitter) -> Iterator[RobotManager]:
    del emitter
    with RobotManager(loads(ROBOT), registry=Registry(()), bridges={"memory": memory}) as robot:
        yield robot


def test_a_stream_that_could_not_be_had_is_watched_as_soon_as_it_can(
    memory: MemoryBridge, access: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uoarm_mcp._service.AGAIN_SECONDS", 0.01)
    configuration = loads(ROBOT)

    async def listen(client: Client, robot: RobotManager) -> None:
        async with client.listen(resource_subscriptions=["uoarm://stream/no", URI]) as listening:
            changed = asyncio.ensure_future(anext(aiter(listening)))
            await client.list_tools()  # so it has been looked for
            assert not robot.connections()
            emitter = memory.emitter("level", {"type": "integer"})

            def is_watched() -> bool:
                emitter.emit(1)
                return changed.done()

            await asyncio.to_thread(wait, is_watched, "it is watched")
            assert await changed == ResourceUpdated(uri=URI)

    with (
        RobotManager(configuration, registry=Registry(()), bridges={"memory": memory}) as robot,
        servers(robot, front_end_ports={"mcp": 0}) as start,
        Agents(start(access=access).ports, TOKENS) as agents,
    ):
        agents.run(listen(agents.client("agent", "2026-07-28"), robot))


async def test_what_was_just_opened_makes_no_room(
    robot: RobotManager, emitter: Emitter, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uoarm_mcp._streams._MOST_OPEN", 1)
    server = Server(robot, ServerOptions(port=0))
    await server.start()
    client = server.stateless_clients.local("")
    streams = AgentStreams(server.backend, client.account, LeaseHolder("an agent", ""))
    try:
        read = asyncio.ensure_future(streams.read("level", 1, patience(), latest=True))
        # That it is open is seen here before who asked for it goes on.
        while not (streams.open or read.done()):  # noqa: ASYNC110 - each turn of the loop
            await asyncio.sleep(0)
        with pytest.raises(LimitError, match="1 streams are in use"):
            await streams.take(FeedKey("level", ValidationMode.ALWAYS, receive=False))
        emitter.emit(7)
        collector, _ = await read
        assert collector.messages == [7]
    finally:
        streams.close()
        await server.stop()


def test_a_stream_that_failed_is_watched_again(
    robot: RobotManager,
    memory: MemoryBridge,
    emitter: Emitter,
    access: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("uoarm_mcp._streams.AGAIN_SECONDS", 0.01)

    async def listen(client: Client) -> None:
        async with client.listen(resource_subscriptions=[URI]) as subscription:
            events = aiter(subscription)
            first = asyncio.ensure_future(anext(events))

            def is_watched() -> bool:
                emitter.emit(1)  # until it is watched none of it comes
                return first.done()

            await asyncio.to_thread(wait, is_watched, "it is watched")
            memory.die("level")
            assert await anext(events) == ResourceUpdated(uri=URI), "its end is a change"
            await asyncio.to_thread(wait, lambda: not robot.connections(), "it has failed")
            memory.emitter("level", {"type": "integer"})
            await asyncio.to_thread(wait, robot.connections, "it is watched again")

    with (
        servers(robot, front_end_ports={"mcp": 0}) as start,
        Agents(start(access=access).ports, TOKENS) as agents,
    ):
        agents.run(listen(agents.client("agent", "2026-07-28")))
