"""What moves is stopped before what takes its place gets the first command, whatever the reason."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import pytest

from uoarm import RobotManager
from uoarm._control.live.parts import Ending
from uoarm._parts import LiveComponent
from uoarm.bridge import Description, Registry, Sink
from uoarm.config import loads
from uoarm.model import Endpoint, Health, Message, MessageStructure
from uoarm.testing import Background, MemoryBridge, patience, wait

ROBOT = """
version: 1
bridges: {{motors: {{plugin: python}}, memory: {{plugin: python}}}}
functions:
  plan: {{components: [{{name: planner, bridge: memory, output: {{endpoint: [planner]}}}}]}}
  drive:
    components:
      - {{name: left, bridge: motors, priority: {left}, input: {{endpoint: [left], {settings}}}}}
      - {{name: right, bridge: motors, priority: 2, input: {{endpoint: [right], {settings}}}}}
"""
SETTINGS = "lifetime: 3600, stop: {message: 0}"


class Motors(MemoryBridge):
    """Motors that note what they take, all in one list, and are let go late."""

    def __init__(self) -> None:
        super().__init__("motors")
        self.taken: list[tuple[str, Message]] = []
        self.opened: list[str] = []
        self.may_close = threading.Event()
        self.may_close.set()
        self.may_stop = threading.Event()
        self.may_stop.set()
        self.stopping = threading.Event()

    def _describe(self, endpoint: Endpoint) -> Description:
        return Description(MessageStructure({"type": "number"}))

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        name = endpoint.component
        self.opened.append(name)

        def take(message: Message) -> None:
            if message == 0:
                self.stopping.set()
                self.may_stop.wait(patience())
            self.taken.append((name, message))

        return Sink(
            endpoint,
            take,
            lambda: self.may_close.wait(patience()),
            blocking=False,
        )

    def _close(self) -> None:
        self.may_close.set()


@pytest.fixture
def motors() -> Motors:
    return Motors()


Start = Callable[..., RobotManager]


@pytest.fixture
def start(motors: Motors, memory: MemoryBridge) -> Iterator[Start]:
    made: list[RobotManager] = []

    def start(settings: str) -> RobotManager:
        text = ROBOT.format(left=3, settings=settings)
        bridges = {"motors": motors, "memory": memory}
        made.append(RobotManager(loads(text), registry=Registry(()), bridges=bridges))
        return made[-1]

    yield start
    for robot_manager in made:
        robot_manager.close()


def in_order(taken: list[tuple[str, Message]]) -> bool:
    """Say whether the left one stopped before the right one moved, and took nothing after that."""
    names = [name for name, _ in taken]
    first = names.index("right")
    return "left" not in names[first:] and taken[first - 1] == ("left", 0)


def test_a_provider_that_died_is_stopped_before_the_next_gets_what_the_application_sends(
    start: Start, motors: Motors
) -> None:
    robot = start(SETTINGS)
    drive = robot.request("drive")
    drive.send(1)
    motors.may_close.clear()
    motors.report(Health.LOST, "it was unplugged", component="left")
    wait(lambda: "right" in str(drive))
    drive.send(2)
    motors.may_close.set()
    assert in_order(motors.taken)
    assert motors.taken[-1] == ("right", 2)


def test_what_is_being_closed_is_stopped_too_before_the_next_gets_a_command(
    start: Start, motors: Motors, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uoarm.bridge._watchdog._LAST_SECONDS", patience())
    monkeypatch.setattr("uoarm._parts._component._STOP_SECONDS", patience())
    asked = threading.Event()
    hold_inputs = LiveComponent.hold_inputs

    def noting(live: LiveComponent) -> None:
        asked.set()
        hold_inputs(live)

    monkeypatch.setattr(LiveComponent, "hold_inputs", noting)
    robot = start(SETTINGS)
    drive = robot.request("drive")
    drive.send(1)
    motors.may_stop.clear()
    motors.report(Health.LOST, "it was unplugged", component="left")
    assert motors.stopping.wait(patience())
    wait(lambda: "right" in str(drive))
    sending = Background(lambda: drive.send(2))
    assert asked.wait(patience())
    motors.may_stop.set()
    sending.result()
    assert in_order(motors.taken)


def test_a_provider_that_a_configuration_replaces_is_stopped_before_the_next_is_fed(
    start: Start, motors: Motors, memory: MemoryBridge
) -> None:
    planner = memory.emitter("planner", {"type": "number"})
    robot = start(f"from: plan, meaning: stated, {SETTINGS}")
    robot.request("drive")
    over = threading.Event()

    def plan() -> None:
        while not over.wait(0.001):
            planner.emit(1)

    planning = threading.Thread(target=plan)
    planning.start()
    try:
        wait(lambda: ("left", 1) in motors.taken)
        changed = ROBOT.format(left=1, settings=f"from: plan, meaning: stated, {SETTINGS}")
        robot.apply(loads(changed), timeout=patience())
        wait(lambda: ("right", 1) in motors.taken)
    finally:
        over.set()
        planning.join(patience())
    assert in_order(motors.taken)


def finish_late(robot: RobotManager, monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """Have nothing end before the event is set."""
    gate = threading.Event()
    finish = robot._driver.live.finish

    def late(ending: Ending) -> None:
        gate.wait(patience())
        finish(ending)

    monkeypatch.setattr(robot._driver.live, "finish", late)
    return gate


def test_what_was_stopped_and_runs_out_takes_commands_again_when_it_is_wanted_again(
    start: Start, motors: Motors, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = start(SETTINGS)
    drive = robot.request("drive")
    drive.send(1)
    gate = finish_late(robot, monkeypatch)
    robot.apply(loads(ROBOT.format(left=1, settings=SETTINGS)), timeout=patience())
    drive.send(2)
    assert in_order(motors.taken)
    motors.report(Health.LOST, "it was unplugged", component="right")
    wait(lambda: len(drive.gaps) == 2)
    drive.send(3)
    gate.set()
    assert motors.taken[-1] == ("left", 3)
    assert motors.opened == ["left", "right"]  # none of them a second time beside the first


def test_what_came_in_its_place_stops_no_more_what_is_wanted_again(
    start: Start, motors: Motors, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The one that replaced it got no command yet when it is recalled, and gets one after that."""
    robot = start(SETTINGS)
    drive = robot.request("drive")
    drive.send(1)
    gate = finish_late(robot, monkeypatch)
    try:
        robot.apply(loads(ROBOT.format(left=1, settings=SETTINGS)), timeout=patience())
        (right,) = (
            item
            for item in robot._driver.live.components.values()
            if item.component.name == "right"
        )
        robot.apply(loads(ROBOT.format(left=3, settings=SETTINGS)), timeout=patience())
        drive.send(2)
        assert motors.opened == ["left", "right"]
        assert motors.taken[-1] == ("left", 2)
        right._stop_replaced()
        drive.send(3)
        assert motors.taken[-1] == ("left", 3)
    finally:
        gate.set()


def test_an_emergency_stop_that_comes_while_an_input_is_let_go_is_not_undone(
    start: Start, motors: Motors, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = start(SETTINGS)
    drive = robot.request("drive")
    drive.send(1)
    (left,) = robot._driver.live.components.values()
    left.hold_inputs()
    release = Sink.release

    def stop_first(sink: Sink) -> None:
        robot.stop_all()
        release(sink)

    monkeypatch.setattr(Sink, "release", stop_first)
    left.release_inputs()
    (status,) = (channel.command for channel in left.channel_statuses())
    assert status is not None
    assert status.held
