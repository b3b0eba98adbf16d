"""A robot of plain Python components, and servers before it; everything is on loopback."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # for the modules that the tests share

from components import CONFIGURATION, cancelled
from played import ANSWERS, Played
from ros import Enter, Ros, Serve, url
from tests.profiles import load_profile  # type: ignore[import-not-found]
from tests.server.robot import script  # type: ignore[import-not-found]
from tests.server.serving import servers  # type: ignore[import-not-found]

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.server import Server

load_profile(60, 2000)


@pytest.fixture
def robot() -> Iterator[RobotManager]:
    script.reset()
    cancelled.clear()
    manager = RobotManager(loads(CONFIGURATION, origin=str(Path(__file__).parent / "robot.yaml")))
    yield manager
    script.release()
    manager.close()


@pytest.fixture
def serve(robot: RobotManager) -> Iterator[Serve]:
    with servers(robot) as start:
        yield start


@pytest.fixture
def server(serve: Serve) -> Server:
    return serve()


@pytest.fixture
def enter(server: Server) -> Iterator[Enter]:
    """Connect a client to the server."""
    with ExitStack() as stack:
        yield lambda: stack.enter_context(Ros(url(server)))


@pytest.fixture
def played() -> Iterator[Played]:
    """A server whose answers a test writes."""
    server = Played(ANSWERS)
    yield server
    server.close()
