"""An output that emits less than is expected of it is taken for dead, and no other one is."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from uoarm import RobotManager
from uoarm._parts import StalenessWatch
from uoarm.bridge import HealthEvent
from uoarm.config import loads
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import ConnectionState, Expectation, Health
from uoarm.testing import Collector, Emitter, ManualClock, MemoryBridge, patience, wait

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
    """A robot whose clock stands, and a watch that looks when it is to."""

    def __init__(self) -> None:
        self.clock = ManualClock()
        self.bridge = MemoryBridge("memory", {})
        self.best: Emitter = self.bridge.emitter("best", NUMBER)
        self.next: Emitter = self.bridge.emitter("next", NUMBER)
        self.robot = RobotManager(loads(ROBOT), bridges={"memory": self.bridge}, clock=self.clock)
        self.robot._staleness.close()
        self.events: list[HealthEvent] = []
        self.watch = StalenessWatch(
            self.robot._driver.live.shared,
            self.robot._driver.live.feeding,
            self.events.append,
            self.clock,
        )

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
    assert stage.events == []


def test_one_that_falls_silent_is_lost_when_its_patience_is_over(stage: Stage) -> None:
    stage.robot.request("camera")
    stage.play(30, 3.0)
    for _ in range(45):
        stage.clock.advance(0.1)
        stage.watch.look()
        if stage.events:
            break
    (event,) = stage.events
    assert event.health is Health.LOST
    assert event.component == "best"
    assert "messages a second over 2 s, 10 are expected" in event.cause
    assert 4.0 <= stage.clock.now() <= 7.1  # half its patience after the last one, or twice


def test_a_look_says_when_the_next_one_may_be_stale(stage: Stage) -> None:
    assert stage.watch.look() is None
    connection = stage.robot.request("camera")
    assert stage.watch.look() == 2.0
    stage.play(12, 1.5)
    assert stage.watch.look() == 0.5
    stage.play(4, 0.5)  # a new patience begins
    assert stage.watch.look() == 2.0
    connection.kill()
    assert stage.watch.look() is None
    assert stage.events == []


def test_what_is_opened_and_closed_is_looked_at_at_once(stage: Stage) -> None:
    looks: list[float | None] = []
    stage.robot._driver.when_changed = lambda: looks.append(stage.watch.look())
    connection = stage.robot.request("camera")
    assert looks[-1] == 2.0
    connection.kill()
    assert looks[-1] is None


def test_one_that_is_half_as_fast_passes_and_a_slower_one_does_not(stage: Stage) -> None:
    stage.robot.request("camera")
    stage.watch.look()
    stage.play(30, 5.0)
    assert stage.events == []
    stage.play(30, 10.0)
    assert stage.events


def test_one_that_no_connection_uses_is_not_judged(stage: Stage) -> None:
    connection = stage.robot.request("camera")
    stage.watch.look()
    connection.kill()
    stage.clock.advance(60)
    stage.watch.look()
    assert stage.events == []


def test_a_consumer_that_comes_late_starts_the_count_anew(stage: Stage) -> None:
    stage.clock.advance(60)
    stage.robot.request("camera")
    stage.watch.look()
    stage.clock.advance(1.9)
    stage.watch.look()
    assert stage.events == []


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
        assert connection.get(patience()) == 1
        assert "is stale" in connection.gaps[0].cause


CHAIN = """
version: 1
bridges: {memory: {}}
functions:
  camera:
    components:
      - {name: best, bridge: memory, priority: 2, output: {endpoint: [best]EXPECT}}
      - {name: spare, bridge: memory, priority: 1, output: {endpoint: [spare]}}
  face:
    components:
      - name: detector
        bridge: memory
        priority: 2
        input: {from: camera, endpoint: [detector]}
        output: {endpoint: [detector], expect: {rate: 10, patience: 2}}
      - name: second
        bridge: memory
        priority: 1
        input: {from: camera, endpoint: [second]}
        output: {endpoint: [second]}
"""
SPOKEN_FOR = ", expect: {rate: 10, patience: 2}"


class Chain:
    """Two cameras and two detectors, of which the better ones are expected to give 10 Hz."""

    def __init__(self, expect: str) -> None:
        self.clock = ManualClock()
        self.bridge = MemoryBridge("memory", {})
        self.best, self.spare = (self.bridge.emitter(name, NUMBER) for name in ("best", "spare"))
        self.detector = self.bridge.loop("detector", NUMBER)
        self.bridge.loop("second", NUMBER)
        robot = loads(CHAIN.replace("EXPECT", expect))
        self.robot = RobotManager(robot, bridges={"memory": self.bridge}, clock=self.clock)
        self.robot._staleness.close()
        self.events: list[HealthEvent] = []
        report = self.robot._staleness._report

        def report_event(event: HealthEvent) -> None:
            self.events.append(event)
            report(event)

        self.robot._staleness._report = report_event
        self.handled = Collector()
        self.robot.listen(self.handled.deliver)
        self.face = self.robot.request("face")

    def play(self, camera: Emitter, rate: float, seconds: float) -> None:
        """Emit evenly, and look after each message has passed."""
        for number in range(int(seconds * rate)):
            camera.emit(number)
            assert self.face.get(patience()) == number
            self.pass_by(1 / rate)

    def pass_by(self, seconds: float) -> None:
        """Let time pass, and have what is stale then replaced before going on."""
        self.clock.advance(seconds)
        before, report = (
            self.face.gaps,
            len(self.events),
        )  # it may be replaced as soon as it is reported
        self.robot._staleness.look()
        if len(self.events) > report:
            wait(lambda: self.face.gaps != before)

    def fall_silent(self) -> None:
        """Let time pass without a message until something is stale, ten seconds at most."""
        before = self.face.gaps
        for _ in range(20):
            if self.face.gaps == before:
                self.pass_by(0.5)

    def moves(self) -> list[tuple[str, ...]]:
        return [gap.after for gap in self.face.gaps]


@pytest.fixture
def chain(request: pytest.FixtureRequest) -> Iterator[Chain]:
    made = Chain(getattr(request, "param", SPOKEN_FOR))
    yield made
    made.robot.close()


def test_a_detector_that_gets_too_little_is_not_blamed_for_it(chain: Chain) -> None:
    chain.play(chain.best, 10, 5)
    chain.fall_silent()
    chain.play(chain.spare, 4, 120)
    assert chain.moves() == [("spare", "detector")]
    assert chain.face.state is ConnectionState.RUNNING
    assert "component 'best' was lost: output 'default' is stale" in chain.face.gaps[0].cause


@pytest.mark.parametrize("chain", [""], indirect=True)
def test_what_feeds_one_with_an_expectation_is_stale_when_it_falls_silent(chain: Chain) -> None:
    chain.play(chain.best, 10, 5)
    chain.fall_silent()
    chain.play(chain.spare, 10, 5)
    assert chain.moves() == [("spare", "detector")]


def test_a_detector_that_gets_enough_and_gives_too_little_is_stale(
    chain: Chain, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(chain.detector, "take", lambda _: None)
    chain.robot._staleness.look()
    for number in range(20):
        chain.best.emit(number)
        chain.clock.advance(0.1)
    chain.pass_by(0.1)
    assert chain.moves() == [("best", "second")]


def test_that_one_took_nothing_of_what_fed_it_is_said_with_why(
    chain: Chain, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_: object) -> None:
        raise BridgeError("it has no room", FailureReason.UNAVAILABLE)

    monkeypatch.setattr(chain.detector, "take", refuse)
    chain.robot._staleness.look()
    for number in range(20):
        chain.best.emit(number)
        chain.clock.advance(0.1)
    wait(lambda: any(route.refusal for route in chain.robot.status().routes))
    chain.pass_by(0.1)
    refusal = "the last message of best.default -> detector.default was refused: it has no room"
    assert refusal in chain.face.gaps[0].cause


def test_a_detector_is_not_blamed_for_what_cannot_be_read(chain: Chain) -> None:
    chain.robot._staleness.look()
    for _ in range(6):
        with chain.best.garbled():
            for number in range(4):
                chain.best.emit(number)
                chain.clock.advance(0.1)
        chain.play(chain.best, 10, 0.1)
    assert chain.events == []


def test_a_new_request_does_not_go_to_what_was_stale_either(chain: Chain) -> None:
    chain.play(chain.best, 10, 5)
    chain.fall_silent()
    assert chain.robot.request("face").plan == chain.face.plan
    assert chain.robot.request("camera").plan.provider.component.name == "spare"
    chain.bridge.die("spare")
    chain.handled.wait_for(lambda event: event.subject == "component spare")
    assert chain.robot.resolve("camera").provider.component.name == "best"


def test_what_was_stale_is_forgiven_in_the_end(chain: Chain) -> None:
    chain.play(chain.best, 10, 5)
    chain.fall_silent()
    assert chain.robot.resolve("camera").provider.component.name == "spare"
    chain.clock.advance(301)
    assert chain.robot.resolve("camera").provider.component.name == "best"


class CountedEdge:
    """An edge between two components that counts how often it is looked at."""

    looks = 0

    def __init__(self, producer: object, consumer: object) -> None:
        self.producer, self._consumer = producer, consumer
        self.edge, self.route = SimpleNamespace(output="default"), None

    @property
    def consumer(self) -> object:
        CountedEdge.looks += 1
        return self._consumer


class Silent:
    """A component of whose output something is expected, and to which nothing is attached."""

    def __init__(self) -> None:
        output = SimpleNamespace(name="default", expect=Expectation(1.0, 3.0))
        self.component = SimpleNamespace(outputs=(output,))
        self.outlets = {"default": SimpleNamespace(routes=())}


def test_a_look_at_many_looks_at_each_edge_once() -> None:
    """It comes up to ten times a second, while much changes."""
    components = [Silent() for _ in range(200)]
    edges = [CountedEdge(*pair) for pair in itertools.pairwise(components)]
    given: Any = (lambda: components, lambda: edges, [].append, ManualClock())
    StalenessWatch(*given).look()
    assert CountedEdge.looks == len(edges)
