"""Every client of a latched output gets what stands, with its own number, however it joins."""

from __future__ import annotations

import asyncio
import itertools
import threading
from collections.abc import Iterator
from contextlib import ExitStack

import pytest
from tests.server.conftest import Serve
from tests.server.talk import Talk

from uoarm import RobotManager
from uoarm.bridge import Registry
from uoarm.client import connect
from uoarm.config import loads
from uoarm.testing import Background, Emitter, MemoryBridge, patience

ROBOT = """
version: 1
bridges: {memory: {plugin: python}}
failover: {wait: 60}
functions:
  map:
    components:
      - {name: map, bridge: memory, priority: 2, output: {endpoint: [map]}}
      - {name: spare, bridge: memory, priority: 1, output: {endpoint: [spare]}}
  ticks: {components: [{name: ticks, bridge: memory, output: {endpoint: [ticks]}}]}
"""
FORMS = pytest.mark.parametrize("binary", [False, True], ids=["json", "cbor"])


@pytest.fixture
def latched(memory: MemoryBridge) -> Emitter:
    return memory.emitter("map", {}, latched=True)


@pytest.fixture
def robot(memory: MemoryBridge, latched: Emitter) -> Iterator[RobotManager]:
    memory.emitter("spare", {}, latched=True).emit("spare")
    memory.emitter("ticks", {})
    bridges = {"memory": memory}
    with RobotManager(loads(ROBOT), registry=Registry(()), bridges=bridges) as robot:
        yield robot


def numbered(client: Talk, connection: str, count: int) -> list[tuple[int, object]]:
    """Return messages with their numbers."""
    came = [client.next(connection) for _ in range(count)]
    assert {item["type"] for item in came} <= {connection}
    return [(item["x-number"], item["jsonMessage"]) for item in came]


@FORMS
def test_a_second_client_gets_what_stands_with_its_own_number(
    serve: Serve, latched: Emitter, binary: bool
) -> None:
    url = f"ws://127.0.0.1:{serve().ports[0]}/"
    latched.emit("first")
    with ExitStack() as stack:
        clients = [stack.enter_context(Talk(url, binary=binary)) for _ in range(3)]
        connection = clients[0].open("map")
        assert numbered(clients[0], connection, 1) == [(1, "first")]
        assert clients[1].open("map") == connection
        assert numbered(clients[1], connection, 1) == [(1, "first")]
        latched.emit("second")
        for client in clients[:2]:
            assert numbered(client, connection, 1) == [(2, "second")]
        assert clients[2].open("map") == connection
        assert numbered(clients[2], connection, 1) == [(2, "second")]
        latched.emit("third")
        for client in clients:
            assert numbered(client, connection, 1) == [(3, "third")]


def test_the_last_of_each_writer_comes_to_every_client(serve: Serve, latched: Emitter) -> None:
    url = f"ws://127.0.0.1:{serve().ports[0]}/"
    with Talk(url) as first, Talk(url) as second:
        connection = first.open("map")
        for number, writer in enumerate("aabac"):
            latched.emit(number, writer)
        assert [number for number, _ in numbered(first, connection, 5)] == [1, 2, 3, 4, 5]
        latched.clear("c")
        second.open("map", every=1000)
        assert numbered(second, connection, 2) == [(3, 2), (4, 3)]


def test_what_takes_over_stands_for_who_comes_later(
    serve: Serve, memory: MemoryBridge, latched: Emitter
) -> None:
    url = f"ws://127.0.0.1:{serve().ports[0]}/"
    latched.emit("first")
    with Talk(url) as first, Talk(url) as second:
        connection = first.open("map")
        assert numbered(first, connection, 1) == [(1, "first")]
        memory.die("map", "unplugged")
        assert numbered(first, connection, 1) == [(2, "spare")]
        second.open("map")
        assert numbered(second, connection, 1) == [(2, "spare")]


def test_nothing_comes_twice_to_who_joins_while_messages_come(
    serve: Serve, latched: Emitter
) -> None:
    """Whatever waits for the loop as it joins: what stands, then every message without a gap."""
    url, ended = f"ws://127.0.0.1:{serve().ports[0]}/", threading.Event()

    def emit() -> int:
        numbers = itertools.count(1)
        while not ended.wait(0.005):
            latched.emit(next(numbers))
        return next(numbers)

    with ExitStack() as stack:
        first = stack.enter_context(Talk(url))
        connection = first.open("map", queue={"length": 1000})
        emitting = Background(emit)
        numbered(first, connection, 1)
        clients, begun = [first], [1]
        for _ in range(5):
            clients.append(stack.enter_context(Talk(url)))
            clients[-1].open("map", queue={"length": 1000})
            begun += [number for number, _ in numbered(clients[-1], connection, 1)]
        ended.set()
        last = emitting.result(patience()) - 1
        for client, begin in zip(clients, begun, strict=True):
            rest = list(range(begin + 1, last + 1))
            came = numbered(client, connection, len(rest))
            assert came == list(zip(rest, rest, strict=True))


async def test_a_client_that_comes_later_counts_nothing_as_lost(
    serve: Serve, latched: Emitter
) -> None:
    port = serve().ports[0]

    address = f"ws://127.0.0.1:{port}/"
    async with connect(address) as first, connect(address) as second:
        before = await first.request("map")
        for number, writer in enumerate("abccc"):
            await asyncio.to_thread(latched.emit, number, writer)
        assert [await before.get(patience()) for _ in range(5)] == [0, 1, 2, 3, 4]
        stream = await second.request("map")
        assert [await stream.get(patience()) for _ in range(3)] == [0, 1, 4]
        await asyncio.to_thread(latched.emit, 5, "a")
        assert await stream.get(patience()) == 5
        assert stream.lost == 0
