"""What a bridge reports of a component reaches the user, also where it is called and never open."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from uoarm import BridgeError, RobotManager
from uoarm.config import loads
from uoarm.errors import FailureReason
from uoarm.model import ComponentStatus, Health, StatusEvent
from uoarm.testing import Collector, MemoryBridge, patience, wait

NUMBER: Any = {"type": "integer"}
ROBOT = """
version: 1
bridges: {memory: {}}
functions:
  camera:
    components:
      - {name: camera, bridge: memory, output: {endpoint: [camera]}}
  show:
    components:
      - {name: show, bridge: memory, input: {endpoint: [show]}}
  plan:
    components:
      - {name: best, bridge: memory, priority: 2, service: {endpoint: [best]}}
      - {name: next, bridge: memory, priority: 1, service: {endpoint: [next]}}
"""
TROUBLE = [health for health in Health if health is not Health.OK]


class Scene:
    """A robot with a component of each kind, and what its listeners learn."""

    def __init__(self) -> None:
        self.bridge = MemoryBridge()
        self.bridge.emitter("camera", NUMBER)
        self.bridge.taker("show", NUMBER)
        self.serve("best", 1)
        self.serve("next", 2)
        self.robot = RobotManager(loads(ROBOT), bridges={"memory": self.bridge})
        self.events = Collector()
        self.robot.listen(self.events.deliver)

    def serve(self, name: str, reply: int) -> None:
        self.bridge.service(name, NUMBER, NUMBER, lambda _: reply)

    def report(self, health: Health, cause: str, name: str = "best", about: str = "") -> None:
        self.bridge.report(health, cause, component=name, about=about)

    def call(self) -> Any:
        return self.robot.call("plan", 0, timeout=patience())

    def component(self, name: str = "best") -> ComponentStatus | None:
        return next((item for item in self.robot.status().components if item.name == name), None)

    def health(self, name: str = "best") -> tuple[Health, str] | None:
        found = self.component(name)
        return None if found is None else (found.health, found.cause)

    def changes(self, subject: str = "component best") -> list[tuple[str, str, str]]:
        """Return what was announced so far, by waiting for something that is announced after it."""
        self.report(Health.DEGRADED, "it is the last", "next")
        self.events.wait_for(lambda item: item.cause == "it is the last")
        found: list[StatusEvent] = self.events.messages
        return [
            (item.change, item.cause, item.function) for item in found if item.subject == subject
        ]


@pytest.fixture
def scene() -> Iterator[Scene]:
    made = Scene()
    with made.robot:
        yield made


@pytest.mark.parametrize("health", TROUBLE)
@pytest.mark.parametrize(("name", "function"), [("camera",) * 2, ("show",) * 2, ("best", "plan")])
def test_each_report_of_each_kind_of_component_is_announced(
    scene: Scene, name: str, function: str, health: Health
) -> None:
    if function == "plan":
        scene.call()
    else:
        scene.robot.request(function)
    scene.report(health, "it is hot", name)
    assert scene.changes(f"component {name}") == [(health.value, "it is hot", function)]


@pytest.mark.parametrize("health", TROUBLE)
def test_a_service_is_shown_as_it_was_reported_until_it_is_well(
    scene: Scene, health: Health
) -> None:
    scene.call()
    assert scene.health() is None, "what is well and not open is not shown"
    scene.report(health, "it is hot")
    assert scene.health() == (health, "it is hot")
    assert f"best  plan      {health.value}" in str(scene.robot.status())
    scene.report(Health.OK, "it is cool")
    assert scene.health() is None
    scene.report(Health.OK, "it is cool")
    assert scene.changes() == [(health.value, "it is hot", "plan"), ("ok", "it is cool", "plan")]


def test_a_service_that_works_badly_is_called_still(scene: Scene) -> None:
    scene.report(Health.DEGRADED, "it is hot")
    assert [scene.call(), scene.call()] == [1, 1]
    assert scene.health() == (Health.DEGRADED, "it is hot")


def test_after_the_loss_of_a_service_the_next_call_goes_to_the_next_one(scene: Scene) -> None:
    assert scene.call() == 1
    scene.bridge.die("best")
    scene.report(Health.LOST, "it left")
    assert [scene.call(), scene.call()] == [2, 2], "no call is lost to it"
    assert scene.health() == (Health.LOST, "it left")
    scene.serve("best", 3)
    scene.report(Health.OK, "it is back")
    assert scene.health() is None
    assert scene.call() == 3


def test_a_lost_service_that_answers_again_is_well(scene: Scene) -> None:
    scene.report(Health.LOST, "it left")
    scene.report(Health.DEGRADED, "it is hot", about="heat")
    assert scene.health() == (Health.LOST, "it left")
    assert scene.call() == 1, "it can be described"
    assert scene.health() == (Health.DEGRADED, "it is hot")
    assert scene.robot.status().deaths == (("best", 1),)


def test_a_service_that_is_gone_without_a_report_is_shown_as_lost(scene: Scene) -> None:
    scene.call()
    scene.bridge.die("best")
    with pytest.raises(BridgeError, match="no component at"):
        scene.call()
    found = scene.component()
    assert found is not None
    assert (found.health, found.failed) == (Health.LOST, 0)
    assert "no component at ['best']" in found.cause
    assert scene.call() == 2
    scene.serve("best", 3)
    scene.report(Health.OK, "it is back")
    assert scene.call() == 3, "it is avoided no more"


def test_a_service_that_is_lost_and_not_found_then_died_once(scene: Scene) -> None:
    def leave(_: object) -> None:
        raise BridgeError("no component at ['best']", FailureReason.NOT_FOUND)

    scene.bridge.die("best")
    scene.bridge.service("best", NUMBER, NUMBER, leave)
    scene.report(Health.LOST, "it left")
    with pytest.raises(BridgeError, match="no component at"):
        scene.call()
    assert scene.call() == 2, "it is avoided"
    assert scene.changes() == [("lost", "it left", "plan")]
    assert scene.robot.status().deaths == (("best", 1),)


def test_what_a_service_raises_and_what_is_reported_of_it_cover_up_nothing(scene: Scene) -> None:
    def fail(_: object) -> None:
        raise ValueError("no")

    scene.bridge.die("best")
    scene.bridge.service("best", NUMBER, NUMBER, fail)
    scene.report(Health.DEGRADED, "it is hot")
    with pytest.raises(BridgeError):
        scene.call()
    scene.report(Health.OK, "it is cool")
    found = scene.component()
    assert found is not None
    assert (found.health, found.failed) == (Health.DEGRADED, 1)
    assert "raised ValueError: no" in found.cause
    scene.report(Health.LOST, "it left")
    assert scene.health() == (Health.LOST, "it left")
    scene.report(Health.OK, "it is back")
    assert scene.health() == (Health.DEGRADED, found.cause)


def test_what_was_reported_of_a_service_ends_with_the_service(scene: Scene) -> None:
    def fail(_: object) -> None:
        raise ValueError("no")

    scene.bridge.service("other", NUMBER, NUMBER, fail)
    scene.report(Health.LOST, "it left")
    scene.robot.apply(loads(ROBOT.replace("endpoint: [best]", "endpoint: [other]")))
    assert scene.component() is None
    with pytest.raises(BridgeError):
        scene.call()
    assert scene.component() is not None
    scene.robot.apply(loads(ROBOT))
    assert scene.component() is None, "it is another one that raised"
    assert scene.call() == 1


def test_a_report_of_what_is_not_open_and_no_service_is_not_shown(scene: Scene) -> None:
    scene.report(Health.LOST, "it left", "camera")
    scene.report(Health.LOST, "it left", "nothing")
    assert scene.robot.status().components == ()
    with scene.robot.request("camera"):
        wait(lambda: scene.component("camera") is not None)
        assert scene.health("camera") == (Health.OK, "")
