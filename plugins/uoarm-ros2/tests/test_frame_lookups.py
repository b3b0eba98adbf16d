"""Look-ups between frames: a component with a service from /tf and /tf_static."""

from __future__ import annotations

import math
import queue
import threading
from typing import Any

import pytest
from endpoints import Make, endpoint, sink
from uoarm_ros2 import _transforms
from uoarm_ros2._options import TF_MESSAGE
from uoarm_ros2._transforms import TransformBuffer, TransformError
from uoarm_ros2._type_finder import tf_message
from uoarm_ros2._types import shape_of, type_hash

from uoarm.bridge import Bridge
from uoarm.errors import BridgeError, MessageError
from uoarm.model import Role
from uoarm.testing import patience, wait

MakeBridge = Make
FRAMES = endpoint(Role.SERVICE, "/tf", TF_MESSAGE, "lookup", peer="optional")


def transforms(*edges: tuple[str, str, int, float]) -> dict[str, Any]:
    """Return a message of frames that are so many metres ahead of their parents."""
    return {
        "transforms": [
            {
                "header": {"stamp": {"sec": sec, "nanosec": 0}, "frame_id": parent},
                "child_frame_id": child,
                "transform": {
                    "translation": {"x": ahead, "y": 0.0, "z": 0.0},
                    "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
                },
            }
            for parent, child, sec, ahead in edges
        ]
    }


def look_up(bridge: Bridge, target: str, source: str, **more: Any) -> Any:
    asked = {"target_frame": target, "source_frame": source, **more}
    return bridge.call(FRAMES, asked)


@pytest.fixture
def world(make_bridge: MakeBridge) -> tuple[Bridge, Any, Any]:
    """A bridge that looks up, and another's ends of /tf and /tf_static."""
    bridge, other = make_bridge("asking"), make_bridge("publishing")
    latched = {"durability": "transient_local"}
    static = sink(
        other, endpoint(Role.INPUT, "/tf_static", TF_MESSAGE, peer="optional", qos=latched, wait=0)
    )
    moving = sink(other, endpoint(Role.INPUT, "/tf", TF_MESSAGE, peer="optional", wait=0))
    static.send(transforms(("base", "camera", 0, 0.5)))
    return bridge, static, moving


def test_the_definition_of_the_message_is_that_of_tf2_msgs() -> None:
    text = "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"
    assert type_hash(shape_of(tf_message(), TF_MESSAGE)) == text
    assert tf_message() is tf_message()  # what a class is made of is never given back


def test_a_frame_is_looked_up_in_another(world: tuple[Bridge, Any, Any]) -> None:
    bridge, _, moving = world
    wait(lambda: not raises(bridge, "base", "camera"))  # now both topics are subscribed to
    wait(lambda: moving.facts()["matched"] == 1)
    moving.send(transforms(("map", "base", 10, 1.0), ("map", "base", 12, 3.0)))
    wait(lambda: not raises(bridge, "map", "camera"))
    found = look_up(bridge, "map", "camera")
    assert found["header"] == {"stamp": {"sec": 12, "nanosec": 0}, "frame_id": "map"}
    assert found["child_frame_id"] == "camera"
    assert found["transform"]["translation"] == {"x": 3.5, "y": 0.0, "z": 0.0}
    between = look_up(bridge, "map", "camera", time={"sec": 11, "nanosec": 0})
    assert between["transform"]["translation"]["x"] == pytest.approx(2.5)
    with pytest.raises(BridgeError, match=r"'base' in 'map' is known from 10\.000 s to 12\.000 s"):
        look_up(bridge, "map", "camera", time={"sec": 13, "nanosec": 0}, timeout=0)
    with pytest.raises(BridgeError, match="frame 'nose' is not known; known are base, camera, map"):
        look_up(bridge, "map", "nose", timeout=0)
    report = bridge.describe(FRAMES)
    assert report.request is not None
    assert report.reply is not None
    assert report.reply.native_type == "geometry_msgs/msg/TransformStamped"


def test_a_clock_that_goes_back_leaves_nothing_of_the_run_before(make_bridge: MakeBridge) -> None:
    """A step of a few seconds, too, within which frames of then would be the latest ones."""
    bridge, other = make_bridge("asking", use_sim_time=True), make_bridge("playing")
    moving = sink(other, endpoint(Role.INPUT, "/tf", TF_MESSAGE, peer="optional", wait=0))
    clock = sink(other, endpoint(Role.INPUT, "/clock", "rosgraph_msgs/msg/Clock"))

    def latest() -> int:
        try:
            return int(look_up(bridge, "map", "base", timeout=0)["header"]["stamp"]["sec"])
        except BridgeError:
            return 0

    wait(lambda: not latest() and moving.facts()["matched"] == 1)
    clock.send({"clock": {"sec": 20, "nanosec": 0}})
    moving.send(transforms(("map", "base", 20, 1.0)))
    wait(lambda: latest() == 20)

    def begins_again() -> bool:
        clock.send({"clock": {"sec": 17, "nanosec": 0}})
        moving.send(transforms(("map", "base", 17, 2.0)))
        return latest() == 17

    wait(begins_again, "frames of the run before are the latest")


def test_a_look_up_that_waits_goes_on_with_the_first_frame_that_answers_it(
    world: tuple[Bridge, Any, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It may wait for longer than the test does: only a message can wake it."""
    bridge, _, moving = world
    wait(lambda: not raises(bridge, "base", "camera"))  # now both topics are subscribed to
    wait(lambda: moving.facts()["matched"] == 1)
    monkeypatch.setattr(_transforms, "_MOST_SECONDS", math.inf)
    looks, answers = list[str](), queue.SimpleQueue[Any]()
    look = TransformBuffer.lookup

    def noted(buffer: TransformBuffer, *asked: Any) -> Any:
        try:
            return look(buffer, *asked)
        except TransformError as error:
            looks.append(
                str(error)
            )  # under the lock that a waiting look-up gives back, and a message takes
            raise

    monkeypatch.setattr(TransformBuffer, "lookup", noted)
    longest = 8 * patience()
    asked = {"target_frame": "map", "source_frame": "camera", "timeout": longest}
    asking = threading.Thread(
        target=lambda: answers.put(bridge.call(FRAMES, asked, timeout=longest)), daemon=True
    )
    asking.start()
    wait(lambda: len(looks) == 1)
    moving.send(transforms(("map", "door", 10, 1.0)))
    wait(lambda: len(looks) == 2)  # it looked again, and waits again
    assert answers.empty()
    moving.send(transforms(("map", "base", 10, 1.0)))
    assert answers.get(timeout=patience())["transform"]["translation"]["x"] == 1.5
    assert len(looks) == 2
    asking.join(patience())


def raises(bridge: Bridge, target: str, source: str) -> bool:
    try:
        look_up(bridge, target, source)
    except BridgeError:
        return True
    return False


def test_a_broadcaster_that_does_not_latch_is_named(make_bridge: MakeBridge) -> None:
    bridge, other = make_bridge("asking"), make_bridge("publishing")
    volatile = {"durability": "volatile"}
    sink(
        other, endpoint(Role.INPUT, "/tf_static", TF_MESSAGE, peer="optional", qos=volatile, wait=0)
    )

    def refusal() -> str:
        with pytest.raises(BridgeError) as raised:
            look_up(bridge, "map", "base", timeout=0)
        return str(raised.value)

    assert "frame 'map' is not known; none is" in refusal()
    wait(lambda: "publishing is not received on /tf_static: durability (offered" in refusal())


def test_a_topic_without_look_ups_is_unsubscribed(
    world: tuple[Bridge, Any, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    bridge, _, moving = world
    raises(bridge, "base", "camera")
    wait(lambda: moving.facts()["matched"] == 1)
    monkeypatch.setattr(_transforms, "_IDLE_SECONDS", 0.0)
    wait(lambda: moving.facts()["matched"] == 0)


def test_without_a_publisher_there_are_no_look_ups(bridge: Bridge) -> None:
    needed = endpoint(Role.SERVICE, "/tf", TF_MESSAGE, "lookup", wait=0)
    with pytest.raises(BridgeError, match="no publisher of /tf or /tf_static on the graph"):
        bridge.describe(needed)


@pytest.mark.parametrize(
    ("request_", "text"),
    [
        ({"target_frame": "map"}, "target_frame and source_frame must be names"),
        ({"target_frame": "a", "source_frame": "b", "at": 1}, "has no field 'at'"),
        ({"target_frame": "a", "source_frame": "b", "time": 1}, "time must be {sec, nanosec}"),
        ({"target_frame": "a", "source_frame": "b", "timeout": 61}, "timeout must be 0 to 60 s"),
    ],
)
def test_what_is_no_look_up_is_refused(bridge: Bridge, request_: Any, text: str) -> None:
    with pytest.raises((MessageError, BridgeError), match=text):
        bridge.call(FRAMES, request_)


@pytest.mark.parametrize(
    "at",
    [
        endpoint(Role.OUTPUT, "/tf", TF_MESSAGE, "lookup"),
        endpoint(Role.INPUT, "/tf", TF_MESSAGE, "lookup"),
    ],
)
def test_looking_up_is_a_service_only(bridge: Bridge, at: Any) -> None:
    with pytest.raises(BridgeError, match="is a service that is called, and nothing else"):
        bridge.describe(at)
