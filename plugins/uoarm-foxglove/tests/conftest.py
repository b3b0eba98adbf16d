"""A robot of plain Python components, and servers before it; everything is on loopback."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # for the modules that the tests share

from components import CONFIGURATION, renew
from viewer import Serve

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.server import Limits, Server, ServerOptions, serve_in_thread


@pytest.fixture
def robot() -> Iterator[RobotManager]:
    renew()
    manager = RobotManager(loads(CONFIGURATION, origin=str(Path(__file__).parent / "robot.yaml")))
    yield manager
    renew()
    manager.close()


@pytest.fixture
def serve(robot: RobotManager) -> Iterator[Serve]:
    """Start a server; settings and limits by name."""
    with ExitStack() as stack:

        def start(limits: Limits | None = None, **more: Any) -> Server:
            chosen = ServerOptions(port=0, limits=limits or Limits(), **more)
            return stack.enter_context(serve_in_thread(robot, chosen))

        yield start
