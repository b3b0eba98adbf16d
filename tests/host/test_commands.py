"""Inputs that move something, in a host: whatever becomes of the manager, the host stops them."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from tests.host.hosted import hasten
from tests.processes import lives, run_python

from uoarm import RobotManager
from uoarm._host import process_connection
from uoarm._host.remote_bridge import RemoteBridge, RemoteSink
from uoarm.errors import CommandRefusedError
from uoarm.model import (
    BridgeSpec,
    CommandPhase,
    CommandPolicy,
    CommandStatus,
    Endpoint,
    MessageStructure,
    Role,
    StopMessage,
)
from uoarm.testing import patience, wait

COMPONENTS = """
from dataclasses import dataclass
from pathlib import Path

@dataclass
class Speed:
    v: float

def base(speed: Speed) -> None:
    with (Path(__file__).parent / "taken").open("a") as taken:
        taken.write(f"{speed.v}\\n")
"""
ROBOT = """
version: 1
bridges: {far: {plugin: python, host: {silence: 60}}}
functions:
  drive:
    components:
      - name: base
        bridge: far
        input:
          endpoint: ["moving:base"]
          lifetime: 0.2
          stop: {message: {v: 0.0}}
          limits: {v: {maximum: 1, rate: 3}}
"""
SENDER = """
import sys, time
from uoarm import RobotManager
manager = RobotManager.from_file(sys.argv[1])
drive = manager.request("drive")
while True:
    drive.send({"v": 0.5})
    time.sleep(0.02)
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "moving.py").write_text(COMPONENTS)
    (tmp_path / "robot.yaml").write_text(ROBOT)
    return tmp_path


@pytest.fixture
def sender(folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen([sys.executable, "-c", SENDER, str(folder / "robot.yaml")])
    try:
        wait(lambda: len(taken(folder)) > 3)
        yield process
    finally:
        process.kill()
        process.wait()


def taken(folder: Path) -> list[str]:
    path = folder / "taken"
    return path.read_text().split() if path.exists() else []


def ceases(look: Callable[[], list[str]]) -> list[str]:
    """Return what was taken when the stop came last."""
    wait(lambda: look()[-1] == "0.0")
    return look()


@pytest.mark.parametrize("fault", [signal.SIGKILL, signal.SIGSTOP])
def test_the_host_stops_what_a_manager_left_that_died_or_hangs(
    folder: Path, sender: subprocess.Popen[bytes], fault: signal.Signals
) -> None:
    sender.send_signal(fault)
    assert "0.5" in ceases(lambda: taken(folder))


def test_the_status_has_what_the_host_says_and_an_emergency_stop_reaches_it(folder: Path) -> None:
    with RobotManager.from_file(folder / "robot.yaml") as manager:
        drive = manager.request("drive")

        def status() -> CommandStatus | None:
            (component,) = manager.status().components
            return component.channels[0].command

        def refused(reason: str) -> int:
            status_now = status()
            return 0 if status_now is None else dict(status_now.dropped).get(reason, 0)

        def send(v: float) -> bool:
            drive.send({"v": v})
            return True

        def rests() -> bool:
            return (status_now := status()) is not None and status_now.phase is CommandPhase.STOPPED

        # A command that was more than its lifetime on its way is refused: then another one is sent.
        wait(lambda: send(0.5) and taken(folder))
        wait(lambda: rests() and taken(folder)[-1] == "0.0")
        assert set(taken(folder)) == {"0.5", "0.0"}
        tries = itertools.count(1)
        wait(lambda: next(tries) and send(2.0) and refused("beyond-limits"))
        too_fast = next(tries)  # more than were sent
        wait(lambda: send(0.9) and refused("beyond-limits") > too_fast)  # from rest 0.6 at most
        before = taken(folder)
        report = manager.stop_all(timeout=patience())
        assert [input_.stopped for input_ in report.inputs] == [True]
        assert taken(folder) == [*before, "0.0"]
        assert set(before) == {"0.5", "0.0"}
        assert before[-1] == "0.0"
        with pytest.raises(CommandRefusedError):
            drive.send({"v": 0.5})
        manager.release(timeout=patience())
        wait(lambda: send(0.5) and taken(folder)[len(before) + 1 :][:1] == ["0.5"])


def test_a_stop_that_a_sender_asks_for_comes_behind_what_it_sent_before(folder: Path) -> None:
    text = (folder / "robot.yaml").read_text().replace("lifetime: 0.2", "lifetime: 3600")
    (folder / "robot.yaml").write_text(text)
    with RobotManager.from_file(folder / "robot.yaml") as manager:
        drive = manager.request("drive")
        drive.send({"v": 0.5})
        assert drive.flush(patience()), "it is on its way to the host, which may have it or not"
        drive.stop(timeout=patience())
        assert taken(folder) == ["0.5", "0.0"]
        drive.send({"v": 0.5})
        wait(lambda: len(taken(folder)) == 3)


def test_no_stop_waits_until_another_input_is_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An input whose component hangs is closed late: the host has stopped all before."""
    (tmp_path / "moving.py").write_text(COMPONENTS)
    policy = CommandPolicy(lifetime=3600, stop=StopMessage({"v": 0.0}))
    bridge = RemoteBridge(BridgeSpec("far", "python", {"path": [str(tmp_path)]}, {"silence": 60}))
    for port in ("left", "right"):
        base = Endpoint("far", "base", Role.INPUT, ("moving:base",), port, command=policy)
        bridge.open_sink(base, MessageStructure({}), timeout=patience()).send({"v": 0.5})
    wait(lambda: len(taken(tmp_path)) == 2)
    close = RemoteSink._close

    def look_and_close(sink: RemoteSink) -> None:
        wait(lambda: taken(tmp_path).count("0.0") == 2)
        close(sink)

    monkeypatch.setattr(RemoteSink, "_close", look_and_close)
    bridge.close(timeout=2 * patience())
    assert taken(tmp_path) == ["0.5", "0.5", "0.0", "0.0"]


@pytest.mark.parametrize("comes_back", [True, False])
def test_a_host_that_is_given_up_may_stop_what_moves_before_it_is_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, comes_back: bool
) -> None:
    (tmp_path / "moving.py").write_text(COMPONENTS)
    monkeypatch.setattr(process_connection, "_STOP_SECONDS", patience() if comes_back else 0.0)
    policy = CommandPolicy(lifetime=3600, stop=StopMessage({"v": 0.0}))
    settings = {"silence": patience()}
    bridge = RemoteBridge(BridgeSpec("far", "python", {"path": [str(tmp_path)]}, settings))
    base = Endpoint("far", "base", Role.INPUT, ("moving:base",), command=policy)
    bridge.open_sink(base, MessageStructure({}), timeout=patience()).send({"v": 0.5})
    wait(lambda: taken(tmp_path))
    process = bridge.process
    os.kill(process, signal.SIGSTOP)
    hasten(bridge, 0.5)
    if comes_back:
        host: Any = bridge._host
        wait(lambda: host._started._process.stdin.closed or not lives(process))
        with suppress(ProcessLookupError):
            os.kill(process, signal.SIGCONT)
    wait(lambda: bridge._host.dead)
    assert not lives(process)
    assert taken(tmp_path) == ["0.5", "0.0"][: 1 + comes_back]
    bridge.close()


ENDING = """
import sys
from pathlib import Path
from uoarm import RobotManager
from uoarm._host.process_connection import ProcessConnection
from uoarm.testing import wait

folder = Path(sys.argv[1])
taken = lambda: (folder / "taken").read_text().split() if (folder / "taken").exists() else []
manager = RobotManager.from_file(folder / "robot.yaml")
manager.request("drive").send({"v": 0.5})
wait(lambda: taken() == ["0.5"])
close = ProcessConnection.close

def look_and_close(connection, say_close):
    wait(lambda: taken()[1:] == ["0.0"])
    print("stopped")
    close(connection, say_close)

ProcessConnection.close = look_and_close
"""


def test_as_a_program_ends_no_stop_waits_until_another_host_has_ended(folder: Path) -> None:
    text = (folder / "robot.yaml").read_text().replace("lifetime: 0.2", "lifetime: 3600")
    (folder / "robot.yaml").write_text(text)
    done = run_python("-c", ENDING, folder)
    assert done.stdout == "stopped\n", done.stderr
    assert taken(folder) == ["0.5", "0.0"]
