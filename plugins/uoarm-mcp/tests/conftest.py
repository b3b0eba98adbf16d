"""A robot of plain Python components, servers before it, and the SDK's own clients."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # for the modules that the tests share

from agents import ACCESS, TOKENS, Agents
from components import CONFIGURATION, script
from tests.profiles import load_profile  # type: ignore[import-not-found]
from tests.server.serving import access_file, servers  # type: ignore[import-not-found]

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.server import Server

load_profile(50, 2000)

Serve = Callable[..., Server]


@pytest.fixture
def robot() -> Iterator[RobotManager]:
    script.reset()
    manager = RobotManager(loads(CONFIGURATION, origin=str(Path(__file__).parent / "robot.yaml")))
    yield manager
    script.release()
    manager.close()


@pytest.fixture
def serve(robot: RobotManager) -> Iterator[Serve]:
    with servers(robot, front_end_ports={"mcp": 0}) as start:
        yield start


@pytest.fixture
def access(tmp_path: Path) -> Path:
    return access_file(tmp_path, ACCESS, TOKENS)  # type: ignore[no-any-return]


@pytest.fixture
def agents(serve: Serve, access: Path) -> Iterator[Agents]:
    """Clients of a server with an access file, by the names of their tokens."""
    server = serve(access=access)
    with Agents(server.ports, TOKENS) as made:
        yield made
