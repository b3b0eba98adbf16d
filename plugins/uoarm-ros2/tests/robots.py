"""Managers of robots whose components are of ROS 2, and what serves them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from peers import OPTIONS

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.server import ServerOptions, serve_in_thread
from uoarm.testing import patience

HOSTED = f", host: {{silence: {patience()}, start: {patience()}}}"
"""What is behind the options of a bridge that has a process of its own."""


def robot(
    functions: str, more: str = "", *, host: str = "", definitions: Path | None = None
) -> RobotManager:
    """A manager of functions whose components are of the bridges `ros` and `python`."""
    folders = f', definitions: ["{definitions}"]' if definitions else ""
    text = f"""
version: 1
{more}
bridges:
  ros: {{plugin: ros2, options: {{{OPTIONS}{folders}}}{host}}}
  python: {{plugin: python}}
functions:
{functions}
"""
    return RobotManager(loads(text, origin=str(Path(__file__).with_name("robot.yaml"))))


@contextmanager
def rosbridge(functions: str) -> Iterator[tuple[RobotManager, str]]:
    """Such a manager, and the URL where clients of rosbridge reach it."""
    with (
        robot(functions) as manager,
        serve_in_thread(manager, ServerOptions(port=0)) as server,
    ):
        yield manager, f"ws://127.0.0.1:{server.ports[0]}/rosbridge"
