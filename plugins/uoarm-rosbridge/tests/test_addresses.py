"""Clients that ask for what the robot has by its name in ROS receive its name here."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from ros import Ros, url

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.server import ServerOptions, serve_in_thread
from uoarm.testing import MemoryBridge

NUMBER = {"type": "object", "properties": {"data": {"type": "integer"}}}
ROBOT = """
version: 1
bridges: {lab: {plugin: memory}}
functions:
  odometry: {components: [{name: base, bridge: lab, output: {endpoint: [/odom]}}]}
  drive:
    components:
      - name: wheels
        bridge: lab
        inputs: {left: {endpoint: [/left]}, right: {endpoint: [/right]}}
        outputs: {slip: {endpoint: [/slip]}, heat: {endpoint: [/heat]}}
  lamp: {components: [{name: lamp, bridge: lab, service: {endpoint: [/lamp]}}]}
"""
BETWEEN = " is between clients here; that of the robot is "


@pytest.fixture
def client() -> Iterator[Ros]:
    lab = MemoryBridge("lab", {})
    lab.emitter("/odom", NUMBER)
    robot = RobotManager(loads(ROBOT), bridges={"lab": lab})
    with (
        robot,
        serve_in_thread(robot, ServerOptions(port=0)) as server,
        Ros(url(server)) as entered,
    ):
        yield entered


@pytest.mark.parametrize(
    ("asked", "topic", "received"),
    [
        ("subscribe", "/odom", "/uoarm/odometry"),
        ("subscribe", "/heat", "/uoarm/drive/heat"),
        ("advertise", "/left", "/uoarm/drive/left"),
    ],
)
def test_a_topic_of_the_robot_s_framework_is_hinted_at_once(
    client: Ros, asked: str, topic: str, received: str
) -> None:
    client.send(op=asked, topic=topic, type="std_msgs/Int32", id="one")
    assert client.receive() == {
        "op": "status",
        "level": "warning",
        "msg": f"{topic}{BETWEEN}{received}",
        "id": "one",
    }
    client.send(op=asked, topic=topic, type="std_msgs/Int32")
    assert client.call("/rosapi/get_time")["time"], "nothing more is reported"


def test_a_service_of_the_robot_s_framework_is_hinted_at(client: Ros) -> None:
    client.send(op="call_service", service="/lamp", id="c")
    reports = client.receive()
    assert reports["result"] is False
    assert f"/lamp{BETWEEN}/uoarm/lamp" in reports["values"]
    client.send(op="advertise_service", service="/lamp", type="lab/Lamp")
    client.send(op="call_service", service="/lamp", id="d")
    assert client.receive()["op"] == "call_service", "that of a client is called"


def test_what_means_something_else_gets_no_hint(client: Ros) -> None:
    client.send(op="advertise", topic="/odom", type="std_msgs/Int32")  # it takes nothing there
    client.send(op="subscribe", topic="/chatter", type="std_msgs/Int32")
    assert client.call("/rosapi/get_time")["time"]
