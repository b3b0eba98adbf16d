"""The client's bridge before a real rosbridge_suite of ROS 2 with rosapi, where one runs.

UOARM_ROSBRIDGE_SUITE is its address, and its ROS_DOMAIN_ID, with a space between; it must be on the
same machine, without limits of discovery.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from played import stream
from suites import HEIGHT, WIDTH, EitherSuite, at, is_there, made
from tests.server.talk import eventually  # type: ignore[import-not-found]

from uoarm.bridge import Bridge
from uoarm.errors import BridgeError
from uoarm.model import Endpoint, Message, Role
from uoarm.testing import Background, Collector, patience

ADDRESS, _, DOMAIN = os.environ.get("UOARM_ROSBRIDGE_SUITE", "").partition(" ")
pytestmark = pytest.mark.skipif(
    not DOMAIN or find_spec("rclpy") is None,
    reason="no rosbridge_suite: UOARM_ROSBRIDGE_SUITE='ws://HOST:PORT DOMAIN', and rclpy, are "
    "needed",
)


@pytest.fixture(scope="module", autouse=True)
def _node() -> Iterator[None]:
    script = str(Path(__file__).parent / "node_of_ros2.py")
    words, environment = [sys.executable, script], {**os.environ, "ROS_DOMAIN_ID": DOMAIN}
    with subprocess.Popen(words, stdout=subprocess.PIPE, env=environment) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        yield
        process.kill()


@pytest.fixture
def bridge() -> Iterator[Bridge]:
    bridge = made(ADDRESS)
    eventually(lambda: is_there(bridge, at(Role.OUTPUT, "/behind/scan")), "the node is there")
    yield bridge
    bridge.close()


class TestSuite(EitherSuite):
    set_bool = "std_srvs/srv/SetBool"
    parameter = "/behind:speed"


def schema_of(bridge: Bridge, endpoint: Endpoint) -> Any:
    return stream(bridge, endpoint).schema


def test_types_are_those_of_ros_2_and_stay_the_same(bridge: Bridge) -> None:
    schema = schema_of(bridge, at(Role.OUTPUT, "/behind/picture"))
    assert schema["x-type"] == "sensor_msgs/msg/Image"
    stamp = schema["properties"]["header"]["properties"]["stamp"]
    assert stamp["x-type"] == "builtin_interfaces/msg/Time"
    assert schema["properties"]["data"]["x-octets"] is True
    assert "x-constants" not in schema  # rosapi lists fields, and addresses of memory, as such


@pytest.mark.parametrize("compression", ["cbor", "cbor-raw", "none"])
def test_messages_come_with_their_types(compression: str) -> None:
    bridge = made(ADDRESS, compression=compression)
    pictures, scans = Collector(), Collector()
    for name, to in (("picture", pictures), ("scan", scans)):
        source = at(Role.OUTPUT, f"/behind/{name}")
        eventually(lambda source=source: is_there(bridge, source), "the node is there")
        bridge.open_source(source, stream(bridge, source), to.deliver)
    picture: Any = pictures.wait(1)[0]
    assert picture["data"] == bytes(index % 256 for index in range(WIDTH * HEIGHT))
    assert (picture["width"], picture["header"]["stamp"]) == (WIDTH, {"sec": 0, "nanosec": 0})
    scan: Any = scans.wait(1)[0]
    assert scan["ranges"].dtype == np.float32
    # JSON has no word for what is not finite: null, whichever it was
    last = [np.nan, np.nan] if compression == "none" else [np.inf, np.nan]
    assert np.array_equal(scan["ranges"], np.array([0.5, *last], np.float32), equal_nan=True)
    bridge.close()


def test_a_call_that_lasts_holds_up_no_message(bridge: Bridge) -> None:
    """rosbridge_suite waits for the reply before it reads what a client sends next."""
    asked = at(Role.INPUT, "/behind/asked")
    gate = Collector()

    def answer(request: Any) -> Message:
        gate.wait(1)
        return {"success": request["data"], "message": ""}

    offered = at(Role.SERVICE, "/ours/slow", "std_srvs/srv/SetBool", peer="optional")
    channel = bridge.serve(offered, answer)
    called = at(Role.SERVICE, "/ours/slow")
    eventually(lambda: is_there(bridge, called), "the service is there")
    calling = Background(lambda: bridge.call(called, {"data": True}))
    sink = bridge.open_sink(asked, stream(bridge, asked))  # asks rosapi, too
    sink.send({"data": "x"})
    assert sink.drain(patience())
    gate.deliver({})
    assert calling.result() == {"success": True, "message": ""}
    channel.close()


def test_an_action_is_a_call(bridge: Bridge) -> None:
    count = at(Role.SERVICE, "/behind/count", "test_msgs/action/Fibonacci")
    assert "declare `structure`" in bridge.describe(count).hint
    assert bridge.call(count, {"order": 4}) == {"sequence": [0, 1, 1, 2]}
    with pytest.raises(BridgeError, match="the goal was aborted"):
        bridge.call(count, {"order": -1})


def test_a_function_answers_goals(bridge: Bridge) -> None:
    offered = at(
        Role.SERVICE, "/ours/count", "test_msgs/action/Fibonacci", peer="optional", at_once=1
    )

    def count(message: Any) -> Message:
        if message["order"] < 0:
            raise ValueError("it cannot")
        return {"sequence": list(range(message["order"]))}

    channel = bridge.serve(offered, count)
    called = at(Role.SERVICE, "/ours/count", "test_msgs/action/Fibonacci")
    eventually(lambda: is_there(bridge, called), "the action is there")
    assert bridge.call(called, {"order": 4}) == {"sequence": [0, 1, 2, 3]}
    with pytest.raises(BridgeError, match="the goal was aborted"):
        bridge.call(called, {"order": -1})
    channel.close()


def test_every_node_is_discovered_with_structures(bridge: Bridge) -> None:
    found = {component.name: component for component in bridge.discover()}
    ports = {endpoint.address[0]: made for endpoint, made in found["/behind"].endpoints}
    assert ports["/behind/scan"].message is not None
    assert ports["/behind/set"].reply is not None


def test_what_is_not_there_is_named(bridge: Bridge) -> None:
    with pytest.raises(BridgeError, match="no node publishes it"):
        bridge.describe(at(Role.OUTPUT, "/nowhere"))
    with pytest.raises(BridgeError, match="no node subscribes to /cmd_vel"):
        bridge.describe(at(Role.INPUT, "/cmd_vel", "geometry_msgs/msg/Twist"))
    with pytest.raises(BridgeError, match="has the type std_msgs/msg/String"):
        bridge.describe(at(Role.OUTPUT, "/behind/echoed", "std_msgs/msg/Int8"))
