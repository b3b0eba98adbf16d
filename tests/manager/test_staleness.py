"""An output that emits less than is expected of it is taken for dead, and no other one is."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from uoarm import RobotManager
from uoarm.bridge import HealthEvent
from uoarm.config import loads
from uoarm.manager._staleness import StalenessWatch
from uoarm.model import Expectation, Health
from uoarm.testing import Collector, Emitter, ManualClock, MemoryBridge

ROBOT = """
version: 1
bridges: {memory: {}}
functions:
  camera:
    components:
      - name: best
        bridge: memory
        priority: 2
        output: {endpoint: [best], expect: {rate: 10, patience: 2}}
      - {name: next, bridge: memory, priority: 1, output: {endpoint: [next]}}
"""
NUMBER = {"type": "integer"}


class Stage:
    """A robot whose clock stands, and a watch that looks when it is told to."""

    def __init__(self) -> None:
        self.clock = ManualClock()
        self.bridge = MemoryBridge("memory", {})
        self.best: Emitter = self.bridge.emitter("best", NUMBER)
        self.next: Emitter = self.bridge.emitter("next", NUMBER)
        self.robot = RobotManager(loads(ROBOT), bridges={"memory": self.bridge}, clock=self.clock)
        self.robot._staleness.close()
        self.told: list[HealthEvent] = []
        self.watch = StalenessWatch(self.robot._pool.components, self.told.append, self.clock)

    def play(self, messages: int, seconds: float) -> None:
        """Emit messages evenly over a time, looking after each."""
        for number in range(messages):
            self.best.emit(number)
            self.clock.advance(seconds / messages)
            self.watch.look()


@pytest.fixture
def stage() -> Iterator[Stage]:
    made = Stage()
    yield made
    made.robot.close()


def test_what_an_output_is_expected_to_do_is_read_from_the_file() -> None:
    best, following = loads(ROBOT).components()
    assert best.outputs[0].expect == Expectation(10, 2)
    assert following.outputs[0].expect is None


def test_one_that_keeps_its_rate_is_left_alone(stage: Stage) -> None:
    stage.robot.request("camera")
    stage.watch.look()
    stage.play(100, 10.0)
    assert stage.told == []


def test_one_that_falls_silent_is_lost_when_its_patience_is_over(stage: Stage) -> None:
    stage.robot.request("camera")
    stage.play(30, 3.0)
    for _ in range(45):
        stage.clock.advance(0.1)
        stage.watch.look()
        if stage.told:
            break
    (event,) = stage.told
    assert event.health is Health.LOST
    assert event.component == "best"
    assert "messages a second over 2 s, 10 are expected" in event.cause
    assert 4.0 <= stage.clock.now() <= 7.1  # half its patience after the last one, or twice


def test_one_that_is_half_as_fast_passes_and_a_slower_one_does_not(stage: Stage) -> None:
    stage.robot.request("camera")
    stage.watch.look()
    stage.play(30, 5.0)
    assert stage.told == []
    stage.play(30, 10.0)
    assert stage.told


def test_one_that_nobody_uses_is_not_judged(stage: Stage) -> None:
    connection = stage.robot.request("camera")
    stage.watch.look()
    connection.kill()
    stage.clock.advance(60)
    stage.watch.look()
    assert stage.told == []


def test_a_consumer_that_comes_late_starts_the_count_anew(stage: Stage) -> None:
    stage.clock.advance(60)
    stage.robot.request("camera")
    stage.watch.look()
    stage.clock.advance(1.9)
    stage.watch.look()
    assert stage.told == []


def test_the_next_candidate_takes_over_from_a_stale_one() -> None:
    clock = ManualClock()
    bridge = MemoryBridge("memory", {})
    bridge.emitter("best", NUMBER)
    following = bridge.emitter("next", NUMBER)
    with RobotManager(loads(ROBOT), bridges={"memory": bridge}, clock=clock) as robot:
        replaced = Collector()
        robot.listen(lambda event: replaced.deliver(event) if event.change == "replaced" else None)
        connection = robot.request("camera")
        robot._staleness.look()
        clock.advance(3)
        replaced.wait(1)
        following.emit(1)
        assert connection.get(5) == 1
        assert "is stale" in connection.gaps[0].cause
