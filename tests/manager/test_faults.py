"""Every step of a bridge raises, hangs and lies: one error, nothing half-open, and life goes on."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Any

import pytest

from uoarm import RobotManager, UoarmError
from uoarm._parts import LiveEdge
from uoarm.bridge import Bridge
from uoarm.config import loads
from uoarm.errors import BridgeTimeoutError, ResolutionError
from uoarm.testing import (
    Background,
    MemoryBridge,
    hanging,
    lying,
    patience,
    raising,
    wait,
)

NUMBER: Any = {"type": "integer"}
ROBOT = """
version: 1
bridges: {left: {plugin: memory}, right: {plugin: memory}}
functions:
  camera:
    components: [{name: camera, bridge: left, output: {endpoint: [camera]}}]
  filter:
    components:
      - {name: filter, bridge: right, input: {from: camera, endpoint: [filter]},
         output: {endpoint: [filter]}}
"""
Fault = Callable[[Bridge, str], AbstractContextManager[Any]]
FAULTS: dict[str, Fault] = {
    "raises": lambda bridge, step: raising(bridge, step, OSError("unplugged")),
    "hangs": hanging,
    "lies": lambda bridge, step: lying(bridge, step, "nonsense"),
}


class Scene:
    """A chain over two bridges, with the same threads and descriptors at the end as before."""

    def __init__(self) -> None:
        self.left, self.right = MemoryBridge("left"), MemoryBridge("right")
        self.camera = self.left.emitter("camera", NUMBER)
        self.filter = self.right.loop("filter", NUMBER)
        bridges = {"left": self.left, "right": self.right}
        self.robot = RobotManager(loads(ROBOT), bridges=bridges)

    def is_empty(self) -> bool:
        status = self.robot.status()
        return not (
            self.left.open_channels
            or self.right.open_channels
            or status.routes
            or status.components
        )

    def works(self) -> None:
        with self.robot.request("filter", timeout=patience()) as connection:
            self.camera.emit(7)
            assert connection.get(patience()) == 7


@pytest.fixture
def scene() -> Iterator[Scene]:
    made = Scene()
    with made.robot:
        yield made


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("step", ["_describe", "_open_source", "_open_sink"])
def test_a_request_fails_whole_and_the_next_one_works(
    scene: Scene, fault: str, side: str, step: str
) -> None:
    bridge: Bridge = getattr(scene, side)
    used = step != "_open_sink" or side == "right"
    with FAULTS[fault](bridge, step):
        if not used:
            scene.works()
        else:
            limit = 0.2 if fault == "hangs" else patience()
            with pytest.raises(UoarmError) as caught:
                scene.robot.request("filter", timeout=limit)
            while side not in str(caught.value):  # the time was over before the one that hangs
                limit *= 2
                assert limit < patience(), str(caught.value)
                with pytest.raises(UoarmError) as caught:
                    scene.robot.request("filter", timeout=limit)
            expected = BridgeTimeoutError if fault == "hangs" else UoarmError
            assert isinstance(caught.value, expected)
            if step == "_describe" and fault != "hangs":
                assert isinstance(caught.value, ResolutionError)
    scene.works()
    if fault == "hangs":
        wait(scene.is_empty)  # what opened too late is closed by the thread that hung
    assert scene.is_empty()


@pytest.mark.parametrize("fault", ["raises", "hangs"])
@pytest.mark.parametrize("side", ["left", "right"])
def test_a_bridge_that_does_not_close_is_left_behind_in_time(
    scene: Scene, fault: str, side: str
) -> None:
    scene.works()
    with FAULTS[fault](getattr(scene, side), "_close"):
        Background(scene.robot.close).result(patience())
    assert scene.left.closed
    assert scene.right.closed


def test_a_channel_that_raises_in_close_does_not_keep_others_open(scene: Scene) -> None:
    connection = scene.robot.request("filter")
    (channel,) = scene.left._open
    with raising(channel, "_close", OSError("stuck")):
        connection.kill()
    assert scene.is_empty()
    scene.works()


def test_a_component_that_raises_is_counted_and_does_not_end_the_flow(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    take = scene.filter.take

    def fail_once(native: object) -> None:
        monkeypatch.setattr(scene.filter, "take", take)
        raise RuntimeError("no")

    monkeypatch.setattr(scene.filter, "take", fail_once)
    with scene.robot.request("filter") as connection:
        scene.camera.emit(1)
        scene.camera.emit(2)
        assert connection.get(patience()) == 2
        (route,) = [
            route_status
            for route_status in scene.robot.status().routes
            if route_status.consumer == "filter.default"
        ]
        assert dict(route.dropped) == {"failed": 1}
        assert route.last_error == "RuntimeError: no"


def test_a_callback_that_raises_is_counted_and_does_not_end_the_flow(scene: Scene) -> None:
    def fail(_: object) -> None:
        raise RuntimeError("the application is broken")

    with scene.robot.request("filter", on_message=fail) as connection:
        scene.camera.emit(1)
        scene.camera.emit(2)
        wait(lambda: sum(dict(connection.routes()[0].dropped).values()) == 2)
        (route,) = [
            route_status
            for route_status in scene.robot.status().routes
            if route_status.consumer.startswith("c")
        ]
        assert dict(route.dropped) == {"failed": 2}


TWO = f"""{ROBOT.rstrip()}
      - {{name: other, bridge: left, input: {{from: camera, endpoint: [other]}},
         output: {{endpoint: [other]}}}}
"""


def test_what_opens_just_as_it_is_given_up_for_another_plan_is_closed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    left, right, gate = MemoryBridge("left"), MemoryBridge("right"), threading.Event()
    left.emitter("camera", NUMBER)
    left.loop("other", NUMBER)
    right.loop("filter", NUMBER)
    renew_check = LiveEdge.renew_check

    def hang(edge: LiveEdge) -> None:
        if edge.consumer.component.name == "filter":
            gate.wait(patience())
        renew_check(edge)

    monkeypatch.setattr(LiveEdge, "renew_check", hang)
    limit = 0.5
    with RobotManager(loads(TWO), bridges={"left": left, "right": right}) as robot:
        while True:
            try:
                connection = robot.request("filter", timeout=limit)
            except BridgeTimeoutError:  # all of the time was over before the other was open
                assert limit < patience()
                limit *= 2
            else:
                break
        assert connection.plan.names[-1] == "other"
        gate.set()
        edges = robot._driver.live.edges
        wait(lambda: [edge.consumer.component.name for edge in edges.values()] == ["other"])
