"""A structure that changes while a plan is being sought is in the next plan."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from uoarm import RobotManager
from uoarm.bridge import Description
from uoarm.config import loads
from uoarm.model import Endpoint, Health, Plan, StatusEvent
from uoarm.testing import Background, Collector, Hang, MemoryBridge, patience

OLD: Any = {"type": "integer", "minimum": 0}
NEW: Any = {"type": "integer"}
ROBOT = """
version: 1
bridges: {one: {plugin: memory}, two: {plugin: memory}}
functions:
  camera:
    components: [{name: camera, bridge: one, output: {endpoint: [camera]}}]
  face:
    components:
      - {name: face, bridge: two, input: {from: camera, endpoint: [face]},
         output: {endpoint: [face]}}
"""


class SlowAnswers(MemoryBridge):
    """Answers with what it knew when it was asked, after a wait where a test wishes one."""

    hang: Hang | None = None

    def _describe(self, endpoint: Endpoint) -> Description:
        described = super()._describe(endpoint)
        if self.hang is not None:
            self.hang.wait()
        return described


class Scene:
    """A chain over two bridges that describe slowly, and what is reported."""

    def __init__(self) -> None:
        self.one, self.two = SlowAnswers("one"), SlowAnswers("two")
        self.one.emitter("camera", {"type": "integer", "minimum": 0, "maximum": 9})
        self.two.loop("face", OLD)
        bridges = {"one": self.one, "two": self.two}
        self.robot = RobotManager(loads(ROBOT), bridges=bridges)
        self.events = Collector()
        self.robot.listen(self.events.deliver)

    def change_face_while(self, bridge: SlowAnswers) -> None:
        """Change a structure while a plan is being sought, for which a bridge is being asked."""
        bridge.hang = Hang()
        sought = Background(lambda: self.robot.resolve("face"))
        assert bridge.hang.entered.wait(patience())
        self.two.die("face")
        self.two.loop("face", NEW)
        self.two.report(Health.DEGRADED, "it was started again")
        self.events.wait_for(_is_about_two)  # reported after everything about it was forgotten
        hang, bridge.hang = bridge.hang, None
        hang.release()
        assert _is_new(sought.result())

    def has_new_face(self) -> bool:
        return _is_new(self.robot.resolve("face"))


def _is_new(plan: Plan) -> bool:
    return all(structure.schema == NEW for structure in plan.provider.structures.values())


def _is_about_two(event: object) -> bool:
    return isinstance(event, StatusEvent) and event.subject == "bridge two"


@pytest.fixture
def scene() -> Iterator[Scene]:
    made = Scene()
    with made.robot:
        yield made


def test_a_plan_that_was_sought_meanwhile_is_not_kept(scene: Scene) -> None:
    scene.change_face_while(scene.one)
    assert scene.has_new_face()


def test_an_answer_that_was_under_way_is_not_kept(scene: Scene) -> None:
    scene.change_face_while(scene.two)
    assert scene.has_new_face()
