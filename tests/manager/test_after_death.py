"""What died is asked for again, not remembered: the next request gets the next candidate."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.errors import BridgeError, ResolutionError
from uoarm.model import Health, StatusEvent
from uoarm.testing import Collector, MemoryBridge, raising, wait

NUMBER: Any = {"type": "integer"}
ROBOT = """
version: 1
bridges: {memory: {}}
functions:
  camera:
    components:
      - {name: best, bridge: memory, priority: 2, output: {endpoint: [best]}}
      - {name: next, bridge: memory, priority: 1, output: {endpoint: [next]}}
"""


@pytest.fixture
def bridge() -> MemoryBridge:
    made = MemoryBridge()
    made.emitter("best", NUMBER)
    made.emitter("next", NUMBER)
    return made


@pytest.fixture
def robot(bridge: MemoryBridge) -> Iterator[RobotManager]:
    with RobotManager(loads(ROBOT), bridges={"memory": bridge}) as made:
        yield made


def test_after_a_death_the_next_candidate_is_chosen(
    robot: RobotManager, bridge: MemoryBridge
) -> None:
    with robot.request("camera") as camera:
        assert camera.plan.provider.component.name == "best"
        report = Collector()

        def listen(event: StatusEvent) -> None:
            if event.change == "replaced":
                report.deliver(event)

        robot.listen(listen)
        bridge.die("best")
        report.wait(1)
        assert camera.plan.provider.component.name == "next"
    assert robot.resolve("camera").provider.component.name == "next"
    bridge.emitter("best", NUMBER)
    assert robot.check_availability()[0].provider == "best"


def test_a_bridge_that_is_lost_is_asked_again_about_components_that_were_not_open(
    robot: RobotManager, bridge: MemoryBridge
) -> None:
    robot.resolve("camera")
    bridge._components.clear()
    report = Collector()
    robot.listen(report.deliver)
    bridge.report(Health.DEGRADED, "the cable is loose")
    report.wait(1)
    with pytest.raises(ResolutionError, match="no component"):
        robot.resolve("camera")


def test_after_a_failed_opening_everything_is_asked_again(
    robot: RobotManager, bridge: MemoryBridge
) -> None:
    with raising(bridge, "_open_source", OSError("unplugged")), pytest.raises(BridgeError):
        robot.request("camera")
    bridge.die("best")
    with robot.request("camera") as camera:
        assert camera.plan.provider.component.name == "next"


def test_a_survey_says_why_a_candidate_cannot_be_had(
    robot: RobotManager, bridge: MemoryBridge
) -> None:
    bridge.die("best")
    (camera,) = robot.check_availability()
    assert (camera.name, camera.provider) == ("camera", "next")
    assert [candidate.component for candidate in camera.candidates] == ["best", "next"]
    assert "no component" in camera.candidates[0].cause
    assert camera.candidates[1].cause == ""
    bridge.die("next")
    (camera,) = robot.check_availability()
    assert camera.provider is None
    assert "no component" in camera.cause


def test_a_service_that_is_gone_fails_one_call_and_the_next_candidate_answers() -> None:
    memory = MemoryBridge("memory")
    number = {"type": "integer"}
    for name, reply in (("best", 1), ("next", 2)):
        memory.service(name, number, number, lambda _, reply=reply: reply)  # type: ignore[misc]
    text = """
    version: 1
    bridges: {memory: {}}
    functions:
      plan:
        components:
          - {name: best, bridge: memory, priority: 2, service: {endpoint: [best]}}
          - {name: next, bridge: memory, priority: 1, service: {endpoint: [next]}}
    """
    with RobotManager(loads(text), bridges={"memory": memory}) as robot:
        events: list[str] = []
        robot.listen(lambda event: events.append(f"{event.subject} {event.change}"))
        assert robot.call("plan", 0) == 1
        memory.die("best")
        with pytest.raises(BridgeError, match="no component at"):
            robot.call("plan", 0)
        assert [robot.call("plan", 0) for _ in range(3)] == [2, 2, 2]
        memory.die("next")
        for _ in range(3):
            with pytest.raises((BridgeError, ResolutionError)):
                robot.call("plan", 0)
        memory.service("next", number, number, lambda _: 3)
        assert robot.call("plan", 0) == 3
        wait(lambda: "component next ok" in events)
        assert events.count("component best lost") == events.count("component next lost") == 1


def test_errors_of_a_call_show_its_limit_in_round_seconds(monkeypatch: pytest.MonkeyPatch) -> None:
    memory, limits = MemoryBridge("memory"), list[float]()
    memory.service("one", NUMBER, NUMBER, lambda _: 1)
    call = memory.call

    def noting(*args: Any, timeout: float, **more: Any) -> Any:
        limits.append(timeout)
        return call(*args, timeout=timeout, **more)

    monkeypatch.setattr(memory, "call", noting)
    text = """
    version: 1
    bridges: {memory: {}}
    functions:
      plan: {components: [{name: one, bridge: memory, service: {endpoint: [one]}}]}
    """
    with RobotManager(loads(text), bridges={"memory": memory}) as robot:
        assert robot.call("plan", 0, timeout=1e6 / 3) == 1
    assert limits == [round(limits[0], 2)]
