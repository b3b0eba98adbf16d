"""The example's page is true: every command on it runs, in real processes, as it stands."""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO

import pytest
from peers import own_line
from tests.processes import hold_ends_unread, run_python  # type: ignore[import-not-found]

from uoarm._control import RobotManager
from uoarm.testing import patience

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "examples" / "ros2"
BLOCKS = re.findall(r"```\n(.*?)```", (EXAMPLE / "README.md").read_text(), re.DOTALL)
Run = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def run() -> Iterator[Run]:
    """Starts commands as a shell in the root of the repository would, and ends them all."""
    started: list[subprocess.Popen[str]] = []
    tools = {"python": sys.executable, "uoarm": str(Path(sys.executable).with_name("uoarm"))}

    def start(command: str, *, with_log: bool = False) -> subprocess.Popen[str]:
        program, *arguments = shlex.split(command)
        process = subprocess.Popen(
            [tools[program], *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT if with_log else None,
            text=True,
            cwd=ROOT,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )
        started.append(process)
        return process

    yield start
    for process in started:
        process.kill()
        process.communicate()


def commands(block: int) -> list[str]:
    """The commands of one block of the page, without what installs."""
    lines = BLOCKS[block].splitlines()
    return [line for line in lines if not line.startswith("pip install")]


def in_background(run: Run, command: str) -> None:
    """Start a node and wait until it says that it is there."""
    assert " on /" in lines(run(command.removesuffix("&")).stdout, 1)[0]


def lines(stream: IO[str] | None, count: int) -> list[str]:
    assert stream is not None
    return [own_line(stream) for _ in range(count)]


def interrupted(process: subprocess.Popen[str]) -> int:
    """The exit code after Ctrl-C, which must end it in time."""
    process.send_signal(signal.SIGINT)
    return process.wait(patience())


def test_messages_of_a_talker_started_by_hand_arrive(run: Run) -> None:
    talker, request = commands(0)
    in_background(run, talker)
    received = run(request)
    numbers = [int(re.findall(r'"hello (\d+)"', line)[0]) for line in lines(received.stdout, 3)]
    assert numbers == list(range(numbers[0], numbers[0] + 3))
    assert interrupted(received) == 130


def test_the_doctor_says_what_is_used(run: Run) -> None:
    (doctor,) = commands(1)
    text, _ = run(doctor).communicate(timeout=patience())
    for word in ("rclpy", "distribution", "rmw", "domain"):
        assert re.search(rf"^  {word} +\S", text, re.MULTILINE), text


def test_a_camera_of_ros_feeds_python_which_feeds_ros(run: Run) -> None:
    camera, listener, resolve, request = commands(2)
    in_background(run, camera)
    faces = run(listener.removesuffix("&"))
    resolving = run(resolve)
    plan, _ = resolving.communicate(timeout=patience())
    assert resolving.returncode == 0
    assert all(word in plan for word in ("ros_camera", "detector", "face_topic", "is_bigendian"))
    chain = run(request)
    seen = lines(faces.stdout, 5)
    assert all(line.startswith("face at (") and "48 x 48" in line for line in seen)
    hold_ends_unread(sys.executable, str(EXAMPLE / "listener.py"))
    assert interrupted(chain) == 130


@pytest.mark.parametrize("name", ["talker", "listener"])
def test_a_wrong_argument_is_refused(name: str) -> None:
    done = run_python(EXAMPLE / f"{name}.py", "x")
    assert done.returncode == 2
    assert done.stderr.endswith(f"{name}.py: error: argument most: invalid int value: 'x'\n")


def test_every_command_of_the_page_is_run_here() -> None:
    assert [len(commands(block)) for block in range(len(BLOCKS))] == [2, 1, 4]


def test_the_status_shows_what_ros_knows(run: Run) -> None:
    in_background(run, commands(0)[0])
    with RobotManager.from_file(EXAMPLE / "robot.yaml") as robot, robot.request("chatter") as chat:
        chat.get(timeout=patience())
        ((channel,),) = (component.channels for component in robot.status().components)
    facts = dict(channel.facts)
    assert channel.port == "output.default"
    assert facts["matched"] == 1
    assert str(facts["qos"]).startswith("reliable, volatile")


def test_the_tutorials_spare_takes_over(run: Run, tmp_path: Path) -> None:
    page = (ROOT / "docs" / "tutorial-ros2.md").read_text(encoding="utf-8")
    [configuration] = re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)
    nodes = re.findall(r"^(python .*) &$", page, re.MULTILINE)
    [warning] = re.findall(r" WARNING (.*)$", page, re.MULTILINE)
    blocks = re.findall(r"^```(\w*)\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    discovered, plan, _ = (text for language, text in blocks if not language)
    file = tmp_path / "robot.yaml"
    file.write_text(configuration, encoding="utf-8")
    talker = run(nodes[0])
    assert lines(talker.stdout, 1) == ["talking on /chatter\n"]
    seen = run(f"uoarm discover -f {file}").communicate(timeout=patience())[0]
    assert discovered.rstrip() in seen
    explained = run(f"uoarm resolve chatter --explain -f {file}")
    assert explained.communicate(timeout=patience())[0] == plan
    in_background(run, nodes[1])
    received = run(f"uoarm request chatter -f {file}", with_log=True)
    assert "hello" in lines(received.stdout, 1)[0]
    talker.kill()
    while warning not in (line := lines(received.stdout, 1)[0]):
        assert "connection c1 replaced" not in line
    assert "hello" in lines(received.stdout, 1)[0]
    assert interrupted(received) == 130


def test_nodes_of_examples_and_tests_end_at_a_signal() -> None:
    """A wait without a limit in rclpy, or its own signal handler, may outlive a signal.

    Of 360 nodes that waited in `spin()` six did not end at SIGTERM (rclpy 7.1); with a limit and
    rclpy's handler one hung as it exited.
    """
    nodes = [
        path
        for folder in (ROOT / "examples", *(ROOT / "plugins").glob("*/tests"))
        for path in folder.rglob("*.py")
        if re.search(r"^import rclpy$", text := path.read_text(), re.MULTILINE)
        and "SIGTERM" in text
    ]
    assert len(nodes) >= 10
    for node in nodes:
        text = node.read_text()
        assert not re.search(r"[.]spin[(]", text), node
        assert re.search(r"SignalHandlerOptions[.]NO", text), node
