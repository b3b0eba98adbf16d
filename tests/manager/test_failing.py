"""Who raises is failing: counted, degraded and replaced, and no neighbour of it is."""

from __future__ import annotations

import logging
import traceback
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
from tests.manager import throwing
from tests.structures import closed

from uoarm import BridgeError, ConnectionClosedError, RobotManager
from uoarm.config import loads
from uoarm.model import ComponentStatus, ConnectionState, FailureLimits, Health, StatusEvent
from uoarm.testing import Collector, Emitter, ManualClock, MemoryBridge, patience, wait

ROBOT = """
version: 1
bridges: {memory: {}, python: {}}
functions:
  camera:
    components: [{name: camera, bridge: memory, output: {endpoint: [camera]}}]
  filter:
    components:
      - name: first
        bridge: python
        priority: 2
        input: {from: camera, endpoint: ["tests.manager.throwing:first"]}
        output: {endpoint: ["tests.manager.throwing:first"]}
SPARE
  answer:
    components:
      - name: best
        bridge: python
        priority: 2
        service: {endpoint: ["tests.manager.throwing:first"]}
      - {name: next, bridge: python, service: {endpoint: ["tests.manager.throwing:second"]}}
  show:
    components:
      - {name: show, bridge: python, input: {endpoint: ["tests.manager.throwing:first"]}}
"""
SPARE = """
      - name: second
        bridge: python
        input: {from: camera, endpoint: ["tests.manager.throwing:second"]}
        output: {endpoint: ["tests.manager.throwing:second"]}
"""
NARROW = closed(value={"type": "integer", "minimum": 0, "maximum": 255})


class Scene:
    """A camera before components that raise, and a clock that only the test moves."""

    def __init__(self, text: str = ROBOT) -> None:
        self.clock = ManualClock()
        self.bridge = MemoryBridge("memory", {})
        self.camera: Emitter = self.bridge.emitter("camera", NARROW)
        self.robot = RobotManager(loads(text), bridges={"memory": self.bridge}, clock=self.clock)
        self.events = Collector()
        self.robot.listen(self.events.deliver)

    def emit(self, messages: int, seconds: float) -> None:
        """Emit messages, each after the one before was dealt with, evenly over a time."""
        for number in range(messages):
            self.clock.advance(seconds / messages)
            before = self._dealt_with()
            self.camera.emit({"value": number})
            wait(partial(self._is_past, before))

    def emit_unread(self, messages: int, seconds: float) -> None:
        """Emit what cannot be read, which is dealt with as it is emitted."""
        for number in range(messages):
            self.clock.advance(seconds / messages)
            self.camera.emit({"value": number})

    def _is_past(self, before: object) -> bool:
        # A route counts what failed before its component is judged by it.
        status = self.robot.status()
        noted = {component.name: component.failed for component in status.components}
        return self._dealt_with() != before and all(
            noted.get(route.consumer.partition(".")[0], count) >= count
            for route in status.routes
            if (count := dict(route.dropped).get("failed", 0))
            and route.producer == "camera.default"
        )

    def _dealt_with(self) -> object:
        return [
            (route.producer, route.delivered, route.dropped)
            for route in self.robot.status().routes
            if route.producer == "camera.default"
        ]

    def component(self, name: str) -> ComponentStatus:
        [found] = [status for status in self.robot.status().components if status.name == name]
        return found

    def changes(self, subject: str) -> list[str]:
        reports: list[StatusEvent] = self.events.messages
        return [report.change for report in reports if report.subject == subject]


@pytest.fixture(autouse=True)
def _no_callback_raises() -> Iterator[None]:
    throwing.raises.clear()
    throwing.wrong.clear()
    yield
    throwing.raises.clear()
    throwing.wrong.clear()


@pytest.fixture
def scene(request: pytest.FixtureRequest) -> Iterator[Scene]:
    made = Scene(ROBOT.replace("SPARE", getattr(request, "param", SPARE)))
    with made.robot:
        yield made


alone = pytest.mark.parametrize("scene", [""], indirect=True)


def test_who_raises_is_degraded_at_once_with_the_exception_and_its_neighbours_are_not(
    scene: Scene,
) -> None:
    throwing.raises.add("first")
    with scene.robot.request("filter") as connection:
        scene.emit(1, 0.1)
        first, camera = scene.component("first"), scene.component("camera")
        assert (first.health, first.failed) == (Health.DEGRADED, 1)
        assert first.last_error == "OddError: first does not like 0"
        assert first.cause == "its input 'default' raised OddError: first does not like 0"
        assert (camera.health, camera.failed, camera.last_error) == (Health.OK, 0, "")
        with pytest.raises(TimeoutError) as caught:
            connection.get(0.001)
        text = "no message within 0.001 s; first is degraded: its input 'default' raised OddError"
        assert str(caught.value).startswith(text)
        scene.events.wait_for(lambda item: item.subject == "component first")
        assert connection.state is ConnectionState.RUNNING


def test_one_that_raises_on_everything_is_lost_and_the_next_candidate_takes_over(
    scene: Scene,
) -> None:
    throwing.raises.add("first")
    with scene.robot.request("filter") as connection:
        scene.emit(10, 0.6)
        scene.events.wait_for(lambda item: item.change == "replaced")
        scene.camera.emit({"value": 7})
        assert connection.get(patience()) == {"value": 7}
        assert "its input 'default' raises again and again" in connection.gaps[0].cause
        assert "OddError: first does not like 9" in connection.gaps[0].cause
        assert scene.changes("component first") == ["degraded", "lost"]
        assert scene.changes("component camera") == []
        again = scene.robot.request("filter")
        assert again.plan.provider.component.name == "second", "it is still avoided"


@alone
def test_without_another_candidate_the_connection_ends_and_says_who_raised_what(
    scene: Scene,
) -> None:
    throwing.raises.add("first")
    connection = scene.robot.request("filter")
    scene.emit(10, 0.6)
    with pytest.raises(ConnectionClosedError, match=r"component 'first' was lost.*OddError"):
        connection.get(patience())
    assert connection.state is ConnectionState.FAILED


def test_one_that_raises_now_and_then_is_kept_and_well_again_when_it_stops(scene: Scene) -> None:
    with scene.robot.request("filter") as connection:
        for _ in range(5):
            throwing.raises.add("first")
            scene.emit(9, 1.0)
            throwing.raises.clear()
            scene.emit(1, 0.1)
        assert scene.component("first").health is Health.DEGRADED
        scene.emit(12, 0.6)
        assert scene.component("first").health is Health.OK
        assert scene.component("first").failed == 45
        assert connection.gaps == ()
        scene.events.wait_for(lambda item: (item.subject, item.change) == ("component first", "ok"))
        assert scene.changes("component first") == ["degraded", "ok"]


def test_the_rule_is_read_from_the_file() -> None:
    text = ROBOT.replace("SPARE", SPARE)
    text += "failover: {failing: {share: 0.5, messages: 2, seconds: 0}}\n"
    assert loads(text).failover.failing == FailureLimits(0.5, 2, 0)
    scene = Scene(text)
    with scene.robot, scene.robot.request("filter"):
        throwing.raises.add("first")
        scene.emit(2, 0.1)
        scene.events.wait_for(lambda item: item.change == "replaced")


def test_what_the_application_sends_to_one_that_raises_degrades_it_too(scene: Scene) -> None:
    throwing.raises.add("first")
    with scene.robot.request("show") as connection:
        connection.send({"value": 3})
        wait(lambda: scene.component("show").health is Health.DEGRADED)
        assert scene.component("show").last_error == "OddError: first does not like 3"
        assert not connection.flush(patience())
        throwing.raises.clear()
        connection.send({"value": 4})
        assert connection.flush(patience()), "what failed was reported"


def test_a_service_that_raises_is_shown_and_then_another_one_is_called(scene: Scene) -> None:
    throwing.raises.add("first")
    for number in range(10):
        with pytest.raises(BridgeError, match="OddError"):
            scene.robot.call("answer", {"value": number}, timeout=patience())
        assert scene.component("best").failed == number + 1
        scene.clock.advance(0.06)
    assert scene.robot.call("answer", {"value": 1}, timeout=patience()) == {"value": 1}
    assert scene.component("best").health is Health.LOST
    lost = "component best", "lost", "answer"
    scene.events.wait_for(lambda item: (item.subject, item.change, item.function) == lost)
    throwing.raises.clear()
    scene.clock.advance(301)
    assert scene.robot.resolve("answer").provider.component.name == "best"
    scene.robot.call("answer", {"value": 1}, timeout=patience())
    assert scene.component("best").health is Health.OK


def test_a_callback_that_raises_is_reported_to_its_owner_and_ends_nothing(scene: Scene) -> None:
    def fail(message: object) -> None:
        raise OSError(f"no room for {message}")

    with scene.robot.request("filter", on_message=fail) as connection:
        scene.emit(20, 1.0)
        [route] = connection.routes()
        wait(lambda: dict(connection.routes()[0].dropped) == {"failed": 20})
        assert "fail raised OSError: no room for {'value':" in route.last_error
        scene.events.wait_for(lambda item: item.change == "degraded")
        assert scene.changes("connection c1").count("degraded") == 1
        assert connection.state is ConnectionState.RUNNING
        assert scene.component("first").health is Health.OK


@alone
def test_hundreds_of_exceptions_are_one_record(
    scene: Scene, caplog: pytest.LogCaptureFixture
) -> None:
    throwing.raises.add("first")
    with scene.robot.request("filter"), caplog.at_level(logging.INFO, "uoarm"):
        scene.emit(300, 0.4)
    records = [record for record in caplog.records if "OddError" in record.getMessage()]
    [first] = [record for record in records if record.name == "uoarm.component.first"]
    assert "its input 'default' raised OddError: first does not like 0" in first.getMessage()
    assert first.exc_info is not None
    assert frames(first.exc_info[1]) == ["first", "_step"], "and none of ours before them"


def frames(error: BaseException | None) -> list[str]:
    assert error is not None
    return [frame_summary.name for frame_summary in traceback.extract_tb(error.__traceback__)]


def test_the_exception_of_a_service_has_its_own_frames_and_is_logged_once(
    scene: Scene, caplog: pytest.LogCaptureFixture
) -> None:
    throwing.raises.add("first")
    with pytest.raises(BridgeError) as caught:
        scene.robot.call("answer", {"value": 1}, timeout=patience())
    assert frames(caught.value.__cause__) == ["first", "_step"]
    [record] = [item for item in caplog.records if item.exc_info]
    assert record.exc_info is not None
    assert record.exc_info[1] is caught.value.__cause__


def test_a_death_and_a_takeover_have_one_record_each(
    scene: Scene, caplog: pytest.LogCaptureFixture
) -> None:
    throwing.raises.add("first")
    with scene.robot.request("filter"):
        scene.emit(10, 0.6)
        scene.events.wait_for(lambda item: item.change == "replaced")
    reports = [(record.name, record.getMessage()) for record in caplog.records]
    [lost] = [text for name, text in reports if name == "uoarm.component.first" and " lost" in text]
    assert lost.startswith("component first lost: its input 'default' raises again and again")
    [taken] = [text for name, text in reports if name == "uoarm"]
    assert taken.startswith("connection c1 replaced: component 'first' was lost")


def test_the_first_message_that_is_dropped_has_a_record_and_the_others_are_counted(
    scene: Scene, caplog: pytest.LogCaptureFixture
) -> None:
    with scene.robot.request("camera") as connection:
        scene.emit(70, 1.0)  # 64 wait for the application
        dropped = dict(connection.routes()[0].dropped)
    assert dropped == {"queue-full": 6}
    assert [record.getMessage() for record in caplog.records if record.name == "uoarm"] == [
        "camera.default -> c1: a message was dropped: queue-full"
    ]


def test_what_a_channel_has_lost_and_knows_stands_in_the_status(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    with scene.robot.request("camera"):
        [channel] = scene.camera.channels()
        facts = {"lost_on_link": 3, "link_latency": 0.0123456, "peer": "camera 7"}
        monkeypatch.setattr(channel, "facts", lambda: facts)
        camera = scene.component("camera")
        assert (camera.lost, camera.channels[0].lost) == (3, 3)
        text = str(scene.robot.status())
        assert (
            "camera     output.default  lost_on_link 3, link_latency 0.0123, peer camera 7" in text
        )


def test_deaths_and_takeovers_are_counted_for_as_long_as_the_manager_lives(scene: Scene) -> None:
    throwing.raises.add("first")
    with scene.robot.request("filter"):
        scene.emit(10, 0.6)
        scene.events.wait_for(lambda item: item.change == "replaced")
    status = scene.robot.status()
    assert (status.deaths, status.takeovers) == ((("first", 1),), (("filter", 1),))
    lost = "component first", "lost", "filter"
    scene.events.wait_for(lambda item: (item.subject, item.change, item.function) == lost)
    replaced = "connection c1", "replaced", "filter"
    scene.events.wait_for(lambda item: (item.subject, item.change, item.function) == replaced)


def test_who_gives_what_its_structure_does_not_allow_is_degraded_and_then_lost(
    scene: Scene,
) -> None:
    with scene.robot.request("filter") as connection:
        wrong = {"value": 1000}
        scene.clock.advance(0.1)
        scene.camera.emit(wrong)
        wait(lambda: scene.component("camera").health is Health.DEGRADED)
        camera, first = scene.component("camera"), scene.component("first")
        expected = "its output 'default' gave what does not match its structure: camera.default: "
        assert camera.cause.startswith(expected + "value: expected at most 255, got 1000")
        assert (first.health, first.failed) == (Health.OK, 0), "its consumer is not to blame"
        for _ in range(9):
            scene.clock.advance(0.1)
            scene.camera.emit(wrong)
        wait(lambda: connection.ended)
        assert (
            "gives again and again what does not match its structure, 10 times" in connection.cause
        )


def test_who_gives_what_matches_again_is_well(scene: Scene) -> None:
    with scene.robot.request("filter"):
        scene.camera.emit({"value": 1000})
        wait(lambda: scene.component("camera").health is Health.DEGRADED)
        scene.emit(11, 1.0)
        wait(lambda: scene.component("camera").health is Health.OK)
        assert scene.component("camera").failed == 1


def test_a_step_that_takes_everything_and_gives_only_what_is_wrong_is_replaced(
    scene: Scene,
) -> None:
    throwing.wrong.add("first")
    with scene.robot.request("filter") as connection:
        scene.emit(10, 0.6)
        scene.events.wait_for(lambda item: item.change == "replaced")
        assert "its output 'default' gives again and again" in connection.gaps[0].cause
        assert scene.changes("component camera") == []
        throwing.wrong.clear()
        scene.camera.emit({"value": 7})
        assert connection.get(patience()) == {"value": 7}


def test_a_step_that_gives_what_is_wrong_now_and_then_is_kept(scene: Scene) -> None:
    with scene.robot.request("filter", validate="always") as connection:
        for _ in range(5):
            throwing.wrong.add("first")
            scene.emit(9, 1.0)
            throwing.wrong.clear()
            scene.emit(1, 0.1)
        assert scene.component("first").health is Health.DEGRADED
        scene.emit(12, 0.6)
        assert scene.component("first").health is Health.OK
        assert connection.gaps == ()


@pytest.mark.parametrize("validate", ["sampled", "off"])
def test_who_gives_what_is_wrong_is_blamed_for_what_its_consumer_raises_on_it(
    scene: Scene, validate: str
) -> None:
    with scene.robot.request("filter", validate=validate):
        scene.emit(1, 0.1)  # the one of 128 that is looked at
        throwing.raises.add("first")
        scene.clock.advance(0.1)
        scene.camera.emit({"value": 1000})
        wait(lambda: scene.component("camera").health is Health.DEGRADED)
        assert "its output 'default' gave what does not match" in scene.component("camera").cause
        assert (scene.component("first").health, scene.component("first").failed) == (Health.OK, 0)
        scene.emit(1, 0.1)
        wait(lambda: scene.component("first").failed == 1, "this one was right")


@alone
def test_who_gives_what_its_bridge_cannot_read_is_degraded_and_then_lost(scene: Scene) -> None:
    with scene.robot.request("filter") as connection, scene.camera.garbled():
        scene.emit_unread(1, 0.1)
        wait(lambda: scene.component("camera").health is Health.DEGRADED)
        camera, first = scene.component("camera"), scene.component("first")
        assert camera.cause.startswith("its output 'default' gave what cannot be read: ")
        assert dict(camera.channels[0].facts)["unreadable"] == camera.failed == 1
        [route] = [
            route_status
            for route_status in scene.robot.status().routes
            if route_status.consumer == "first.default"
        ]
        assert (route.received, dict(route.dropped)) == (1, {"unreadable": 1})
        assert (first.health, first.failed) == (Health.OK, 0), "its consumer is not to blame"
        scene.emit_unread(9, 0.6)
        wait(lambda: connection.ended)
        assert "gives again and again what cannot be read, 10 times" in connection.cause


def test_a_candidate_that_can_be_read_takes_over_from_one_that_cannot() -> None:
    spare = "{name: spare, bridge: memory, output: {endpoint: [spare]}}"
    text = ROBOT.replace("SPARE", "").replace(
        "output: {endpoint: [camera]}}]", f"output: {{endpoint: [camera]}}, priority: 2}}, {spare}]"
    )
    scene = Scene(text)
    spare_camera = scene.bridge.emitter("spare", NARROW)
    with scene.robot, scene.robot.request("camera") as connection:
        with scene.camera.garbled():
            scene.emit_unread(10, 0.6)
        scene.events.wait_for(lambda item: item.change == "replaced")
        spare_camera.emit({"value": 7})
        assert connection.get(patience()) == {"value": 7}
        assert "what cannot be read" in connection.gaps[0].cause


def test_who_can_be_read_now_and_then_is_kept_and_well_again_once_it_always_can(
    scene: Scene,
) -> None:
    with scene.robot.request("filter") as connection:
        for _ in range(5):
            with scene.camera.garbled():
                scene.emit_unread(9, 1.0)
            scene.emit(1, 0.1)
        assert scene.component("camera").health is Health.DEGRADED
        scene.emit(12, 0.6)
        wait(lambda: scene.component("camera").health is Health.OK)
        assert (scene.component("camera").failed, connection.gaps) == (45, ())
        well = "component camera", "ok"
        scene.events.wait_for(lambda item: (item.subject, item.change) == well)
        assert scene.changes("component camera") == ["degraded", "ok"]


HOSTED = """
version: 1
bridges:
  memory: {}
  far: {plugin: python, host: {}, options: {path: [FOLDER]}}
functions:
  camera:
    components: [{name: camera, bridge: memory, output: {endpoint: [camera]}}]
  filter:
    components:
      - name: strict
        bridge: far
        input: {from: camera, endpoint: ["tests.manager.throwing:strict"]}
        output: {endpoint: ["tests.manager.throwing:strict"]}
"""


@pytest.mark.parametrize("validate", ["sampled", "off"])
def test_who_gives_what_is_wrong_is_blamed_for_what_a_hosted_consumer_raises_on_it(
    validate: str,
) -> None:
    scene = Scene(HOSTED.replace("FOLDER", str(Path(__file__).parents[2])))
    with scene.robot, scene.robot.request("filter", validate=validate) as connection:
        scene.camera.emit({"value": 1})  # the one of 128 that is looked at
        assert connection.get(patience()) == {"value": 1}

        def is_camera_blamed() -> bool:
            scene.camera.emit({"value": 1000})
            return scene.component("camera").health is Health.DEGRADED

        wait(is_camera_blamed)
        assert "its output 'default' gave what does not match" in scene.component("camera").cause
        strict = scene.component("strict")
        assert (strict.health, strict.failed) == (Health.OK, 0)
        scene.camera.emit({"value": 13})
        wait(lambda: scene.component("strict").failed == 1, "this one was right")
        wait(lambda: "OddError: strict does not like 13" in scene.component("strict").cause)
