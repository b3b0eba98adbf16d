"""A server under a service manager: what it says, and that the files of `deploy` hold."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml
from tests.processes import run_program
from tests.server.robot import CONFIGURATION, script
from tests.server.test_serving import figures

from uoarm import RobotManager
from uoarm.errors import ConnectionClosedError, UsageError
from uoarm.server import Server
from uoarm.server._running import ServiceManager
from uoarm.testing import patience, wait

ROOT = Path(__file__).parents[2]
DEPLOY = ROOT / "deploy"


class Manager:
    """A service manager that listens, as systemd does."""

    def __init__(self, address: str) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(address)
        self._socket.settimeout(patience())

    def next(self) -> list[str]:
        return self._socket.recv(4096).decode().split("\n")

    def close(self) -> None:
        self._socket.close()


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[Manager]:
    manager = Manager(str(tmp_path / "notify"))
    yield manager
    manager.close()


def test_a_served_robot_is_ready_alive_and_stopping(tmp_path: Path, manager: Manager) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(CONFIGURATION, encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, "-m", "uoarm", "serve", str(file), "--port", "0"],
        stdout=subprocess.PIPE,
        text=True,
        env={
            **os.environ,
            "PYTHONPATH": str(ROOT),
            "XDG_STATE_HOME": str(tmp_path / "state"),
            "NOTIFY_SOCKET": str(tmp_path / "notify"),
            "WATCHDOG_USEC": "20000",
        },
    )
    try:
        said = [manager.next() for _ in range(4)]
        [ready] = [lines for lines in said if "READY=1" in lines]
        assert process.stdout is not None
        found = re.search(r"ws://127\.0\.0\.1:(\d+)/", process.stdout.readline())
        assert found is not None
        assert ready == ["READY=1", f"STATUS=listening on port {found[1]}"]
        assert said.count(["WATCHDOG=1"]) == 3
        process.send_signal(signal.SIGTERM)
        while "STOPPING=1" not in (lines := manager.next()):
            assert lines == ["WATCHDOG=1"]
        assert process.wait(patience()) == 0
    finally:
        process.kill()
        process.communicate()


def test_what_is_written_to_the_audit_file_is_no_warning(tmp_path: Path) -> None:
    file, audit = tmp_path / "robot.yaml", tmp_path / "audit.jsonl"
    file.write_text(CONFIGURATION, encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, "-m", "uoarm", "serve", file, "--port", "0", "--audit", audit],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT), "XDG_STATE_HOME": str(tmp_path / "state")},
    )
    try:
        assert process.stdout is not None
        assert "serving" in process.stdout.readline()
        process.send_signal(signal.SIGUSR1)
        wait(lambda: '"SIGUSR1"' in audit.read_text(encoding="utf-8"))
        process.send_signal(signal.SIGTERM)
        _, errors = process.communicate(timeout=patience())
    finally:
        process.kill()
        process.communicate()
    assert "INFO" not in errors


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux has abstract addresses")
def test_an_abstract_address_is_reached() -> None:
    name = f"uoarm-{os.getpid()}-{os.urandom(4).hex()}"
    manager = Manager(f"\0{name}")
    try:
        ServiceManager({"NOTIFY_SOCKET": f"@{name}"}).alive()
        assert manager.next() == ["WATCHDOG=1"]
    finally:
        manager.close()


def test_no_process_that_is_started_here_speaks_in_its_name() -> None:
    environment = {"NOTIFY_SOCKET": "/x", "WATCHDOG_USEC": "1", "WATCHDOG_PID": "1", "HOME": "/"}
    ServiceManager(environment)
    assert environment == {"HOME": "/"}


def test_the_watchdog_is_that_of_this_process() -> None:
    own = os.getpid()
    for process, seconds in (("", 0.5), (str(own), 0.5), (str(own + 1), None)):
        environment = {"WATCHDOG_USEC": "500000", "WATCHDOG_PID": process}
        assert ServiceManager(environment).watchdog_seconds == seconds


@pytest.mark.parametrize(
    ("name", "text"),
    [("NOTIFY_SOCKET", "relative"), ("WATCHDOG_USEC", "0"), ("WATCHDOG_USEC", "x")],
)
def test_what_is_no_address_or_time_is_refused_by_name(name: str, text: str) -> None:
    with pytest.raises(UsageError, match=rf"{name}: expected .*'{text}'"):
        ServiceManager({name: text})


def test_a_service_manager_that_is_gone_stops_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    ServiceManager({"NOTIFY_SOCKET": str(tmp_path / "gone")}).ready("x")
    assert "could not be reached" in caplog.text


@pytest.mark.needs("systemd")
def test_the_unit_is_one_that_systemd_takes_and_little_is_exposed(tmp_path: Path) -> None:
    unit = tmp_path / "uoarm.service"
    text = (DEPLOY / unit.name).read_text(encoding="utf-8")
    # The program is looked for; the page says where it is installed.
    unit.write_text(text.replace("/opt/uoarm/bin/uoarm", sys.executable), encoding="utf-8")
    for words in (["verify"], ["security", "--offline=true", "--threshold=25", "--no-pager"]):
        ran = run_program("systemd-analyze", *words, unit)
        assert ran.returncode == 0, ran.stdout + ran.stderr


def test_the_unit_names_nothing_that_the_installation_lacks() -> None:
    """The page installs a virtual environment at /opt/uoarm, in which the pages are not."""
    text = (DEPLOY / "uoarm.service").read_text(encoding="utf-8")
    assert set(re.findall(r"/opt/[\w/.-]*", text)) == {"/opt/uoarm/bin/uoarm"}


def test_every_alert_is_about_a_figure_that_there_is(server: Server) -> None:
    rules = yaml.safe_load((DEPLOY / "prometheus-alerts.yaml").read_text(encoding="utf-8"))
    [group] = rules["groups"]
    known = set(re.findall(r"^# TYPE (\w+)", figures(server), re.MULTILINE)) | {"up"}
    for rule in group["rules"]:
        named = re.findall(r"\b(?:uoarm_\w+|up)\b", re.sub(r'"[^"]*"', "", rule["expr"]))
        assert named, rule
        assert {*named} <= known, rule


def test_what_the_alert_of_a_lost_component_asks_for_rises(
    server: Server, robot: RobotManager
) -> None:
    rules = yaml.safe_load((DEPLOY / "prometheus-alerts.yaml").read_text(encoding="utf-8"))
    [rule] = [rule for rule in rules["groups"][0]["rules"] if rule["alert"] == "RobotComponentLost"]
    [name] = {*re.findall(r"\buoarm_\w+", rule["expr"])}
    with robot.request("numbers") as numbers:
        assert f'{name}{{component="numbers"}} 0.0' in figures(server)
        script.put(OSError("unplugged"))
        with pytest.raises(ConnectionClosedError, match="unplugged"):
            numbers.get(patience())
    wait(lambda: f'{name}{{component="numbers"}} 1.0' in figures(server))


def test_an_alert_on_what_a_thing_counts_is_raised_by_a_count_that_was_never_seen_at_0() -> None:
    """What was opened and lost between two looks: `increase` sees nothing of a first value."""
    rules = yaml.safe_load((DEPLOY / "prometheus-alerts.yaml").read_text(encoding="utf-8"))
    increases = [rule for rule in rules["groups"][0]["rules"] if "increase(" in rule["expr"]]
    for rule in increases:
        found = re.match(r"increase\((\w+)\[(\w+)\]\) (> \d+)", rule["expr"])
        assert found, rule
        name, span, beyond = found.groups()
        if not name.startswith("uoarm_serve_"):  # those begin with the server
            first = f"or ({name} {beyond} unless {name} offset {span})"
            assert rule["expr"] == f"{found[0]} {first}"
