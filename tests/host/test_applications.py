"""What an application sets for its whole process does not break a host, nor what runs in it."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.host.hosted import COMPONENTS
from tests.processes import run_python

from uoarm.testing import patience

ROBOT = """
version: 1
bridges:
  far: {plugin: python, options: {path: ["."]}, host: {silence: PATIENCE, start: PATIENCE}}
functions:
  number: {components: [{name: number, bridge: far, service: {endpoint: ["parts:number"]}}]}
  masked: {components: [{name: masked, bridge: far, service: {endpoint: ["parts:masked"]}}]}
  status: {components: [{name: status, bridge: far, service: {endpoint: ["parts:status"]}}]}
"""
PARTS = """
import os, signal, subprocess, sys

def number(value: int) -> int:
    return os.getpid()

def masked(value: int) -> int:
    return len(signal.pthread_sigmask(signal.SIG_BLOCK, ()))

def status(value: int) -> int:
    return subprocess.run([sys.executable, "-c", f"raise SystemExit({value})"]).returncode
"""
PROGRAM = """
import os, signal, socket, sys
from uoarm import RobotManager
from uoarm.testing import Collector, wait

how, limit = sys.argv[1], float(sys.argv[2])
if how == "limits and blocks":
    socket.setdefaulttimeout(0.001)
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM, signal.SIGINT})
elif how == "ignores":
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
with RobotManager.from_file("robot.yaml") as robot:
    events = Collector()
    robot.listen(events.deliver)
    host = robot.call("number", 0, timeout=limit)
    print(robot.call("masked", 0, timeout=limit), robot.call("status", 7, timeout=limit))
    os.kill(host, signal.SIGKILL)
    events.wait_for(lambda event: event.change == "lost")
    print(next(event.cause for event in events.messages if event.change == "lost"))
    wait(lambda: robot.call("number", 0, timeout=limit) != host)
"""


@pytest.mark.parametrize("how", ["limits and blocks", "ignores"])
def test_a_host_works_dies_and_is_started_again(tmp_path: Path, how: str) -> None:
    (tmp_path / "parts.py").write_text(PARTS)
    (tmp_path / "robot.yaml").write_text(ROBOT.replace("PATIENCE", str(patience())))
    (tmp_path / "program.py").write_text(PROGRAM)
    done = run_python("program.py", how, str(patience()), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    called, cause = done.stdout.splitlines()
    assert called == "0 7"
    assert ("ignores SIGCHLD" in cause) == (how == "ignores"), cause


FIRST = """
import atexit, sys
from uoarm import RobotManager
from uoarm._host.transport import liveness

liveness._NEWS_SECONDS = float(sys.argv[1])  # for which nothing is to wait
robot = RobotManager.from_file("robot.yaml")

def close():
    robot.close()
    print("closed")

atexit.register(close)
connection = robot.request("forever", timeout=float(sys.argv[1]))
"""


def test_what_an_application_closes_at_its_exit_after_hosts_have_ended_waits_for_nothing(
    tmp_path: Path,
) -> None:
    text = "{components: [{name: forever, bridge: far, output: {endpoint: ['parts:forever']}}]}"
    (tmp_path / "parts.py").write_text(COMPONENTS)
    robot = ROBOT.partition("functions:")[0] + f"functions:\n  forever: {text}\n"
    (tmp_path / "robot.yaml").write_text(robot.replace("PATIENCE", str(patience())))
    (tmp_path / "program.py").write_text(FIRST)
    done = run_python("program.py", str(patience()), cwd=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, "closed\n", "")
