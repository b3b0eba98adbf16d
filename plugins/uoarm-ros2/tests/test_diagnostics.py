"""The manager's health on `/diagnostics`, as a node of rclpy receives it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from endpoints import Make
from peers import DOMAIN
from rclpy.executors import SingleThreadedExecutor

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.model import Health
from uoarm.testing import MemoryBridge, wait

ROBOT = """
version: 1
bridges: {ros: {plugin: ros2}, memory: {}, status: {}}
functions:
  camera: {components: [{name: camera, bridge: memory, output: {endpoint: [camera]}}]}
  diagnostics: {components: [{name: manager, bridge: status, output: {endpoint: [diagnostics]}}]}
offer:
  ros:
    diagnostics: {output: {endpoint: [/diagnostics, diagnostic_msgs/msg/DiagnosticArray]}}
"""


@pytest.fixture
def received() -> Iterator[Callable[[], list[Any]]]:
    """What a subscriber has received so far; each call lets it take what has come."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    node = rclpy.create_node("monitor", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    messages: list[Any] = []
    node.create_subscription(DiagnosticArray, "/diagnostics", messages.append, 10)

    def take() -> list[Any]:
        executor.spin_once(timeout_sec=0.05)
        return messages

    yield take
    executor.shutdown()
    node.destroy_node()
    context.shutdown()


def test_monitors_see_the_managers_health_as_it_changes(
    make_bridge: Make, received: Callable[[], list[Any]]
) -> None:
    memory = MemoryBridge("memory")
    memory.emitter("camera", {"type": "integer"})
    parts = {"ros": make_bridge(), "memory": memory}
    with RobotManager(loads(ROBOT), bridges=parts) as robot:
        robot.request("camera")
        robot.offer()

        def level(name: str) -> int | None:
            messages = received()
            entries = messages[-1].status if messages else ()
            found = [entry.level for entry in entries if entry.name == f"uoarm: {name}"]
            return found[0][0] if found else None

        wait(lambda: level("component camera") == 0)
        message = received()[-1]
        assert message.header.stamp.sec > 0
        entry = next(item for item in message.status if item.name == "uoarm: function camera")
        assert {pair.key: pair.value for pair in entry.values}["components"] == "camera"
        memory.report(Health.DEGRADED, "a bad cable", component="camera")
        wait(lambda: level("component camera") == 1)
        memory.die("camera")
        wait(lambda: level("component camera") == 3)  # STALE: it is gone
