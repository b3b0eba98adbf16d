"""The client's bridge before a real rosbridge_suite of ROS 1 with rosapi, where one runs.

UOARM_ROSBRIDGE_SUITE_ROS1 is its address, and that of its master, with a space between.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from played import stream
from suites import HEIGHT, WIDTH, EitherSuite, at, made
from tests.server.talk import eventually  # type: ignore[import-not-found]

from uoarm.bridge import Bridge, HealthEvent
from uoarm.errors import BridgeError, BridgeTimeoutError
from uoarm.model import Role
from uoarm.testing import Background, Collector

ADDRESS, _, MASTER = os.environ.get("UOARM_ROSBRIDGE_SUITE_ROS1", "").partition(" ")
ROS_PYTHON = "/usr/bin/python3"  # what Debian installs belongs to it alone
pytestmark = pytest.mark.skipif(
    not MASTER,
    reason="no rosbridge_suite of ROS 1: UOARM_ROSBRIDGE_SUITE_ROS1='ws://HOST:PORT "
    "http://MASTER:PORT' is needed",
)
ADD = ("/behind/add", "actionlib/TwoIntsAction")
HOLD = ("/behind/hold", "actionlib/TwoIntsAction")


@pytest.fixture(scope="module", autouse=True)
def _node(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    home = str(tmp_path_factory.mktemp("ros"))
    environment = {
        "PATH": os.environ.get("PATH", ""), "ROS_MASTER_URI": MASTER, "ROS_IP": "127.0.0.1",
        "ROS_HOME": home, "HOME": home,
    }  # fmt: skip
    script = str(Path(__file__).parent / "debian" / "node_of_ros1.py")
    words = [ROS_PYTHON, script]
    with subprocess.Popen(words, stdout=subprocess.PIPE, env=environment) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        yield
        process.kill()


@pytest.fixture
def bridge() -> Iterator[Bridge]:
    bridge = made(ADDRESS)
    yield bridge
    bridge.close()


class TestSuite(EitherSuite):
    set_bool = "std_srvs/SetBool"
    parameter = "/behind/speed"


def test_types_are_those_of_ros_1(bridge: Bridge) -> None:
    schema: Any = stream(bridge, at(Role.OUTPUT, "/behind/picture")).schema
    assert schema["x-type"] == "sensor_msgs/Image"
    stamp = schema["properties"]["header"]["properties"]["stamp"]
    assert list(stamp["properties"]) == ["secs", "nsecs"]
    assert schema["properties"]["data"]["x-octets"] is True


@pytest.mark.parametrize("compression", ["cbor", "cbor-raw", "none"])
def test_messages_come_with_their_types(compression: str) -> None:
    bridge = made(ADDRESS, compression=compression)
    pictures, scans = Collector(), Collector()
    for name, to in (("picture", pictures), ("scan", scans)):
        source = at(Role.OUTPUT, f"/behind/{name}")
        bridge.open_source(source, stream(bridge, source), to.deliver)
    picture: Any = pictures.wait(1)[0]
    assert picture["data"] == bytes(index % 256 for index in range(WIDTH * HEIGHT))
    assert (picture["width"], picture["header"]["stamp"]) == (WIDTH, {"secs": 5, "nsecs": 0})
    scan: Any = scans.wait(1)[0]
    assert scan["ranges"].dtype == np.float32
    last = [np.nan, np.nan] if compression == "none" else [np.inf, np.nan]
    assert np.array_equal(scan["ranges"], np.array([0.5, *last], np.float32), equal_nan=True)
    bridge.close()


def test_a_latched_message_comes_first(bridge: Bridge) -> None:
    source, collector = at(Role.OUTPUT, "/behind/map", latch=True), Collector()
    bridge.open_source(source, stream(bridge, source), collector.deliver)
    assert collector.wait(1) == [{"data": "a map"}]


def test_an_action_of_actionlib_is_a_call(bridge: Bridge) -> None:
    description = bridge.describe(at(Role.SERVICE, *ADD))
    assert description.request is not None
    assert description.reply is not None
    for number in range(5):
        assert bridge.call(at(Role.SERVICE, *ADD), {"a": number, "b": 2}) == {"sum": number + 2}
    with pytest.raises(BridgeError, match="the goal was aborted: it cannot"):
        bridge.call(at(Role.SERVICE, *ADD), {"a": -1, "b": 0})


def test_a_goal_that_is_given_up_is_cancelled(bridge: Bridge) -> None:
    hold = at(Role.SERVICE, *HOLD)
    with pytest.raises(BridgeTimeoutError):
        bridge.call(hold, {"a": 1, "b": 1}, timeout=1)
    first = Background(lambda: bridge.call(hold, {"a": 1, "b": 2}))
    states, state = Collector(), at(Role.OUTPUT, "/behind/hold/status")
    bridge.open_source(state, stream(bridge, state), states.deliver)

    def runs() -> bool:
        message: Any = states.messages[-1] if states.messages else {"status_list": []}
        return any(status["status"] == 1 for status in message["status_list"])

    eventually(runs, "the goal runs")
    cancel = at(Role.INPUT, "/behind/hold/cancel")
    everything = {"stamp": {"secs": 0, "nsecs": 0}, "id": ""}
    bridge.open_sink(cancel, stream(bridge, cancel)).send(everything)
    with pytest.raises(BridgeError, match="the goal was preempted: let go"):
        first.result()


def test_every_node_is_discovered_with_structures(bridge: Bridge) -> None:
    found = {component.name: component for component in bridge.discover()}
    ports = {endpoint.address[0]: made for endpoint, made in found["/behind"].endpoints}
    assert ports["/behind/scan"].message is not None
    assert ports["/behind/set"].reply is not None
    assert ports["/behind/add"].request is not None  # an action, of its five topics one
    assert not any(name.startswith("/behind/add/") for name in ports)


def test_what_is_not_there_is_named(bridge: Bridge) -> None:
    with pytest.raises(BridgeError, match="no node publishes it"):
        bridge.describe(at(Role.OUTPUT, "/nowhere"))
    with pytest.raises(BridgeError, match="no node subscribes to /cmd_vel"):
        bridge.describe(at(Role.INPUT, "/cmd_vel", "geometry_msgs/Twist"))
    with pytest.raises(BridgeError, match="no node serves it"):
        bridge.describe(at(Role.SERVICE, "/nowhere"))
    with pytest.raises(BridgeError, match="there is no server of action /nowhere"):
        bridge.describe(at(Role.SERVICE, "/nowhere", "actionlib/TwoIntsAction"))
    with pytest.raises(BridgeError, match="has the type std_msgs/String"):
        bridge.describe(at(Role.OUTPUT, "/behind/echoed", "std_msgs/Int8"))


def test_events_are_not_needed_for_any_of_this(bridge: Bridge) -> None:
    events: list[HealthEvent] = []
    bridge.watch(events.append)
    bridge.call(at(Role.SERVICE, *ADD), {"a": 1, "b": 2})
    assert events == []
