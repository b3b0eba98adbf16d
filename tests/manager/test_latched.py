"""A latched output gives its last message to every consumer that joins, not to the first alone."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.testing import MemoryBridge, patience

NUMBER = {"type": "integer", "minimum": 0, "maximum": 1000}

ROBOT = """
version: 1
bridges: {one: {plugin: memory}, two: {plugin: memory}}
functions:
  limit:
    components:
      - {name: best, bridge: one, priority: 2, output: {endpoint: [best]}}
      - {name: next, bridge: two, priority: 1, output: {endpoint: [next]}}
  controller:
    components:
      - name: controller
        bridge: two
        input: {from: limit, endpoint: [controller]}
        output: {endpoint: [controller]}
"""


class Stage:
    def __init__(self) -> None:
        self.one, self.two = MemoryBridge("one", {}), MemoryBridge("two", {})
        self.best = self.one.emitter("best", NUMBER, latched=True)
        self.next = self.two.emitter("next", NUMBER, latched=True)
        self.two.loop("controller", NUMBER)
        self.robot = RobotManager(loads(ROBOT), bridges={"one": self.one, "two": self.two})


@pytest.fixture
def stage() -> Iterator[Stage]:
    made = Stage()
    yield made
    made.robot.close()


def test_a_viewer_that_was_there_first_does_not_take_the_controllers_limit(stage: Stage) -> None:
    stage.best.emit(7)
    viewer = stage.robot.request("limit")
    assert viewer.get(patience()) == 7
    controller = stage.robot.request("controller")
    assert controller.get(patience()) == 7
    stage.best.emit(8)
    assert (viewer.get(patience()), controller.get(patience())) == (8, 8)


@pytest.mark.parametrize("viewed", [False, True])
def test_the_limit_of_what_takes_over_arrives(stage: Stage, viewed: bool) -> None:
    """Also where a viewer has its output open already, which gets nothing twice."""
    stage.best.emit(7)
    stage.next.emit(9)
    controller = stage.robot.request("controller")
    assert controller.get(patience()) == 7
    viewer = stage.robot.request("limit") if viewed else None
    stage.one.die("best", "unplugged")
    assert controller.get(patience()) == 9
    if viewer is not None:
        assert [viewer.get(patience()) for _ in range(2)] == [7, 9]
    stage.next.emit(10)
    assert controller.get(patience()) == 10
    if viewer is not None:
        assert viewer.get(patience()) == 10


def test_the_last_of_each_writer_is_for_who_joins(stage: Stage) -> None:
    first = stage.robot.request("limit")
    for writer, number in (("a", 1), ("b", 2), ("a", 3), ("c", 4)):
        stage.best.emit(number, writer)
    assert [first.get(patience()) for _ in range(4)] == [1, 2, 3, 4]
    second = stage.robot.request("limit")
    assert [second.get(patience()) for _ in range(3)] == [2, 3, 4]
    stage.best.clear("b")
    stage.best.emit(5, "c")
    third = stage.robot.request("limit")
    assert [third.get(patience()) for _ in range(2)] == [3, 5]
    with pytest.raises(TimeoutError):
        third.get(0)
