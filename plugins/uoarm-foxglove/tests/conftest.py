"""A robot of plain Python components, and servers before it; everything is on loopback."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # for the modules that the tests share

from components import CONFIGURATION, renew
from tests.server.serving import servers  # type: ignore[import-not-found]
from viewer import Serve

from uoarm import RobotManager
from uoarm.config import loads


@pytest.fixture
def robot() -> Iterator[RobotManager]:
    renew()
    manager = RobotManager(loads(CONFIGURATION, origin=str(Path(__file__).parent / "robot.yaml")))
    yield manager
    renew()
    manager.close()


@pytest.fixture
def serve(robot: RobotManager) -> Iterator[Serve]:
    with servers(robot) as start:
        yield start
