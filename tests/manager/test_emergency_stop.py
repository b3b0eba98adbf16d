"""The emergency stop reaches every input that moves something, and says truly who stopped."""

from __future__ import annotations

import asyncio
import re
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from uoarm import AsyncRobotManager, RobotManager
from uoarm._safety import EmergencyStop
from uoarm.bridge import Channel, Description, Registry, Sink
from uoarm.config import loads
from uoarm.errors import BridgeError, CommandRefusedError
from uoarm.model import (
    CommandPolicy,
    Endpoint,
    Message,
    MessageStructure,
    Role,
    StopMessage,
    to_json,
)
from uoarm.testing import Background, MemoryBridge, patience, wait

ROBOT = """
version: 1
bridges: {motors: {plugin: python}}
functions:
  left:
    components:
      - name: left
        bridge: motors
        input:
          endpoint: [left]
          lifetime: 3600
          stop: {message: 0}
          limits: {".": {minimum: 0, maximum: 8}}
  right:
    components: [{name: right, bridge: motors, input: {endpoint: [right], stop: {message: 0}}}]
  lamp:
    components: [{name: lamp, bridge: motors, input: {endpoint: [lamp]}}]
"""


class Motors(MemoryBridge):
    """Motors that take numbers; one in `broken` takes none, one in `hanging` does not return."""

    def __init__(self) -> None:
        super().__init__("motors")
        self.taken: dict[str, list[Message]] = {}
        self.broken: set[str] = set()
        self.hanging: set[str] = set()
        self.hangs = threading.Event()
        self.go_on = threading.Event()
        self.opening = threading.Event()
        self.opening.set()
        self.is_opening = threading.Event()

    def _describe(self, endpoint: Endpoint) -> Description:
        return Description(MessageStructure({"type": "number"}))

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        name = endpoint.component

        def send(message: Message) -> None:
            if name in self.hanging:
                self.hangs.set()
                self.go_on.wait(patience())
            if name in self.broken:
                raise OSError("no power")
            self.taken.setdefault(name, []).append(message)

        self.is_opening.set()
        assert self.opening.wait(patience())
        return Sink(endpoint, send, lambda: None, blocking=False)

    def _close(self) -> None:
        self.go_on.set()


@pytest.fixture
def motors() -> Motors:
    return Motors()


@pytest.fixture
def robot(motors: Motors) -> Iterator[RobotManager]:
    with RobotManager(loads(ROBOT), registry=Registry(()), bridges={"motors": motors}) as robot:
        yield robot


def test_everything_that_moves_stops_and_stays_so_until_it_is_released(
    robot: RobotManager, motors: Motors
) -> None:
    left, right, lamp = (robot.request(name) for name in ("left", "right", "lamp"))
    left.send(5)
    report = robot.stop_all(timeout=patience())
    assert report.stopped
    assert [(input_.component, input_.stopped) for input_ in report.inputs] == [
        ("left", True),
        ("right", True),
    ]
    assert motors.taken == {"left": [5, 0], "right": [0]}, "also what stood still"
    assert robot.is_stopped
    for connection in (left, right):
        with pytest.raises(CommandRefusedError, match="until the emergency stop is released"):
            connection.send(7)
    lamp.send(7)
    assert motors.taken == {"left": [5, 0], "right": [0], "lamp": [7]}, "a lamp moves nothing"
    robot.release()
    left.send(8)
    assert motors.taken["left"] == [5, 0, 8]


def test_the_status_shows_what_moves_and_for_how_long(robot: RobotManager) -> None:
    left = robot.request("left")
    robot.request("lamp")
    assert "commands: 1" in str(robot.status())
    assert robot.status().held is None
    left.send(5)
    left.send(9)
    limits = r"\. at least 0, at most 8"
    row = re.compile(rf"left\.default +moving .* 3[0-5]\d\d\.\d+ s +3600\.000 s +{limits}")
    wait(lambda: row.search(str(robot.status())))  # in its first half millisecond it is 3600.000
    assert "beyond-limits 1" in str(robot.status())
    robot.stop_all(timeout=patience())
    text = str(robot.status())
    assert text.startswith("commands have been refused for ")
    assert re.search(r"left\.default +stopped", text), text
    report = to_json(robot.status())
    assert report["held"] >= 0
    channel = next(component for component in report["components"] if component["name"] == "left")[
        "channels"
    ][0]
    assert channel["command"]["phase"] == "stopped"
    assert channel["limits"] == [{"path": ".", "minimum": 0.0, "maximum": 8.0, "rate": None}]


def test_who_does_not_stop_is_named_with_the_cause_and_keeps_no_other_waiting(
    robot: RobotManager, motors: Motors
) -> None:
    left = robot.request("left")
    robot.request("right")
    motors.broken.add("right")
    motors.hanging.add("left")
    sending = Background(lambda: left.send(5))
    assert motors.hangs.wait(patience())
    report = robot.stop_all(timeout=0.2)
    assert not report.stopped
    assert [input_.stopped for input_ in report.inputs] == [False, False]
    assert "NOT STOPPED" in str(report)
    wait(lambda: "no power" in robot.stop_all(timeout=0.05).inputs[1].cause)
    motors.hanging.clear()
    motors.broken.clear()
    motors.go_on.set()
    sending.result()
    wait(lambda: robot.stop_all(timeout=patience()).stopped)
    assert motors.taken["left"][-1] == motors.taken["right"][-1] == 0


def test_what_is_being_opened_meanwhile_is_held_as_it_opens(
    robot: RobotManager, motors: Motors
) -> None:
    motors.opening.clear()
    requesting = Background(lambda: robot.request("left"))
    assert motors.is_opening.wait(patience())
    assert robot.stop_all().inputs == ()
    motors.opening.set()
    with pytest.raises(CommandRefusedError):
        requesting.result().send(5)
    assert motors.taken == {"left": [0]}
    (one,) = robot.stop_all(timeout=patience()).inputs
    assert one.stopped


def test_a_command_is_refused_by_the_last_hop_too(robot: RobotManager) -> None:
    robot.request("left")
    robot.stop_all(timeout=patience())
    (sink,) = robot._driver.live.emergency_stop._sinks
    with pytest.raises(CommandRefusedError) as caught:
        sink.send(5)
    assert caught.value.reason == "held"


def test_the_twin_for_event_loops_stops_and_releases(robot: RobotManager, motors: Motors) -> None:
    async def run() -> None:
        asynchronous = AsyncRobotManager(robot)
        await asynchronous.request("left")
        report = await asynchronous.stop_all(timeout=patience())
        assert report.stopped
        await asynchronous.release()
        assert not asynchronous.is_stopped

    asyncio.run(run())
    assert motors.taken == {"left": [0]}


async def test_a_stop_waits_for_no_thread_of_the_application(
    robot: RobotManager, motors: Motors
) -> None:
    asynchronous, gate = AsyncRobotManager(robot), threading.Event()
    await asynchronous.request("left")
    with ThreadPoolExecutor(1) as executor:
        asyncio.get_running_loop().set_default_executor(executor)
        working = asyncio.ensure_future(asyncio.to_thread(gate.wait, patience()))
        report = await asyncio.wait_for(asynchronous.stop_all(timeout=patience()), patience())
        gate.set()
        await working
    assert report.stopped
    await asynchronous.release()
    assert motors.taken == {"left": [0]}


async def test_the_twin_for_event_loops_stops_where_the_system_gives_no_thread(
    robot: RobotManager, motors: Motors, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    asynchronous = AsyncRobotManager(robot)
    connection = await asynchronous.request("left")
    await connection.send(5)
    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", refuse)
        assert (await asynchronous.stop_all(timeout=patience())).stopped
    assert motors.taken == {"left": [5, 0]}


@pytest.mark.parametrize("count", [10, 100, 1000])
def test_what_opens_costs_no_look_at_all_that_is_open(
    monkeypatch: pytest.MonkeyPatch, count: int
) -> None:
    stop, looks = EmergencyStop(lambda: 0.0), list[Sink]()
    policy = CommandPolicy(1.0, StopMessage(0))
    endpoint = Endpoint("motors", "left", Role.INPUT, ("left",), command=policy)
    sinks = [Sink(endpoint, lambda _: None, lambda: None) for _ in range(count)]
    closed = vars(Channel)["closed"].fget

    def look(sink: Sink) -> bool:
        looks.append(sink)
        return bool(closed(sink))

    monkeypatch.setattr(Sink, "closed", property(look))
    for sink in sinks:
        stop.enter(sink, "left")
    assert len(looks) <= 4 * count
    assert len(stop.stop(patience()).inputs) == count
    for sink in sinks[1:]:
        sink.close()
    assert len(stop.stop(patience()).inputs) == 1
    for _ in range(count + 1):
        stop.enter(sinks[0], "left")
        stop.enter(Sink(endpoint, lambda _: None, lambda: None), "left")
    assert not set(sinks[1:]) & set(vars(stop)["_sinks"])


class TestStopFile:
    """Of a manager that is made again."""

    def made(self, motors: Motors, file: Path) -> RobotManager:
        given = {"motors": motors}
        return RobotManager(loads(ROBOT), registry=Registry(()), bridges=given, stop_file=file)

    def test_what_opens_after_a_restart_is_held(self, tmp_path: Path) -> None:
        file = tmp_path / "folder" / "stopped"
        with self.made(Motors(), file) as robot:
            assert not robot.is_stopped
            robot.stop_all(timeout=patience())
            assert file.exists()
        motors = Motors()
        with self.made(motors, file) as robot:
            assert robot.is_stopped
            left = robot.request("left")
            assert motors.taken == {"left": [0]}
            with pytest.raises(CommandRefusedError):
                left.send(5)
            robot.release()
            left.send(5)
            assert not file.exists()
        with self.made(Motors(), file) as robot:
            assert not robot.is_stopped

    def test_where_it_cannot_be_written_the_stop_goes_on_and_says_so(self, tmp_path: Path) -> None:
        (tmp_path / "folder").write_text("a file", encoding="utf-8")
        motors = Motors()
        with self.made(motors, tmp_path / "folder" / "stopped") as robot:
            robot.request("left")
            report = robot.stop_all(timeout=patience())
            assert motors.taken == {"left": [0]}
            assert "NOT STOPPED AFTER A RESTART" in str(report)
            assert "cannot be written" in report.unkept

    def test_where_it_cannot_be_removed_nothing_is_released(self, tmp_path: Path) -> None:
        file = tmp_path / "stopped"
        (file / "full").mkdir(parents=True)
        with self.made(Motors(), file) as robot:
            with pytest.raises(BridgeError, match="nothing was released"):
                robot.release()
            assert robot.is_stopped
