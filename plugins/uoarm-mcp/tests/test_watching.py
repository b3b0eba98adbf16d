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

from uoarm import RobotManager
from uoarm.bridge import Registry
from uoarm.config import loads
from uoarm.testing import Emitter, MemoryBridge, wait

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


def test_a_stream_that_failed_is_watched_again(
    robot: RobotManager,
    memory: MemoryBridge,
    emitter: Emitter,
    access: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("uoarm_mcp._streams._AGAIN_SECONDS", 0.01)

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
