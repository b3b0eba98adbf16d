"""A ROS 2 installation that was sourced, and a workspace over it; neither has wheels."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from endpoints import Start
from peers import own_line
from sourced import Sourced

from uoarm.testing import patience, wait

HERE = Path(__file__).parent
pytestmark = pytest.mark.skipif(
    sys.prefix == sys.base_prefix, reason="needs an interpreter beside the environment's"
)
DOCTOR = """
import json, uoarm_ros2
print(json.dumps(uoarm_ros2.uoarm_bridge_types()[0].doctor()))
"""
USE = """
import json, threading
from uoarm.bridge import Registry
from uoarm.model import BridgeSpec, Endpoint, Role
bridge = Registry().create(BridgeSpec("ros", "ros2", {"wait": 60}))
def at(role, *address): return Endpoint("ros", "claw", role, address)
came, grips = threading.Event(), []
def take(grip):
    grips.append(grip)
    came.set()
grip = at(Role.OUTPUT, "/grip")
bridge.open_source(grip, bridge.describe(grip, timeout=120).message, take, timeout=120)
assert came.wait(120)
def call(request, *address): return bridge.call(at(Role.SERVICE, *address), request, timeout=120)
taken = call({"wanted": grips[0]}, "/take", "claw_msgs/srv/Take")
squeezed = call({"force": 3.0}, "/squeeze", "claw_msgs/action/Squeeze")
bridge.close()
print(json.dumps([grips[0]["force"], taken, squeezed]))
"""


@pytest.fixture
def sourced(tmp_path: Path) -> Sourced:
    return Sourced(tmp_path)


def test_an_installation_that_was_sourced_is_used(sourced: Sourced, peer: Start) -> None:
    report = json.loads(sourced.run("-c", DOCTOR))
    assert report["rclpy"].startswith(str(sourced.prefix))
    assert report["distribution"] == "jazzy, from a ROS 2 installation that was sourced"
    assert "conflict" not in report
    assert "std_srvs/srv/SetBool" in sourced.run("-m", "uoarm_ros2", "interfaces")
    peer("talker").do("advertise", topic="/numbers")
    numbers = {"role": "output", "name": "/numbers", "type": "std_msgs/msg/Int64", "known": True}

    def listed() -> bool:
        rows = json.loads(sourced.run("-m", "uoarm_ros2", "list", "--json"))
        return {"node": "/talker", "endpoints": [numbers]} in rows

    wait(listed)


@pytest.mark.long
def test_a_workspace_over_it_is_built_and_used(sourced: Sourced, tmp_path: Path) -> None:
    """Types that only the workspace has, as message, service and action."""
    from test_build_interfaces import DEFINITIONS

    for name, text in DEFINITIONS.items():
        path = tmp_path / "src" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    words = ["build-interfaces", str(tmp_path / "src"), "--output", str(tmp_path), "--json"]
    sourced.add_workspace(map(Path, json.loads(sourced.run("-m", "uoarm_ros2", *words))))
    assert "claw_msgs/srv/Take" in sourced.run("-m", "uoarm_ros2", "interfaces")
    node = subprocess.Popen(
        [sourced.python, str(HERE / "own_interfaces.py")],
        env=sourced.environment,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert node.stdout is not None
        assert own_line(node.stdout) == "ready\n"
        found = json.loads(sourced.run("-c", USE))
        assert found == [2.5, {"success": True, "message": "elbow"}, {"done": True}]
    finally:
        node.terminate()
        node.wait(patience())
        assert node.stdout is not None
        node.stdout.close()
