"""Bridges on another machine: they join by themselves, leave, come back, and are never killed."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.host.joined import Joined, robot

from uoarm import BridgeError, ResolutionError, RobotManager, UoarmError
from uoarm._host.machines import MachineRegistry
from uoarm.cli import main
from uoarm.config import loads
from uoarm.model import ConnectionState, Health, MachineStatus, StatusEvent
from uoarm.testing import ResourceSnapshot, free_port, hold_idle, patience, slowness, wait


@pytest.fixture
def port() -> int:
    return free_port()


def _place(port: int) -> str:
    return f"tls/127.0.0.1:{port}"


def _machine(manager: RobotManager) -> MachineStatus:
    (found,) = manager.status().machines
    return found


def test_a_bridge_on_another_machine_works_as_one_here(tmp_path: Path, port: int) -> None:
    file = robot(tmp_path, port)
    with Joined(tmp_path, _place(port)), RobotManager.from_file(file) as manager:
        got = list(manager.request("doubled"))
        assert got[-1] == 1998
        assert got == sorted(got)
        assert manager.call("where", 0, timeout=patience()) > 0


def test_who_waits_for_the_other_takes_hardly_any_processor_time(tmp_path: Path, port: int) -> None:
    file = robot(tmp_path, port, failover=f"{{wait: {patience()}}}")
    with Joined(tmp_path, _place(port)) as host:
        wait(lambda: "waiting for the manager" in host.log)
        hold_idle("while the manager is not there", host.process)
        with RobotManager.from_file(file) as manager:
            manager.call("where", 0, timeout=patience())
            hold_idle("while a machine is joined", host.process)
            host.signal(signal.SIGKILL)
            wait(lambda: not _machine(manager).present)
            hold_idle("while a machine is gone")


def test_the_clock_of_a_machine_is_known(tmp_path: Path, port: int) -> None:
    file = robot(tmp_path, port)
    with Joined(tmp_path, _place(port)), RobotManager.from_file(file) as manager:
        assert _machine(manager).clock_offset is None
        manager.call("where", 0, timeout=patience())
        status = _machine(manager)
        assert status.present
        assert status.clock_offset is not None
        assert status.clock_error is not None
        assert abs(status.clock_offset) <= status.clock_error + 1e-6  # it is our own clock


def test_what_a_row_says_it_waits_for_is_said_once(tmp_path: Path, port: int) -> None:
    file = robot(tmp_path, port)
    far = re.search(r"^  far: .*\n", file.read_text(), re.MULTILINE)
    assert far is not None
    file.write_text(file.read_text().replace(far[0], far[0] + far[0].replace("far", "arm")))
    with RobotManager.from_file(file) as manager:
        assert _machine(manager).cause == "waiting for its bridges far, arm"
        reports = {bridge.name: bridge.cause for bridge in manager.status().bridges}
        assert reports["far"] == reports["arm"] == "waiting for machine 'arm'"


def test_a_machine_that_comes_late_is_waited_for(tmp_path: Path, port: int) -> None:
    file = robot(tmp_path, port)
    events: list[StatusEvent] = []
    with RobotManager.from_file(file) as manager:
        manager.listen(events.append)
        (status,) = (bridge for bridge in manager.status().bridges if bridge.name == "far")
        assert status.health is Health.DEGRADED
        assert status.cause == "waiting for machine 'arm'"
        assert _machine(manager).cause == "waiting for its bridge far"
        answers: list[int] = []
        asking = threading.Thread(
            target=lambda: answers.append(manager.call("where", 0, timeout=patience()))
        )
        asking.start()
        with Joined(tmp_path, _place(port)):
            asking.join(patience())
            assert answers
            assert _machine(manager).present
            wait(lambda: any(event.cause == "machine 'arm' has joined" for event in events))


def test_a_link_that_fails_while_closing_is_reported_and_the_manager_closes_all_the_same(
    tmp_path: Path, port: int, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    file = robot(tmp_path, port)
    RobotManager.from_file(file).close()  # what stays for the next one is there
    close = MachineRegistry.close

    def fail(desk: MachineRegistry) -> None:
        close(desk)
        raise BridgeError("closing the link failed: it took too long")

    monkeypatch.setattr(MachineRegistry, "close", fail)
    before = ResourceSnapshot()
    RobotManager.from_file(file).close()
    assert "it took too long" in caplog.text
    before.check()


def test_an_address_that_is_taken_is_reported_and_tried_again(tmp_path: Path, port: int) -> None:
    file = robot(tmp_path, port)
    with socket.create_server(("127.0.0.1", port)):
        manager = RobotManager.from_file(file)
        assert "cannot join: opening the link" in _machine(manager).cause
        with pytest.raises(ResolutionError, match="opening the link"):
            manager.resolve("where")
    with Joined(tmp_path, _place(port)), manager:
        assert manager.call("where", 0, timeout=patience()) > 0
        assert _machine(manager).cause == ""


def test_who_has_not_come_in_time_is_not_waited_for_again(tmp_path: Path, port: int) -> None:
    file = robot(tmp_path, port, start=0.1)
    with RobotManager.from_file(file) as manager:
        for _ in range(2):
            with pytest.raises(
                Exception, match="no host of machine 'arm' is there for bridge 'far'"
            ):
                manager.call("where", 0, timeout=patience())


LATE = """
  late:
    components: [{name: later, bridge: far, output: {endpoint: ["hosted_parts:takes_long"]}}]
"""


def test_a_host_that_is_asked_to_end_waits_for_no_component(tmp_path: Path, port: int) -> None:
    file = robot(tmp_path, port)
    file.write_text(file.read_text() + LATE)
    with Joined(tmp_path, _place(port)) as host, RobotManager.from_file(file) as manager:

        def request() -> None:
            with pytest.raises(BridgeError, match="machine 'arm' has left"):
                manager.request("late")

        requesting = threading.Thread(target=request)
        requesting.start()
        wait((tmp_path / "begun").exists)
        assert host.end() == 0
        requesting.join(patience())
        assert not requesting.is_alive()
        assert "Timeout" not in host.log


def test_when_a_machine_leaves_the_next_candidate_takes_over(tmp_path: Path, port: int) -> None:
    file = robot(tmp_path, port, spare=True, failover="{return_after: 0.2}")
    with RobotManager.from_file(file) as manager:
        with Joined(tmp_path, _place(port)) as host:
            connection = manager.request("ticks")
            assert connection.get(patience()) == 0
            host.signal(signal.SIGKILL)
            wait(lambda: connection.gaps)
        assert connection.gaps[0].after == ("spare",)
        assert "machine 'arm' has left" in connection.gaps[0].cause
        with Joined(tmp_path, _place(port)):
            wait(lambda: len(connection.gaps) == 2)
            assert connection.gaps[1].after == ("ticker",)
            assert connection.get(patience()) is not None
        assert connection.state is ConnectionState.RUNNING


def test_a_machine_that_comes_back_goes_on_behind_the_handle(tmp_path: Path, port: int) -> None:
    file = robot(tmp_path, port, failover="{wait: 60}")
    with RobotManager.from_file(file) as manager:
        with Joined(tmp_path, _place(port)) as host:
            connection = manager.request("ticks")
            connection.get(patience())
            assert host.end() == 0
        wait(lambda: not _machine(manager).present)
        with Joined(tmp_path, _place(port)):
            wait(lambda: connection.gaps)
            assert connection.gaps[0].after == ("ticker",)
            assert connection.get(patience()) is not None


def test_structures_are_asked_for_anew_when_a_machine_comes_back(tmp_path: Path, port: int) -> None:
    file = robot(tmp_path, port)
    with RobotManager.from_file(file) as manager:
        with Joined(tmp_path, _place(port)):
            manager.request("doubled").kill()
        wait(lambda: not _machine(manager).present)
        parts = tmp_path / "hosted_parts.py"
        changed = parts.read_text().replace("double(value: int)", "double(value: str)")
        parts.write_text(changed + "\n")  # of another length, or the compiled module stands
        with Joined(tmp_path, _place(port)):
            wait(lambda: _machine(manager).present)
            with pytest.raises(ResolutionError, match="string"):
                manager.request("doubled")


def test_a_bridge_that_cannot_be_made_there_says_so_here(tmp_path: Path, port: int) -> None:
    file = robot(tmp_path, port)
    file.write_text(file.read_text().replace("far: {plugin: python", "far: {plugin: nothing"))
    with Joined(tmp_path, _place(port)):
        robot_there = loads(file.read_text(), origin=str(file))
        with RobotManager(robot_there) as manager:
            for _ in range(2):  # and the host goes on
                with pytest.raises(ResolutionError, match="nothing"):
                    manager.resolve("where")


def test_the_command_line_shows_machines(tmp_path: Path, port: int) -> None:
    file = robot(tmp_path, port, spare=True)
    with Joined(tmp_path, _place(port)):
        shown = CliRunner().invoke(main, ["status", "-f", str(file)]).output
    assert re.search(r"machine arm  present, its clock is [+-]\d+\.\d{3} ms from ours", shown)


def test_a_host_that_hangs_is_given_up_but_never_killed(tmp_path: Path, port: int) -> None:
    file = robot(tmp_path, port, silence=2 * slowness())
    # Its own silence is also when the link takes it for gone, and that is to come later.
    lease = ("--silence", str(patience()))
    with Joined(tmp_path, _place(port), *lease) as host, RobotManager.from_file(file) as manager:
        events: list[StatusEvent] = []
        answers: list[int] = []

        def answered() -> bool:
            """Ask until it answers: one that is starved is given up, too."""
            try:
                answers.append(manager.call("where", 0, timeout=patience()))
            except UoarmError:
                return False
            return True

        manager.listen(events.append)
        wait(answered)
        host.signal(signal.SIGSTOP)
        wait(lambda: any("machine 'arm' has not answered for" in event.cause for event in events))
        with pytest.raises(UoarmError, match=r"host of machine 'arm' (does not|is there)"):
            manager.call("where", 0, timeout=patience())
        assert host.runs
        host.signal(signal.SIGCONT)
        wait(answered)
        assert answers[0] == answers[1]  # of the same process
        bridge = manager._bridges.get("far")
        with pytest.raises(BridgeError, match="not started or killed from here"):
            bridge.process  # type: ignore[attr-defined] # noqa: B018 - a RemoteBridge has it


def test_a_host_outlives_its_managers_and_keeps_nothing_of_them(tmp_path: Path, port: int) -> None:
    file = robot(tmp_path, port)
    with Joined(tmp_path, _place(port)) as host:
        found: set[int] = set()
        held: list[tuple[int, int]] = []
        for number in range(3):
            with RobotManager.from_file(file) as manager:
                connection = manager.request("ticks")
                assert (
                    connection.get(patience()) == 0
                )  # the component begins anew with each manager
                found.add(manager.call("where", 0, timeout=patience()))
            expected = number + 1
            wait(lambda: host.log.count("bridge far is let go") == expected)  # noqa: B023 - at once
            wait(lambda: not held or host.holdings() <= held[0])
            held.append(host.holdings())
        assert len(found) == 1
        assert host.end() == 0


def test_a_host_closes_its_bridges_when_the_manager_is_killed(tmp_path: Path, port: int) -> None:
    file = robot(tmp_path, port)
    with Joined(tmp_path, _place(port)) as host:
        command = [sys.executable, "-m", "uoarm", "request", "ticks", "-f", str(file)]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL) as manager:
            wait(lambda: "bridge far is taken up" in host.log)
            manager.kill()
        wait(lambda: "bridge far is let go" in host.log)
        assert host.runs


def test_two_hosts_share_the_bridges_of_a_machine(tmp_path: Path, port: int) -> None:
    file = robot(tmp_path, port)
    text = file.read_text().replace(
        "  near: {plugin: python}",
        f"  near: {{plugin: python, host: {{machine: arm, start: {patience()}}}}}",
    )
    there = """  there:
    components:
      - {name: there, bridge: near, service: {endpoint: ["hosted_parts:process_id"]}}
"""
    file.write_text(text + there)
    with (
        Joined(tmp_path, _place(port), "far"),
        Joined(tmp_path, _place(port), "near"),
        RobotManager.from_file(file) as manager,
    ):
        assert manager.call("where", 0, timeout=patience()) != manager.call(
            "there", 0, timeout=patience()
        )


def test_a_manager_leaves_nothing_behind(tmp_path: Path, port: int) -> None:
    file = robot(tmp_path, port)
    with Joined(tmp_path, _place(port)):
        with RobotManager.from_file(file) as manager:
            manager.call("where", 0, timeout=patience())
        before = ResourceSnapshot()
        with RobotManager.from_file(file) as manager:
            manager.request("ticks").get(patience())
        before.check()
