"""The bridge `status`: the manager's health as diagnostics, level by level and in a robot."""

from __future__ import annotations

from typing import Any

import pytest
from attrs import evolve
from jsonschema import Draft202012Validator

from uoarm import RobotManager
from uoarm.bridge import Registry
from uoarm.config import loads
from uoarm.errors import BridgeError, ConfigurationError, ResolutionError
from uoarm.local.status import DIAGNOSTICS, DiagnosticLevel, Diagnostics, StatusOptions
from uoarm.model import (
    BridgeSpec,
    BridgeStatus,
    ComponentStatus,
    ConnectionState,
    ConnectionStatus,
    Endpoint,
    Health,
    MachineStatus,
    OfferState,
    OfferStatus,
    Role,
    RouteStatus,
    StatusMap,
)
from uoarm.testing import MemoryBridge, wait

OK, WARN, ERROR, STALE = DiagnosticLevel
ROBOT = """
version: 1
bridges: {memory: {}, status: {}}
functions:
  camera: {components: [{name: camera, bridge: memory, output: {endpoint: [camera]}}]}
  health:
    components:
      - {name: manager, bridge: status, output: {endpoint: [diagnostics], options: {period: 0.1}}}
"""
WELL = StatusMap(
    bridges=(BridgeStatus("ros", "ros2", Health.OK, 1, facts=(("empty_turns", 0),)),),
    components=(ComponentStatus("camera", "vision", "ros", Health.OK, ("c1",)),),
    connections=(ConnectionStatus("c1", "vision", ConnectionState.RUNNING, ("camera",)),),
    routes=(RouteStatus("camera.default", "c1", 12, 12, rate=10.0, age=0.1),),
)


def entries(
    status: StatusMap, options: StatusOptions | None = None, made: Diagnostics | None = None
) -> dict[str, Any]:
    message: Any = (made or Diagnostics(options or StatusOptions())).message(status, 1_500_000_000)
    Draft202012Validator(DIAGNOSTICS.schema).validate(message)
    return {entry["name"].removeprefix("uoarm: "): entry for entry in message["status"]}


def values(entry: Any) -> dict[str, str]:
    return {pair["key"]: pair["value"] for pair in entry["values"]}


def test_what_runs_is_ok_with_its_rates_and_counts() -> None:
    found = entries(WELL, StatusOptions(hardware_id="robot 7"))
    assert {entry["level"] for entry in found.values()} == {OK}
    assert {entry["hardware_id"] for entry in found.values()} == {"robot 7"}
    assert set(found) == {"manager", "bridge ros", "component camera", "function vision"}
    function = values(found["function vision"])
    assert function["connections"] == "c1"
    assert function["rate"] == "10.000"
    assert (function["received"], function["dropped"], function["lost"]) == ("12", "0", "0")
    assert values(found["bridge ros"])["empty_turns"] == "0"


@pytest.mark.parametrize(
    ("health", "level"),
    [(Health.DEGRADED, WARN), (Health.LOST, ERROR), (Health.FINISHED, OK)],
)
def test_health_of_bridges_and_components_is_a_level_with_its_cause(
    health: Health, level: DiagnosticLevel
) -> None:
    ill = evolve(
        WELL,
        bridges=(evolve(WELL.bridges[0], health=health, cause="why"),),
        components=(evolve(WELL.components[0], health=health, cause="why"),),
    )
    found = entries(ill)
    for name in ("bridge ros", "component camera"):
        assert (found[name]["level"], found[name]["message"]) == (level, "why")


def test_what_a_lost_bridge_or_an_absent_machine_said_last_is_stale() -> None:
    lost = evolve(WELL, bridges=(evolve(WELL.bridges[0], health=Health.LOST),))
    found = entries(lost)
    assert (found["bridge ros"]["level"], found["component camera"]["level"]) == (ERROR, STALE)
    away = evolve(WELL, machines=(MachineStatus("arm", False, ("ros",), cause="not joined"),))
    found = entries(away)
    assert found["machine arm"]["level"] == ERROR
    assert (found["bridge ros"]["level"], found["component camera"]["level"]) == (STALE, STALE)


def test_what_was_lost_and_is_not_open_is_stale() -> None:
    found = entries(evolve(WELL, components=(), deaths=(("camera", 2),)))
    assert found["component camera"]["level"] == STALE
    assert "lost, 2 times" in found["component camera"]["message"]


def test_a_connection_that_waits_is_an_error_and_outranks_one_that_runs() -> None:
    waiting = ConnectionStatus("c2", "vision", ConnectionState.WAITING, (), "camera was lost")
    found = entries(evolve(WELL, connections=(*WELL.connections, waiting)))
    assert found["function vision"]["level"] == ERROR
    assert "camera was lost" in found["function vision"]["message"]
    assert values(found["function vision"])["connections"] == "c1, c2"


def test_losses_warn_in_the_report_after_them_and_in_no_later_one() -> None:
    made = Diagnostics(StatusOptions())
    dropped = evolve(WELL, routes=(evolve(WELL.routes[0], dropped=(("queue", 3),)),))
    levels = [
        entries(status, made=made)["function vision"]["level"]
        for status in (WELL, dropped, dropped)
    ]
    assert levels == [OK, WARN, OK]


def test_a_function_without_messages_is_stale_only_where_that_was_asked_for() -> None:
    silent = evolve(WELL, routes=(evolve(WELL.routes[0], age=9.0),))
    assert entries(silent)["function vision"]["level"] == OK
    assert entries(silent, StatusOptions(stale_after=5.0))["function vision"]["level"] == STALE


def test_an_emergency_stop_and_a_failed_offer_show() -> None:
    offer = OfferStatus("ros:x", "x", "ros", OfferState.FAILED, (), cause="no type")
    found = entries(evolve(WELL, held=3.0, offers=(offer,)))
    assert found["manager"]["level"] == WARN
    assert (found["offer ros:x"]["level"], found["offer ros:x"]["message"]) == (ERROR, "no type")


def test_texts_are_cut_and_hold_no_zero() -> None:
    long = evolve(WELL, bridges=(evolve(WELL.bridges[0], cause="a\0b" * 1000),))
    text = entries(long)["bridge ros"]["message"]
    assert len(text) == 500
    assert "\0" not in text


def test_a_manager_gives_its_own_health_as_a_function() -> None:
    memory = MemoryBridge("memory")
    camera = memory.emitter("camera", {"type": "integer"})
    with RobotManager(loads(ROBOT), bridges={"memory": memory}) as robot:
        robot.request("camera")
        latest: list[Any] = []
        robot.request("health", on_message=latest.append)
        camera.emit(1)

        def found(name: str) -> Any:
            message = latest[-1] if latest else {"status": []}
            return next((item for item in message["status"] if item["name"] == name), None)

        wait(lambda: (found("uoarm: function camera") or {}).get("level") == OK)
        memory.report(Health.DEGRADED, "a bad cable", component="camera")
        wait(lambda: (found("uoarm: component camera") or {}).get("level") == WARN)
        assert found("uoarm: component camera")["message"] == "a bad cable"
        assert values(found("uoarm: bridge status"))["plugin"] == "status"


def test_it_has_one_output_and_says_so() -> None:
    with pytest.raises(ConfigurationError, match=r"expected \['diagnostics'\]"):
        loads(ROBOT.replace("[diagnostics]", "[health]"), types=Registry().types)
    bridge = Registry().create(BridgeSpec("status", "status", {}))
    try:
        output = Endpoint("status", "manager", Role.OUTPUT, ("diagnostics",))
        with pytest.raises(BridgeError, match="leave `host` out"):
            bridge.describe(output)
        with pytest.raises(BridgeError, match="no other"):
            bridge.describe(evolve(output, role=Role.SERVICE))
    finally:
        bridge.close()


def test_in_a_host_it_says_that_it_reads_the_manager_of_its_own_process() -> None:
    text = ROBOT.replace("status: {}", "status: {host: {}}")
    memory = MemoryBridge("memory")
    with (
        RobotManager(loads(text), bridges={"memory": memory}) as robot,
        pytest.raises(ResolutionError, match="leave `host` out"),
    ):
        robot.request("health")
