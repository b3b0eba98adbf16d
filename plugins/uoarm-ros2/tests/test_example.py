"""The example runs: a node started by hand is heard, and a mixed chain goes through three hands."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from uoarm.manager import RobotManager

EXAMPLE = Path(__file__).parents[3] / "examples" / "ros2"


@contextmanager
def node(name: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """Run one of the example's nodes."""
    command = [sys.executable, str(EXAMPLE / f"{name}.py"), *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def test_a_talker_started_by_hand_is_heard() -> None:
    with (
        node("talker"),
        RobotManager.from_file(EXAMPLE / "robot.yaml") as robot,
        robot.request("chatter", validate="always") as chatter,
    ):
        numbers = [int(chatter.get(timeout=10.0)["data"].removeprefix("hello ")) for _ in range(3)]
        assert numbers == list(range(numbers[0], numbers[0] + 3))
        assert robot.status().routes[0].invalid == 0


def test_a_camera_of_ros_feeds_python_which_feeds_ros() -> None:
    with (
        node("camera"),
        node("listener", "5") as listener,
        RobotManager.from_file(EXAMPLE / "robot.yaml") as robot,
        robot.request("faceTopic", validate="always"),
    ):
        assert listener.stdout is not None
        lines = [listener.stdout.readline() for _ in range(5)]
        assert all(line.startswith("face at (") and "48 x 48" in line for line in lines)
        assert {route.invalid for route in robot.status().routes} == {0}
