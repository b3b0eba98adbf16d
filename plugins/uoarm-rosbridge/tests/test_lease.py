"""Clients that command what one sender at a time may: with the priority of their role."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from ros import Ros, url

from uoarm import RobotManager
from uoarm.bridge import Registry
from uoarm.config import loads
from uoarm.model import LeaseHolder
from uoarm.server import Server, ServerOptions, hash_token, make_token, serve_in_thread
from uoarm.testing import MemoryBridge, wait
from uoarm.testing._components import Taker

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
          lease: {duration: 3600, priorities: {safety: 10}}
"""
SPEED = {"type": "object", "properties": {"v": {"type": "integer"}}, "required": ["v"]}
ACCESS = """
version: 1
roles:
  driver: {{see: ["*"], send: ["*"]}}
  safety: {{see: ["*"], send: ["*"]}}
tokens:
  - {{name: driver, role: driver, sha256: {driver}}}
  - {{name: safety, role: safety, sha256: {safety}}}
"""
TOKENS = {name: make_token() for name in ("driver", "safety")}


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


@pytest.fixture
def server(robot: RobotManager, tmp_path: Path) -> Iterator[Server]:
    access = tmp_path / "access.yaml"
    hashes = {name: hash_token(token) for name, token in TOKENS.items()}
    access.write_text(ACCESS.format(**hashes), encoding="utf-8")
    with serve_in_thread(robot, ServerOptions(port=0, access=access)) as server:
        yield server


def enter(server: Server, role: str) -> Ros:
    return Ros(url(server, f"/rosbridge?token={TOKENS[role]}"))


def holder(robot: RobotManager) -> LeaseHolder | None:
    (component,) = robot.status().components
    lease = component.channels[0].lease
    assert lease is not None
    return lease.holder


def drive(speed: int) -> dict[str, Any]:
    return {"op": "publish", "topic": "/uoarm/drive", "msg": {"v": speed}}


def test_a_role_takes_over_and_what_a_client_moved_that_is_gone_stops(
    server: Server, robot: RobotManager, base: Taker
) -> None:
    def taken() -> list[Any]:
        return [message["v"] for message in base.taken.messages]

    with enter(server, "driver") as first, enter(server, "driver") as second:
        first.send(**drive(1))
        wait(lambda: taken() == [1])
        held = holder(robot)
        assert held is not None
        assert held.role == "driver"
        assert second.refused(**drive(2)).startswith(f"leased: base.default: {held} holds")
        with enter(server, "safety") as fence:
            fence.send(**drive(3))
            wait(lambda: taken() == [1, 3])
            assert "(safety) holds its lease" in first.refused(**drive(4))
        wait(lambda: taken() == [1, 3, 0])
        wait(lambda: holder(robot) is None)
        second.send(**drive(5))
        wait(lambda: taken() == [1, 3, 0, 5])
        second.send(op="unadvertise", topic="/uoarm/drive")
        wait(lambda: taken() == [1, 3, 0, 5, 0])
