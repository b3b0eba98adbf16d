"""Every subscriber of a latched topic gets what stands, whatever came before it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from played import bridge_to, stream
from ros import Enter, url

from uoarm import RobotManager
from uoarm.bridge import Registry
from uoarm.config import loads
from uoarm.model import Endpoint, Role
from uoarm.server import Server
from uoarm.testing import Collector, Emitter, MemoryBridge

ROBOT = """
version: 1
bridges: {memory: {plugin: python}}
functions: {map: {components: [{name: map, bridge: memory, output: {endpoint: [map]}}]}}
"""
NUMBER = {"type": "object", "properties": {"data": {"type": "integer"}}, "required": ["data"]}


@pytest.fixture
def latched() -> tuple[MemoryBridge, Emitter]:
    memory = MemoryBridge()
    return memory, memory.emitter("map", NUMBER, latched=True)


@pytest.fixture
def robot(latched: tuple[MemoryBridge, Emitter]) -> Iterator[RobotManager]:
    bridges = {"memory": latched[0]}
    with RobotManager(loads(ROBOT), registry=Registry(()), bridges=bridges) as robot:
        yield robot


def test_a_second_subscriber_gets_the_last_of_each_writer_at_any_rate(
    enter: Enter, latched: tuple[MemoryBridge, Emitter]
) -> None:
    first, second = enter(), enter()
    _, emitter = latched
    emitter.emit({"data": 0}, "a")
    first.send(op="subscribe", topic="/uoarm/map")
    assert first.messages(1) == [{"data": 0}]
    emitter.emit({"data": 1}, "b")
    emitter.emit({"data": 2}, "a")
    assert first.messages(2) == [{"data": 1}, {"data": 2}]
    second.send(op="subscribe", topic="/uoarm/map", throttle_rate=60_000)
    assert second.messages(2) == [{"data": 1}, {"data": 2}]


def test_a_second_subscription_of_a_client_gets_what_stands(
    enter: Enter, latched: tuple[MemoryBridge, Emitter]
) -> None:
    client, publisher = enter(), enter()
    latched[1].emit({"data": 0}, "a")
    publisher.send(op="publish", topic="/map", type="a/Map", latch=True, msg={"data": 0})
    publisher.call("/rosapi/get_time")
    for topic in ("/uoarm/map", "/map"):
        for identity in ("1", "2"):
            client.send(op="subscribe", id=identity, topic=topic)
            assert client.messages(1) == [{"data": 0}]
    client.call("/rosapi/get_time")


def test_what_clients_latched_stands_for_each_of_them(enter: Enter) -> None:
    publishers, seen, late, after = (enter(), enter()), enter(), enter(), enter()
    seen.send(op="subscribe", topic="/tf_static", type="a/Tf")
    for number, publisher in enumerate(publishers):
        publisher.send(op="advertise", topic="/tf_static", type="a/Tf", latch=True)
        publisher.send(op="publish", topic="/tf_static", msg={"data": number})
        assert seen.messages(1) == [{"data": number}]  # it waited for the type
    late.send(op="subscribe", topic="/tf_static", throttle_rate=60_000)
    assert late.messages(2) == [{"data": 0}, {"data": 1}]
    publishers[0].send(op="unadvertise", topic="/tf_static")
    publishers[0].call("/rosapi/get_time", {})
    after.send(op="subscribe", topic="/tf_static")
    assert after.messages(1) == [{"data": 1}]
    after.call("/rosapi/get_time", {})


def test_a_second_source_on_a_latched_topic_gets_what_stands(
    server: Server, latched: tuple[MemoryBridge, Emitter]
) -> None:
    latched[1].emit({"data": 0}, "a")
    collectors = Collector(), Collector(), Collector()
    with bridge_to(url(server)) as bridge:
        for collector, is_latched in zip(collectors, (False, True, False), strict=True):
            endpoint = Endpoint(
                "far", "map", Role.OUTPUT, ("/uoarm/map",), options={"latch": is_latched}
            )
            bridge.open_source(endpoint, stream(bridge, endpoint), collector.deliver)
            if collector is not collectors[2]:
                assert collector.wait(1) == [{"data": 0}]
        latched[1].emit({"data": 1}, "a")
        assert [collector.wait(2)[-1:] for collector in collectors[:2]] == [[{"data": 1}]] * 2
        assert collectors[2].wait(1) == [{"data": 1}]
