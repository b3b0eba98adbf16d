"""A viewer that goes gives its leases back, and what it moved stops, though others hold it open."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest
from viewer import Viewer

from uoarm import RobotManager
from uoarm.bridge import Registry
from uoarm.config import loads
from uoarm.model import LeaseHolder
from uoarm.server import ServerOptions, serve_in_thread
from uoarm.testing import MemoryBridge, Taker, wait

ROBOT = """
version: 1
bridges: {memory: {plugin: python}}
functions:
  drive:
    components:
      - name: base
        bridge: memory
        input:
          endpoint: [base]
          lifetime: 3600
          stop: {message: {v: 0}}
          lease: {duration: 3600}
"""
SPEED = {"type": "object", "properties": {"v": {"type": "integer"}}, "required": ["v"]}


@pytest.fixture
def memory() -> MemoryBridge:
    return MemoryBridge()


@pytest.fixture
def base(memory: MemoryBridge) -> Taker:
    return memory.taker("base", SPEED)


@pytest.fixture
def robot(memory: MemoryBridge, base: Taker) -> Iterator[RobotManager]:
    del base
    with RobotManager(loads(ROBOT), registry=Registry(()), bridges={"memory": memory}) as robot:
        yield robot


def holder(robot: RobotManager) -> LeaseHolder | None:
    (component,) = robot.status().components
    lease = component.channels[0].lease
    assert lease is not None
    return lease.holder


@pytest.mark.parametrize("ending", ["it unadvertises", "it goes"])
def test_what_a_viewer_moved_stops_as_it_ends(
    robot: RobotManager, base: Taker, ending: str
) -> None:
    def taken() -> list[Any]:
        return [message["v"] for message in base.taken.messages]

    def advertise(viewer: Viewer) -> None:
        viewer.send("advertise", channels=[{"id": 1, "topic": "/drive", "encoding": "json"}])

    with (
        robot.request("drive"),
        serve_in_thread(robot, ServerOptions(port=0)) as server,
        Viewer(server) as second,
    ):
        advertise(second)
        with Viewer(server) as first:
            advertise(first)
            first.publish(1, json.dumps({"v": 1}).encode())
            wait(lambda: taken() == [1], "the command did not arrive")
            assert holder(robot) is not None
            if ending == "it unadvertises":
                first.send("unadvertise", channelIds=[1])
                wait(lambda: holder(robot) is None, "its lease was not given back")
        wait(lambda: holder(robot) is None, "its lease was not given back")
        wait(lambda: taken() == [1, 0], "what it moved was not stopped")
        second.publish(1, json.dumps({"v": 2}).encode())
        wait(lambda: taken() == [1, 0, 2], "another cannot command it")
