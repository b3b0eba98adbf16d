"""Clients that command what one sender at a time may: with the priority of their role."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from ros import Ros, url
from tests.leases import (  # type: ignore[import-not-found]
    ACCESS,
    TOKENS,
    lease,
    leased_robot,
)
from tests.server.serving import access_file  # type: ignore[import-not-found]

from uoarm import RobotManager
from uoarm.server import Server, ServerOptions, serve_in_thread
from uoarm.testing import MemoryBridge, wait
from uoarm.testing._components import Taker

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
    with leased_robot(memory, stop="{v: 0}") as robot:
        yield robot


@pytest.fixture
def server(robot: RobotManager, tmp_path: Path) -> Iterator[Server]:
    with serve_in_thread(
        robot, ServerOptions(port=0, access=access_file(tmp_path, ACCESS, TOKENS))
    ) as server:
        yield server


def enter(server: Server, role: str) -> Ros:
    return Ros(url(server, f"/rosbridge?token={TOKENS[role]}"))


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
        held = lease(robot).holder
        assert held is not None
        assert held.role == "driver"
        assert second.refused(**drive(2)).startswith(f"leased: base.default: {held} holds")
        with enter(server, "safety") as fence:
            fence.send(**drive(3))
            wait(lambda: taken() == [1, 3])
            assert "(safety) holds its lease" in first.refused(**drive(4))
        wait(lambda: taken() == [1, 3, 0])
        wait(lambda: lease(robot).holder is None)
        second.send(**drive(5))
        wait(lambda: taken() == [1, 3, 0, 5])
        second.send(op="unadvertise", topic="/uoarm/drive")
        wait(lambda: taken() == [1, 3, 0, 5, 0])
