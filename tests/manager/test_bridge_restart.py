"""A bridge that is lost holds up no other as it ends, and the one that follows it is well."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import pytest

from uoarm import RobotManager
from uoarm.bridge import BridgeType, HealthEvent, Registry
from uoarm.config import loads
from uoarm.model import Health, StatusEvent
from uoarm.testing import Collector, MemoryBridge, hanging, patience, slowness, wait

NUMBER: Any = {"type": "integer"}
ROBOT = """
version: 1
bridges: {one: {plugin: memory}, two: {plugin: memory}}
functions:
  camera:
    components: [{name: camera, bridge: one, output: {endpoint: [camera]}}]
  lamp:
    components: [{name: lamp, bridge: two, output: {endpoint: [lamp]}}]
"""


class Scene:
    """A robot that makes its bridges itself, each with an emitter, and what it reported."""

    def __init__(self) -> None:
        self.made: dict[str, list[MemoryBridge]] = {"one": [], "two": []}
        registry = Registry([])
        registry.add(BridgeType("memory", "for tests", self._make, contract=2))
        self.robot = RobotManager(loads(ROBOT), registry=registry)
        self.events: list[StatusEvent] = []
        self.robot.listen(self.events.append)

    def changes(self, subject: str) -> list[str]:
        return [event.change for event in self.events if event.subject == subject]

    def _make(self, name: str, options: Any) -> MemoryBridge:
        bridge = MemoryBridge(name, options)
        bridge.emitter({"one": "camera", "two": "lamp"}[name], NUMBER)
        self.made[name].append(bridge)
        return bridge


@pytest.fixture
def scene() -> Iterator[Scene]:
    made = Scene()
    with made.robot:
        yield made


def _lose(scene: Scene, bridge: MemoryBridge) -> None:
    bridge.report(Health.LOST, "its process ended")
    wait(lambda: "lost" in scene.changes(f"bridge {bridge.name}"))


def test_one_that_is_started_again_is_said_to_be_ok(scene: Scene) -> None:
    scene.robot.resolve("camera")
    assert scene.changes("bridge one") == []  # the first start is no news
    _lose(scene, scene.made["one"][0])
    scene.robot.resolve("camera")
    wait(lambda: scene.changes("bridge one") == ["lost", "ok"])
    (status,) = [bridge for bridge in scene.robot.status().bridges if bridge.name == "one"]
    assert (status.health, status.cause) == (Health.OK, "")


def test_one_that_was_lost_before_it_was_watched_is_not_kept(scene: Scene) -> None:
    make = scene._make

    def lose(name: str, options: Any) -> MemoryBridge:
        bridge = make(name, options)
        if len(scene.made[name]) == 1:
            bridge.report(Health.LOST, "its reader ended")
        return bridge

    scene.robot.registry.add(BridgeType("brief", "for tests", lose, contract=2))
    scene.robot.apply(loads(ROBOT.replace("one: {plugin: memory}", "one: {plugin: brief}")))
    scene.robot.resolve("camera")
    wait(lambda: "lost" in scene.changes("bridge one"))
    scene.robot.request("camera").kill()
    assert len(scene.made["one"]) == 2
    wait(lambda: scene.made["one"][0].closed)


def test_what_a_lost_one_still_reports_is_not_about_the_next(scene: Scene) -> None:
    scene.robot.resolve("camera")
    scene.robot.resolve("lamp")
    (lost,) = scene.made["one"]
    slow = Collector()
    scene.robot.listen(slow.deliver)
    with slow.held():  # so that no thread has come to close what is lost
        scene.made["two"][0].report(Health.DEGRADED, "hot")
        slow.wait_begun(1)
        lost.report(Health.LOST, "its process ended")
        scene.robot.resolve("camera")
        connection = scene.robot.request("camera")
        lost.report(Health.LOST, "it fell once more")
        lost.report(Health.LOST, "and again", component="camera")
        assert scene.robot.request("camera").plan == connection.plan
        assert len(scene.made["one"]) == 2
    wait(lambda: "ok" in scene.changes("bridge one"))
    assert scene.changes("bridge one").count("lost") == 1
    assert "component camera" not in {event.subject for event in scene.events}
    assert connection.gaps == ()
    assert not connection.ended


def test_what_was_on_its_way_as_one_was_lost_is_not_about_the_next(scene: Scene) -> None:
    scene.robot.resolve("camera")
    (lost,) = scene.made["one"]
    report = lost._listener  # a thread that has read it, and goes on when all is over
    assert report is not None
    _lose(scene, lost)
    connection = scene.robot.request("camera")
    report(HealthEvent("one", Health.LOST, "it fell once more"))
    report(HealthEvent("one", Health.LOST, "and again", component="camera"))
    assert scene.robot.request("camera").plan == connection.plan
    assert len(scene.made["one"]) == 2
    assert not connection.ended


def test_a_loss_that_is_posted_late_comes_before_what_the_next_one_says(scene: Scene) -> None:
    make, bridges = scene._make, vars(scene.robot)["_bridges"]

    def hot(name: str, options: Any) -> MemoryBridge:
        bridge = make(name, options)
        if len(scene.made[name]) == 2:
            bridge.report(Health.DEGRADED, "hot")
        return bridge

    scene.robot.registry.add(BridgeType("hot", "for tests", hot, contract=2))
    scene.robot.apply(loads(ROBOT.replace("one: {plugin: memory}", "one: {plugin: hot}")))
    scene.robot.resolve("camera")
    take = bridges._listener
    following = threading.Thread(target=bridges.get, args=("one",))

    def take_late(event: HealthEvent) -> Any:
        if event.health is Health.LOST:  # which is listed as dead by now
            following.start()
            following.join(0.5 * slowness())  # it is the next one by then, unless it has to wait
        return take(event)

    bridges._listener = take_late
    scene.made["one"][0].report(Health.LOST, "its process ended")
    following.join()
    wait(lambda: len(scene.changes("bridge one")) == 3, lambda: str(scene.events))
    assert scene.changes("bridge one") == ["lost", "ok", "degraded"]


def test_events_do_not_wait_for_one_that_hangs_as_it_ends(
    scene: Scene, caplog: pytest.LogCaptureFixture
) -> None:
    scene.robot.resolve("camera")
    scene.robot.resolve("lamp")
    (lost,) = scene.made["one"]
    with hanging(lost, "_close") as hang:
        _lose(scene, lost)
        assert hang.entered.wait(patience())
        scene.made["two"][0].report(Health.DEGRADED, "hot")
        wait(lambda: scene.changes("bridge two"))
        assert "given up" not in caplog.text  # nor was its close


def test_closing_the_manager_closes_what_was_lost(scene: Scene) -> None:
    scene.robot.request("camera")
    (lost,) = scene.made["one"]
    with hanging(lost, "_close") as hang:
        _lose(scene, lost)
        assert hang.entered.wait(patience())
        hang.release()
        scene.robot.close()
    assert lost.closed
    assert lost.open_channels == 0
