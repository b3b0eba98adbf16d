"""A simulated robot through the whole bridge, over TCP and over a real tty."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import uoarm_rocos
from attrs import evolve
from lines import LIMIT
from rigs import Events, bridged, endpoint, served
from tests.no_threads import no_threads  # type: ignore[import-not-found]
from uoarm_rocos import _bridge
from uoarm_rocos._catalogue import DeviceCatalogue
from uoarm_rocos._device import Device
from uoarm_rocos._framing import LineError
from uoarm_rocos.simulate import LineFaults, SimulatedRobot

from uoarm import RobotManager
from uoarm.bridge import Bridge, Registry
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, MessageError
from uoarm.model import CommandPolicy, Health, MessageStructure, StopMessage
from uoarm.testing import ResourceSnapshot, slowness

ANY = MessageStructure(True)
ROBOT_XML = Path(uoarm_rocos.__file__).parent / "simulate" / "robot.xml"


@pytest.fixture(params=["tcp", "pty"])
def robot(request: pytest.FixtureRequest) -> Iterator[tuple[Bridge, Events]]:
    with served(SimulatedRobot(), request.param) as url, bridged(robot={"url": url}) as made:
        yield made


def test_a_device_for_which_there_is_no_thread_leaves_none() -> None:
    profile: dict[str, object] = {"url": "tcp://127.0.0.1:1"}
    for options in (profile, {**profile, "driver": "nonin-2"}):
        before = ResourceSnapshot()
        refused = pytest.raises(BridgeError, match="can't start new thread")
        with bridged(robot=options) as (bridge, _), no_threads("uoarm-robot"), refused:
            bridge.describe(endpoint("robot", "odometry"))
        before.check()


def test_describe_gives_structures_of_the_devices_own_catalogue(
    robot: tuple[Bridge, Events],
) -> None:
    bridge, _ = robot
    flow = bridge.describe(endpoint("robot", "odometry"))
    assert flow.message
    assert isinstance(flow.message.schema, dict)
    assert flow.message.schema["properties"]["x"] == {"type": "number", "x-unit": "m"}
    service = bridge.describe(endpoint("robot", "driveStraight", "service"))
    assert service.request
    assert service.reply
    assert service.request.native_type == "driveStraight.input"


def test_discover_lists_every_api(robot: tuple[Bridge, Events]) -> None:
    (found,) = robot[0].discover()
    assert (found.name, found.detail) == ("robot", "simulated robot")
    roles = {(item.address[1], item.role.value) for item, _ in found.endpoints}
    assert roles == {
        ("odometry", "output"), ("velocity", "input"),
        ("driveStraight", "service"), ("echo", "service"),
    }  # fmt: skip


def test_calls_are_correlated_while_many_are_under_way(robot: tuple[Bridge, Events]) -> None:
    bridge, _ = robot
    drive = endpoint("robot", "driveStraight", "service")
    echo = endpoint("robot", "echo", "service")
    with ThreadPoolExecutor(8) as pool:
        slow = pool.submit(bridge.call, drive, {"distance": 0.1, "speed": 0.5})
        texts = [f"text {n} \u00e4\u4e16" for n in range(40)]
        replies = list(pool.map(lambda text: bridge.call(echo, {"text": text}), texts))
        assert [reply["text"] for reply in replies] == texts
        assert slow.result(LIMIT) == {"outcome": "arrived", "driven": 0.1}


def test_flows_go_both_ways(robot: tuple[Bridge, Events]) -> None:
    bridge, _ = robot
    got = Events()
    source = bridge.open_source(endpoint("robot", "odometry"), ANY, got)
    sink = bridge.open_sink(endpoint("robot", "velocity", "input"), ANY)
    assert got.get() == {"x": 0.0, "y": 0.0, "heading": 0.0}
    sink.send({"linear": 0.5, "angular": 0})
    moved = got.until(lambda item: item["x"] > 0.01)
    assert moved["y"] == 0.0
    assert source.unreadable == 0
    assert sink.facts() == {"sent": 1}
    with pytest.raises(MessageError, match=r"input of velocity\.linear: expected -0\.5 to 0\.5"):
        sink.send({"linear": 2.0, "angular": 0})
    sink.close()
    source.close()
    with pytest.raises(BridgeError, match="closed"):
        sink.send({"linear": 0.1, "angular": 0})


def test_a_closed_flow_delivers_nothing_more(robot: tuple[Bridge, Events]) -> None:
    bridge, _ = robot
    got = Events()
    source = bridge.open_source(endpoint("robot", "odometry"), ANY, got)
    got.get()
    source.close()
    count = got.queue.qsize()
    bridge.call(endpoint("robot", "echo", "service"), {"text": "later than any data"})
    assert got.queue.qsize() <= count + 1  # one delivery may have been under way


def test_a_receiver_may_call_the_same_device_and_close_its_own_flow(
    robot: tuple[Bridge, Events],
) -> None:
    bridge, _ = robot
    echo, answers = endpoint("robot", "echo", "service"), Events()
    opened = threading.Event()

    def deliver(message: object) -> None:
        opened.wait(LIMIT)
        answers(bridge.call(echo, {"text": "from deliver"}, timeout=LIMIT))
        source.close()

    source = bridge.open_source(endpoint("robot", "odometry"), ANY, deliver)
    opened.set()
    assert answers.get() == {"text": "from deliver"}
    assert bridge.call(echo, {"text": "still there"}) == {"text": "still there"}


def test_a_late_call_is_given_up_and_the_device_is_notified() -> None:
    model = SimulatedRobot()
    with served(model) as url, bridged(robot={"url": url}) as (bridge, _):
        drive = endpoint("robot", "driveStraight", "service")
        bridge.describe(drive)  # the device is there
        with pytest.raises(BridgeTimeoutError):
            bridge.call(drive, {"distance": 5, "speed": 0.01}, timeout=slowness())
        echo = endpoint("robot", "echo", "service")
        assert bridge.call(echo, {"text": "alive"}) == {"text": "alive"}


@pytest.mark.parametrize(
    ("address", "role", "reason", "said"),
    [
        (("robot", "fly"), "output", FailureReason.NOT_FOUND, "it has odometry, velocity"),
        (("robot", "echo"), "output", FailureReason.BAD_ENDPOINT, "is a service"),
        (("robot", "odometry"), "service", FailureReason.BAD_ENDPOINT, "is a flow"),
        (("robot", "odometry"), "input", FailureReason.BAD_ENDPOINT, "has no input"),
        (("tobor", "odometry"), "output", FailureReason.NOT_FOUND, "its options name robot"),
    ],
)
def test_wrong_endpoints_are_refused_with_what_there_is(
    robot: tuple[Bridge, Events],
    address: tuple[str, str],
    role: str,
    reason: FailureReason,
    said: str,
) -> None:
    with pytest.raises(BridgeError, match=said) as raised:
        robot[0].describe(endpoint(*address, role))
    assert raised.value.reason is reason


def test_requests_that_do_not_fit_never_leave(robot: tuple[Bridge, Events]) -> None:
    with pytest.raises(MessageError, match=r"request to echo\.text: expected text"):
        robot[0].call(endpoint("robot", "echo", "service"), {"text": 3})


def test_a_device_that_is_not_there_is_unavailable_within_its_limit() -> None:
    with bridged(robot={"url": "tcp://127.0.0.1:1", "wait": 0.2}) as (bridge, _):
        with pytest.raises(BridgeError, match=r"not there after 0\.2 s: tcp://127") as raised:
            bridge.describe(endpoint("robot", "odometry"))
        assert raised.value.reason is FailureReason.UNAVAILABLE
        with pytest.raises(BridgeError, match="tcp://127"):
            bridge.discover()


def test_a_catalogue_from_a_file_is_used_without_asking() -> None:
    device = {"catalogue": str(ROBOT_XML)}
    with served(SimulatedRobot()) as url, bridged(robot={"url": url, **device}) as (bridge, _):
        echo = endpoint("robot", "echo", "service")
        assert bridge.call(echo, {"text": "file"}) == {"text": "file"}


def test_two_devices_of_one_bridge_keep_apart() -> None:
    with (
        served(SimulatedRobot(), "tcp") as one,
        served(SimulatedRobot(), "pty") as two,
        bridged(
            one={"url": one},
            wrong={"url": one, "catalogue": "/of/no/device.xml"},
            two={"url": two},
            away={"url": "tcp://127.0.0.1:1"},
        ) as (bridge, _),
    ):
        assert {found.name for found in bridge.discover()} == {"one", "two"}
        drive = {"distance": 0.05, "speed": 0.5}
        bridge.call(endpoint("one", "driveStraight", "service"), drive)
        places = []
        for name in ("one", "two"):
            got = Events()
            bridge.open_source(endpoint(name, "odometry"), ANY, got)
            places.append(got.get()["x"])
        assert places == [pytest.approx(0.05), 0.0]


def test_frames_lost_and_damaged_on_a_serial_line_are_counted_and_survived() -> None:
    faults = LineFaults(drop=0.1, garble=0.1, seed=7)
    with (
        served(SimulatedRobot(), "pty", faults) as url,
        bridged(robot={"url": url}) as (bridge, events),
    ):
        got = Events()
        opened = None
        while opened is None:  # the answer to `open` itself may be what is lost
            try:
                opened = bridge.open_source(
                    endpoint("robot", "odometry"), ANY, got, timeout=slowness()
                )
            except BridgeError:
                continue
        for _ in range(60):
            assert got.get().keys() == {"x", "y", "heading"}
        device = bridge._devices["robot"]  # type: ignore[attr-defined]  # no public way to count
        facts = device.facts()
        assert facts["damaged"] + facts["lost"] > 0
        assert Health.LOST not in {event.health for event in list(events.queue.queue)}


def test_the_manager_resolves_and_runs_a_flow(tmp_path: Path) -> None:
    with served(SimulatedRobot()) as url:
        file = tmp_path / "robot.yaml"
        file.write_text(
            f"""
version: 1
bridges:
  rocos: {{plugin: rocos, options: {{devices: {{robot: {{url: "{url}"}}}}}}}}
functions:
  odometry:
    components:
      - {{name: wheels, bridge: rocos, output: {{endpoint: [robot, odometry]}}}}
  echo:
    components:
      - {{name: echo, bridge: rocos, service: {{endpoint: [robot, echo]}}}}
"""
        )
        with RobotManager.from_file(file) as manager:
            with manager.request("odometry", validate="always") as connection:
                assert connection.get(LIMIT)["x"] == 0.0
            assert manager.call("echo", {"text": "hi"}) == {"text": "hi"}


@pytest.mark.parametrize("driver", ["profile", "and-ua767pbt", "contec-cms50dplus"])
def test_a_device_that_is_asked_to_stop_lets_go_of_its_line(driver: str) -> None:
    with bridged(it={"driver": driver, "url": "tcp://127.0.0.1:1"}) as (bridge, _):
        device = bridge._named("it")  # type: ignore[attr-defined]  # no public way to it
        device.stop()
        device._line._thread.join(LIMIT)
        assert not device._line._thread.is_alive()


def test_devices_end_together_and_not_one_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    stopped: list[Device] = []
    at_close: list[int] = []

    class Dark(Device):
        """Waited for when it is closed, as one that is being connected."""

        def catalogue(self, timeout: float) -> DeviceCatalogue:
            raise LineError("dark")

        def stop(self) -> None:
            stopped.append(self)

        def close(self) -> None:
            at_close.append(len(stopped))

    monkeypatch.setattr(_bridge, "make_device", lambda *_: Dark())
    names = ("one", "two", "three")
    devices: dict[str, dict[str, object]] = {name: {"url": "tcp://127.0.0.1:1"} for name in names}
    with bridged(**devices) as (bridge, _), pytest.raises(LineError):
        bridge.discover()
    assert at_close == [3, 3, 3]


class _Recording(SimulatedRobot):
    """A robot that records the commands that it receives."""

    def __init__(self) -> None:
        super().__init__()
        self.report = Events()

    def take(self, api: str, values: dict[str, Any], now: float) -> None:
        super().take(api, values, now)
        self.report(values["linear"])


@pytest.mark.parametrize("kind", ["tcp", "pty"])
def test_a_command_that_is_not_renewed_is_followed_by_the_stop(kind: str) -> None:
    model = _Recording()
    policy = CommandPolicy(0.1, StopMessage({"linear": 0, "angular": 0}))
    at = evolve(endpoint("robot", "velocity", "input"), command=policy)
    with served(model, kind) as url, bridged(robot={"url": url}) as (bridge, _):
        sink = bridge.open_sink(at, ANY)
        sink.send({"linear": 0.5, "angular": 0})
        assert [model.report.get(), model.report.get()] == [0.5, 0.0]
        status = sink.command_status()
        assert status is not None
        assert status.dropped == ()


def test_paths_begin_at_the_configuration() -> None:
    located = Registry().types["rocos"].located
    assert located(
        {
            "devices": {
                "a": {"catalogue": "a.xml", "url": "./tty"},
                "b": {"url": "tcp://b:1", "directory": "said"},
            }
        },
        "/robot",
    ) == {
        "devices": {
            "a": {"catalogue": "/robot/a.xml", "url": "/robot/tty"},
            "b": {"url": "tcp://b:1", "directory": "/robot/said"},
        }
    }
