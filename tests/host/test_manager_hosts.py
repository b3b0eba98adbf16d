"""A robot whose bridge has a host, from its configuration: as without, and deaths reported."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.host import hosted
from tests.processes import lives

from uoarm import BridgeError, ConnectionClosedError, ResolutionError, RobotManager
from uoarm._host import RemoteBridge
from uoarm.model import ConnectionState, Health, StatusEvent
from uoarm.testing import Collector, ResourceSnapshot, patience, wait

ROBOT = """
version: 1
bridges:
  far: {plugin: python, host: {silence: 60, restarts: 2, variables: VARIABLES}}
functions:
  numbers: {components: [{name: counter, bridge: far, output: {endpoint: ["hosted_parts:count"]}}]}
  ticks: {components: [{name: ticker, bridge: far, output: {endpoint: ["hosted_parts:forever"]}}]}
  doubled:
    components:
      - name: doubler
        bridge: far
        input: {from: numbers, endpoint: ["hosted_parts:double"]}
        output: {endpoint: ["hosted_parts:double"]}
  refused:
    components:
      - name: refuser
        bridge: far
        priority: 1
        input: {from: ticks, endpoint: ["hosted_parts:refuse"]}
        output: {endpoint: ["hosted_parts:refuse"]}
  accepted:
    components:
      - name: preferred
        bridge: far
        priority: 1
        input: {from: ticks, endpoint: ["hosted_parts:refuse"]}
        output: {endpoint: ["hosted_parts:refuse"]}
      - name: modest
        bridge: far
        input: {from: ticks, endpoint: ["hosted_parts:double"]}
        output: {endpoint: ["hosted_parts:double"]}
  where:
    components:
      - {name: asker, bridge: far, service: {endpoint: ["hosted_parts:process_id"]}}
  end: {components: [{name: killer, bridge: far, service: {endpoint: ["hosted_parts:die"]}}]}
""".replace("VARIABLES", str(hosted.PATIENT))


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[RobotManager]:
    (tmp_path / "hosted_parts.py").write_text(hosted.COMPONENTS)
    (tmp_path / "robot.yaml").write_text(ROBOT)
    with RobotManager.from_file(tmp_path / "robot.yaml") as manager:
        yield manager


def test_a_chain_through_a_host_delivers_every_message_and_finishes(robot: RobotManager) -> None:
    got = list(robot.request("doubled"))
    assert got[-1] == 1998
    assert got == sorted(got)


def test_a_service_in_a_host_answers(robot: RobotManager) -> None:
    assert robot.call("where", 0) != os.getpid()


def test_the_status_and_the_list_of_processes_say_which_process_it_is(
    robot: RobotManager, tmp_path: Path
) -> None:
    process = robot.call("where", 0)
    [bridge] = robot.status().bridges
    assert bridge.process == process
    command = Path(f"/proc/{process}/cmdline").read_bytes().decode().split("\0")
    assert command[command.index("--bridge") + 1] == "far"
    assert command[command.index("--robot") + 1] == str(tmp_path / "robot.yaml")


def test_killing_the_host_fails_its_connections_with_the_cause(robot: RobotManager) -> None:
    events: list[StatusEvent] = []
    robot.listen(events.append)
    connection = robot.request("ticks")
    assert connection.get(patience()) == 0
    os.kill(robot.call("where", 0), signal.SIGKILL)
    with pytest.raises(ConnectionClosedError, match="killed by SIGKILL"):
        for _ in connection:
            pass
    assert connection.state is ConnectionState.FAILED
    wait(lambda: any(event.subject == "bridge far" for event in events))
    assert any("SIGKILL" in event.cause for event in events)


YOUNG = """
version: 1
bridges:
  far: {plugin: python, host: {silence: 60, variables: VARIABLES}}
  near: {plugin: python}
functions:
  ticks:
    components:
      - {name: young, bridge: far, priority: 1, output: {endpoint: ["hosted_parts:dies_young"]}}
      - {name: ticker, bridge: near, output: {endpoint: ["hosted_parts:forever"]}}
""".replace("VARIABLES", str(hosted.PATIENT))


def test_a_host_that_dies_as_a_request_opens_is_replaced_by_the_next_candidate(
    tmp_path: Path,
) -> None:
    (tmp_path / "hosted_parts.py").write_text(hosted.COMPONENTS)
    (tmp_path / "robot.yaml").write_text(YOUNG)
    with RobotManager.from_file(tmp_path / "robot.yaml") as robot:
        connection = robot.request("ticks")
        assert connection.get(patience()) == 0
        assert connection.plan.names == ("ticker",)
        assert "killed by SIGKILL" in connection.gaps[0].cause


def test_the_next_request_starts_a_new_host(robot: RobotManager) -> None:
    first = robot.call("where", 0)
    os.kill(first, signal.SIGKILL)
    wait(lambda: not lives(first))
    found: list[int] = []
    assert robot.status().bridges

    def again() -> bool:
        try:
            found.append(robot.call("where", 0))
        except BridgeError:
            return False
        return True

    wait(again)
    assert found[0] != first


def test_a_host_that_dies_again_and_again_is_given_up(robot: RobotManager) -> None:
    for _ in range(2):
        with pytest.raises(BridgeError, match="ended with status 7"):
            robot.call("end", 7)
        wait(lambda: robot.status().bridges[0].health is Health.LOST)
        assert "ended with status 7" in robot.status().bridges[0].cause
    with pytest.raises(Exception, match=r"given up.*status 7"):
        robot.call("end", 7)


def test_two_bridges_of_one_plugin_run_side_by_side(tmp_path: Path) -> None:
    one, two = hosted.bridge(tmp_path), hosted.bridge(tmp_path)
    try:
        assert one.process != two.process
    finally:
        one.close()
        two.close()


def test_a_manager_leaves_nothing_behind(tmp_path: Path) -> None:
    hosted.bridge(tmp_path).close()
    before = ResourceSnapshot()
    (tmp_path / "robot.yaml").write_text(ROBOT)
    with RobotManager.from_file(tmp_path / "robot.yaml") as manager:
        connection = manager.request("ticks")
        connection.get(patience())
        bridge = manager._bridges.get("far")
        assert isinstance(bridge, RemoteBridge)
        process = bridge.process
    assert not lives(process)
    before.check()


def test_one_in_a_host_that_raises_is_degraded_and_lost_with_its_exception(
    robot: RobotManager, caplog: pytest.LogCaptureFixture
) -> None:
    events = Collector()
    robot.listen(events.deliver)
    connection = robot.request("refused")
    with pytest.raises(ConnectionClosedError, match=r"'refuser' was lost: .* is not wanted"):
        connection.get(patience())
    events.wait_for(lambda item: (item.subject, item.change) == ("component refuser", "lost"))
    reports = [message for message in events.messages if message.subject == "component refuser"]
    assert [report.change for report in reports] == ["degraded", "lost"]
    assert re.fullmatch(
        r"its input .default. raised ValueError: \d+ is not wanted", reports[0].cause
    )
    assert not [message for message in events.messages if message.subject == "component ticker"]
    records = [record for record in caplog.records if record.name.startswith("uoarm.component.")]
    assert {record.name for record in records} == {"uoarm.component.refuser"}
    assert len([record for record in records if " raised ValueError" in record.getMessage()]) == 1


def test_one_in_a_host_that_raises_is_replaced_by_the_next_candidate(robot: RobotManager) -> None:
    connection = robot.request("accepted")
    assert isinstance(connection.get(patience()), int)
    wait(lambda: connection.gaps)  # noted after the first message may have come
    assert connection.gaps[0].after == ("ticker", "modest")
    assert "'preferred' was lost: its input 'default' raises" in connection.gaps[0].cause


MOVING = """
version: 1
bridges: {{far: {{plugin: python, host: {host}}}, near: {{plugin: python}}}}
functions:
  ticks:
    components: [{{name: ticker, bridge: near, output: {{endpoint: ["hosted_parts:forever"]}}}}]
  where:
    components:
      - {{name: asker, bridge: far, service: {{endpoint: ["hosted_parts:process_id"]}}}}
"""


def test_a_bridge_moves_into_a_host_and_back_while_another_one_runs(tmp_path: Path) -> None:
    (tmp_path / "hosted_parts.py").write_text(hosted.COMPONENTS)
    file = tmp_path / "robot.yaml"
    file.write_text(MOVING.format(host="false"))
    with RobotManager.from_file(file) as robot:
        ticks = robot.request("ticks")
        assert robot.call("where", 0) == os.getpid()
        file.write_text(MOVING.format(host="{silence: 600, start: 600}"))
        assert robot.reload().differences == ("~ bridge far",)
        process = robot.call("where", 0, timeout=patience())
        assert process != os.getpid()
        file.write_text(MOVING.format(host="{python: /no/python}"))
        robot.reload()  # what is not needed yet is not started yet
        with pytest.raises(ResolutionError, match="there is no Python interpreter at /no/python"):
            robot.call("where", 0)
        file.write_text(MOVING.format(host="false"))
        robot.reload()
        assert robot.call("where", 0) == os.getpid()
        wait(lambda: not lives(process))
        assert ticks.gaps == ()
        assert ticks.get(patience()) is not None
