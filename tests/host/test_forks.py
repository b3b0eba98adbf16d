"""A child that is forked ends nothing of its parent's: no host, no link, no connection."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from tests.host.hosted import COMPONENTS
from tests.processes import run_python

import uoarm
from uoarm.testing import patience

PROGRAM = """
import atexit, os, signal, sys
from contextlib import ExitStack
from functools import partial
from uoarm import RobotManager
from uoarm.errors import BridgeError, ConnectionClosedError

def child(how, robot, connection, host):
    if how == "raise":
        raise RuntimeError("in the child")
    if how == "exit":
        sys.exit(3)
    if how == "close":
        connection.kill()
        robot.close()
        atexit._run_exitfuncs()
        os._exit(3)
    if how == "ask":
        for ask in (
            partial(robot.request, "forever"),
            connection.get,
            partial(next, iter(connection)),
            partial(connection.subscribe, print),
            partial(connection.send, 1),
            partial(connection.flush, 1.0),
            robot.stop_all,
        ):
            try:
                ask()
            except ConnectionClosedError as error:
                print("refused:", error)
        bridge = robot._bridges.get("far")
        try:
            bridge.describe(robot.config.functions["forever"].components[0].outputs[0].endpoint)
        except BridgeError as error:
            print(error)
        bridge.close()
        sys.stdout.flush()
        os._exit(3)
    if how == "terminate":
        signal.pause()

def main(keeps, limit, ways):
    with ExitStack() as held:
        robot = held.enter_context(RobotManager.from_file("robot.yaml"))
        connection = held.enter_context(robot.request("forever"))
        number = connection.get(timeout=limit)
        host = robot.status().bridges[0].process
        if keeps:
            held.pop_all()  # the interpreter ends with all of it open
        for how in ways:
            pid = os.fork()
            if pid == 0:
                return child(how, robot, connection, host)
            if how == "terminate":
                os.kill(pid, signal.SIGTERM)
            _, status = os.waitpid(pid, 0)
            for _ in range(100):
                later = connection.get(timeout=limit)
                assert later > number, (how, number, later)
                number = later
            os.kill(host, 0)
            assert not connection.gaps, how
            assert robot.status().bridges[0].process == host, how
            state = connection.state.value
            print("child", how, os.waitstatus_to_exitcode(status), state, flush=True)

main(sys.argv[1] == "open", float(sys.argv[2]), sys.argv[3:])
"""
ROBOT = """
version: 1
bridges:
  far: {plugin: python, options: {path: ["."]}, host: {silence: PATIENCE, start: PATIENCE}}
functions:
  forever:
    components: [{name: forever, bridge: far, output: {endpoint: [hosted_parts:forever]}}]
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "hosted_parts.py").write_text(COMPONENTS)
    (tmp_path / "robot.yaml").write_text(ROBOT.replace("PATIENCE", str(patience())))
    (tmp_path / "program.py").write_text(PROGRAM)
    return tmp_path


STATUSES = {"return": 0, "raise": 1, "exit": 3, "close": 3, "ask": 3, "terminate": -15}
"""Of children, by how they end."""


@pytest.mark.parametrize("kept", ["with", "open"])
def test_a_child_ends_nothing_of_its_parent(folder: Path, kept: str) -> None:
    done = run_python("program.py", kept, str(patience()), *STATUSES, cwd=folder)
    children = [line for line in done.stdout.splitlines() if line.startswith("child ")]
    wanted = [f"child {how} {status} running" for how, status in STATUSES.items()]
    assert children == wanted, done.stdout + done.stderr
    assert done.returncode == 0, done.stderr
    refused = [line for line in done.stdout.splitlines() if line.startswith("refused: ")]
    assert sum("make another one here" in line for line in refused) == 7
    assert "belongs to the parent of this process" in done.stdout


SERVED = """
import os, signal, sys, threading
from uoarm import RobotManager
from uoarm.config import loads
from uoarm.server import ServerOptions, run

def work():
    pid = os.fork()
    if pid == 0:
        threading.Event().wait(float(sys.argv[1]))
        os._exit(9)
    os.kill(pid, signal.SIGTERM)
    _, status = os.waitpid(pid, 0)
    print("child", os.waitstatus_to_exitcode(status), flush=True)
    os.kill(os.getpid(), signal.SIGTERM)

with RobotManager(loads("{version: 1, bridges: {}, functions: {}}")) as robot:
    run(robot, ServerOptions(port=0), ready=lambda _: threading.Thread(target=work).start())
    print("served")
"""


def test_a_child_of_what_serves_ends_at_sigterm_alone(tmp_path: Path) -> None:
    done = run_python("-c", SERVED, str(patience()), cwd=tmp_path)
    assert done.stdout.splitlines() == ["child -15", "served"], done.stdout + done.stderr


SOURCES = Path(uoarm.__file__).parents[2]
AT_EXIT = re.compile(
    r"^import atexit|\bweakref\.finalize\b(?!.*\.atexit = False$)"
    r"|def __del__|\bTemporaryDirectory\(",
    re.MULTILINE,
)
NO_PYTHON_RUNS_BESIDE = {"environments/_make.py", "uoarm_ros2/_interface_wheels.py"}
"""Commands that make a temporary folder while only programs of others run."""


def test_what_runs_at_exit_runs_in_the_process_that_made_it() -> None:
    """Through `at_exit` alone: what Python runs by itself runs in each forked child, too."""
    found = {
        "/".join(path.parts[-2:])
        for path in (*SOURCES.glob("src/**/*.py"), *SOURCES.glob("plugins/*/src/**/*.py"))
        if "_stubs" not in path.parts and AT_EXIT.search(path.read_text(encoding="utf-8"))
    }
    assert found == {"uoarm/_forks.py", *NO_PYTHON_RUNS_BESIDE}
