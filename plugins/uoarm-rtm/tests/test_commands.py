"""`uoarm rtm`: what there is and how it is connected, states and parameters changed by hand."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from endpoints import Make, Start, endpoint, source
from test_leftovers import holding
from tests.processes import run_python  # type: ignore[import-not-found]
from uoarm_rtm import nameserver
from uoarm_rtm.nameserver import NameServer

from uoarm.cli import main
from uoarm.errors import BridgeError
from uoarm.model import Role
from uoarm.testing import patience, wait

PUSH = {"dataport.interface_type": "corba_cdr", "dataport.dataflow_type": "push"}


@pytest.fixture
def names(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A naming service of this test alone, which the commands find by the environment."""
    with NameServer() as server:
        address = server.address.split(":", 2)[2].removesuffix("/NameService")
        monkeypatch.setenv("UOARM_RTM_NAMESERVER", address)
        yield server.address


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., Any]:
    """Runs a command; returns its status, its output (of --json as values), its errors."""

    def run_it(*words: str) -> tuple[int, Any, str]:
        with pytest.raises(SystemExit) as ended:
            main(["rtm", *words])
        status = int(ended.value.code or 0)
        output = capsys.readouterr()
        return status, json.loads(output.out) if "--json" in words else output.out, output.err

    return run_it


def test_components_are_listed(names: str, peer: Start, run: Callable[..., Any]) -> None:
    worker, dead = peer("Worker", at=names), peer("Dead", at=names)
    worker.activate()
    dead.kill()
    status, rows, _ = run("list", "--json")
    assert status == 0
    assert [(row["component"], row["state"]) for row in rows] == [
        ("Dead.rtc", "dead"), ("Worker.rtc", "active"),
    ]  # fmt: skip
    assert rows[1]["ports"][0] == {
        "port": "in", "kind": "DataInPort", "type": "IDL:RTC/TimedLong:1.0",
    }  # fmt: skip
    lines = run("list")[1].splitlines()
    assert lines[:2] == ["Dead.rtc  dead", "Worker.rtc  active  Uoarm"]
    assert lines[2].split() == ["in", "DataInPort", "IDL:RTC/TimedLong:1.0"]


def test_commands_have_the_options_of_all(run: Callable[..., Any]) -> None:
    status, _, said = run("--log-level", "loud")
    assert status == 2
    assert "expected debug, info, warning or error" in " ".join(said.split())


def test_one_component_is_shown_whole(names: str, peer: Start, run: Callable[..., Any]) -> None:
    worker = peer("Worker", at=names)
    peer("Other", at=names)
    worker.connect(names, "Other.rtc", "in", PUSH)
    _, row, _ = run("cat", "Worker.rtc", "--json")
    [out] = [port for port in row["ports"] if port["port"] == "out"]
    assert out["properties"]["dataport.dataflow_type"] == "push, pull"
    assert [connection["name"] for connection in out["connections"]] == ["tool"]
    assert row["configuration"]["active"] == "default"
    text = run("cat", "Worker.rtc")[1]
    assert "  gain                 1  [0<=x<=150; slider.10]" in text.splitlines()
    status, _, report = run("cat", "Wroker.rtc")
    assert status == 4
    assert "did you mean 'Worker.rtc'?" in report


def test_states_are_changed(names: str, peer: Start, run: Callable[..., Any]) -> None:
    worker, other = peer("Worker", at=names), peer("Other", at=names)
    both = ("Worker.rtc", "Other.rtc")
    assert run("activate", *both)[1] == "Worker.rtc  active\nOther.rtc  active\n"
    assert run("activate", "Worker.rtc")[0] == 0  # it is active
    worker.abort()
    status, _, report = run("deactivate", "Worker.rtc")
    assert (status, "PRECONDITION_NOT_MET, being error" in report) == (4, True)
    assert run("reset", "Worker.rtc", "--json")[1] == [
        {"component": "Worker.rtc", "state": "inactive"}
    ]
    assert run("deactivate", *both)[0] == 0
    assert other.calls() == ["activated", "deactivated"]


def test_parameters_are_written_and_checked(
    names: str, peer: Start, run: Callable[..., Any]
) -> None:
    worker = peer("Worker", at=names)
    status, found, _ = run("configure", "Worker.rtc", "gain=7", "--json")
    assert (status, found["sets"]["default"]["gain"]) == (0, "7")
    assert worker.configuration()["gain"] == "7"
    for words, expected, text in (
        (("gain=700",), 1, "error: $.values.gain: expected 0<=x<=150, got 700"),
        (("gian=7",), 1, "there is no parameter 'gian'"),
        (("gain",), 2, "expected NAME=VALUE, got 'gain'"),
        (("gain=7", "--set", "x"), 1, "there is no configuration set 'x'"),
    ):
        status, _, error = run("configure", "Worker.rtc", *words)
        assert (status, text in error) == (expected, True), error
    assert worker.configuration()["gain"] == "7"
    run("configure", "Worker.rtc", "--set", "fast", "gain=8", "--activate")
    assert worker.configuration() == {"gain": "8"}
    status, _, error = run("configure", "Worker.rtc", "--sett", "fast", "gain=8")
    assert (status, error.splitlines()[-1]) == (2, "uoarm explain UOA-002 says more")


def test_connections_of_killed_processes_are_ended_and_no_others(
    names: str, make_bridge: Make, peer: Start, run: Callable[..., Any]
) -> None:
    first, second = peer("From", at=names), peer("Into", at=names)
    first.connect(names, "Into.rtc", "in", PUSH)
    source(make_bridge(nameserver=names), endpoint(Role.OUTPUT, "From.rtc", "out"), lambda _: None)
    with holding(names) as killed:
        _, rows, _ = run("connections", "--json")
        assert sorted(row["runs"] for row in rows) == ["elsewhere", *["yes"] * 4]
        killed.kill()
        killed.wait()
    _, rows, _ = run("connections", "--mine", "--json")
    assert sorted(row["runs"] for row in rows) == ["no", "no", "no", "yes"]
    [native] = [row for row in rows if len(row["ports"]) == 2]
    assert sorted(native["ports"]) == ["From.rtc:out", "Into.rtc:in"]
    assert "runs no more" in run("connections", "--mine")[1]
    status, _, report = run("connections", "--remove")
    assert (status, "say --mine, too" in report) == (2, True)
    _, removed, _ = run("connections", "--mine", "--remove", "--json")
    assert len(removed) == 3
    assert (first.connectors(), second.connectors()) == ([0, 2], [1, 0])
    assert run("connections", "--mine", "--remove", "--json")[1] == []


def test_a_naming_service_that_is_not_there_is_said(run: Callable[..., Any]) -> None:
    status, _, report = run("list", "--nameserver", "127.0.0.1:1")
    assert (status, report.startswith("error: naming service 127.0.0.1:1")) == (4, True)
    for wrong in ("no such thing", "127.0.0.1:99999", "[::1]:65536"):
        status, _, report = run("list", "--nameserver", wrong)
        assert (status, "--nameserver: expected corbaloc" in report) == (2, True)
    for unknown in ("nohost.invalid:1", "corbaloc::nohost.invalid:1/NameService"):
        status, _, report = run("list", "--nameserver", unknown)
        said = f"error: naming service {unknown}: there is no host of this name\n"
        assert (status, report.startswith(said)) == (4, True), report


def test_a_naming_service_that_cannot_listen_is_said(run: Callable[..., Any]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        for words, code, why in (
            (("--port", port), 5, f"cannot listen on 127.0.0.1:{port}: Address already in use"),
            (("--address", "nohost.invalid"), 5, "cannot listen on nohost.invalid:2809: "),
            (("--port", "0", "--address", "nohost.invalid"), 5, "cannot listen on nohost.invalid"),
            (("--port", "99999"), 2, "expected 0 to 65535, got 99999"),
        ):
            status, _, report = run("nameserver", *words)
            assert (status, why in report) == (code, True), report


def test_a_call_that_waits_is_interrupted(tmp_path: Path) -> None:
    """A signal is handled by Python, which a call of CORBA does not return to."""
    with socket.create_server(("127.0.0.1", 0)) as silent:
        place = f"127.0.0.1:{silent.getsockname()[1]}"
        words = ("rtm", "list", "--timeout", "60", "--nameserver", place)
        with subprocess.Popen(
            [sys.executable, "-m", "uoarm", *words],
            cwd=tmp_path,
            stderr=subprocess.PIPE,
            text=True,
        ) as asking:
            silent.settimeout(patience())
            peer, _ = silent.accept()
            with peer:
                peer.recv(1)
                asking.send_signal(signal.SIGINT)
                _, report = asking.communicate(timeout=patience())
    assert (asking.returncode, report.splitlines()[0]) == (130, "interrupted")


def test_the_commands_are_those_of_uoarm(names: str, peer: Start, tmp_path: Path) -> None:
    peer("Worker", at=names)
    done = run_python("-m", "uoarm", "rtm", "list", "--json", cwd=tmp_path, check=True)
    assert [row["component"] for row in json.loads(done.stdout)] == ["Worker.rtc"]


def test_a_naming_service_that_dies_is_said(tmp_path: Path) -> None:
    program = """
from uoarm.cli import main
from uoarm_rtm import nameserver
started = nameserver._serves_soon
def killed(process, *where):
    found = started(process, *where)
    process.kill()
    return found
nameserver._serves_soon = killed
main(["rtm", "nameserver", "--port", "0"])
"""
    done = run_python("-c", program, env={"TMPDIR": str(tmp_path)})
    assert (done.returncode, "omniNames ended with -9" in done.stderr) == (4, True)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_naming_service_that_is_ended_as_it_starts_leaves_nothing(
    number: signal.Signals, tmp_path: Path
) -> None:
    program = f"""
import signal, sys
from uoarm_rtm import nameserver
from uoarm_rtm.__main__ import main
started = nameserver._serves_soon
def interrupted(process, *where):
    print(process.pid)
    signal.raise_signal({int(number)})
    return started(process, *where)
nameserver._serves_soon = interrupted
sys.exit(main(["nameserver", "--port", "0"]))
"""
    done = run_python("-c", program, env={"TMPDIR": str(tmp_path)})
    assert (done.returncode, done.stderr) == (0, "")
    process = int(done.stdout.split()[0])
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the kernel ends no process")
def test_a_naming_service_ends_with_what_started_it_even_where_that_is_killed(
    tmp_path: Path,
) -> None:
    program = """
import os, signal, threading
from uoarm_rtm import nameserver
from uoarm_rtm.nameserver import NameServer
made = []
making = threading.Thread(target=lambda: made.append(NameServer()))
making.start()
making.join()
assert made[0].process.poll() is None
print(made[0].port, flush=True)
os.kill(os.getpid(), signal.SIGKILL)
"""
    done = run_python("-c", program, env={"TMPDIR": str(tmp_path)})
    assert done.returncode == -signal.SIGKILL, done.stderr
    port = int(done.stdout)
    wait(lambda: not nameserver._is_served("127.0.0.1", port))


def test_a_naming_service_that_is_not_installed_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nameserver, "omniorb_programs", lambda: Path("/not/there"))
    with pytest.raises(BridgeError, match=r"omniNames cannot be started: .*/not/there"):
        NameServer()
