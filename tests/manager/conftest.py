"""Robots for the manager's tests: real Python components behind the real `python` bridge."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from tests.manager import stage

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.testing import MemoryBridge

HERE = Path(__file__).parent


@pytest.fixture(autouse=True)
def _fresh_stage() -> Iterator[None]:
    stage.reset()
    yield
    stage.release()


@pytest.fixture
def memory() -> MemoryBridge:
    return MemoryBridge()


@pytest.fixture
def make_robot() -> Iterator[Callable[[str], RobotManager]]:
    robots: list[RobotManager] = []

    def make(text: str) -> RobotManager:
        robot = RobotManager(loads(text, origin=str(HERE / "robot.yaml")))
        robots.append(robot)
        return robot

    yield make
    stage.release()
    for robot in robots:
        robot.close()
