"""Structures of installed types by name: the real ones, and nothing else imported for a client."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from endpoints import endpoint
from robots import rosbridge
from tests.processes import run_python  # type: ignore[import-not-found]
from uoarm_ros2._installed import structure_of_type
from websockets.sync.client import connect

from uoarm.bridge import Bridge
from uoarm.cli import main
from uoarm.model import Role
from uoarm.testing import patience


@pytest.mark.parametrize("name", ["sensor_msgs/msg/Imu", "test_msgs/msg/Arrays"])
def test_it_is_what_the_bridge_describes(bridge: Bridge, name: str) -> None:
    at = endpoint(Role.INPUT, "/named", name, peer="optional")
    described = bridge.describe(at).message
    found = structure_of_type(name, {})
    assert found is not None
    assert described is not None
    assert (found.schema, found.native_type) == (described.schema, described.native_type)


def test_ros_1_spells_types_without_what_they_are() -> None:
    assert structure_of_type("std_msgs/String", {}) is structure_of_type("std_msgs/msg/String", {})


@pytest.mark.parametrize(
    "name",
    [
        "", "String", "std_msgs/msg/Nothing", "nowhere_msgs/msg/String", "std_srvs/srv/Empty",
        "../msg/String", "std_msgs/msg/String/x", "Std_msgs/msg/String", "json/msg/String",
    ],
)  # fmt: skip
def test_what_is_no_installed_message_type_is_unknown(name: str) -> None:
    assert structure_of_type(name, {}) is None


CHECKED = """
version: 1
bridges:
  ros: {plugin: ros2, options: {definitions: [messages]}}
functions:
  picture:
    components:
      - name: picture
        bridge: ros
        output: {endpoint: [/picture, sensor_msgs/msg/Imaeg]}
      - name: grip
        bridge: ros
        outputs:
          good: {endpoint: [/grip, claw_msgs/msg/Grip]}
          bad: {endpoint: [/force, claw_msgs/msg/Force]}
          none: {endpoint: [/nothing, claw_msgs/msg/Gripp]}
          untyped: {endpoint: [/anything]}
  turn:
    components:
      - name: turn
        bridge: ros
        service: {endpoint: [/turn, std_srvs/srv/SetBol]}
  hold:
    components:
      - name: hold
        bridge: ros
        service: {endpoint: [/hold, claw_msgs/srv/Hold]}
"""


def test_check_names_types_that_are_not_here_and_files_that_cannot_be_read(tmp_path: Path) -> None:
    folder = tmp_path / "messages" / "claw_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Grip.msg").write_text("int8 a\n")
    (folder / "Force.msg").write_text("uint8 newtons 300\n")
    (folder.parent / "srv").mkdir()
    (folder.parent / "srv" / "Hold.srv").write_text("---\n")
    (tmp_path / "robot.yaml").write_text(CHECKED)
    done = CliRunner().invoke(main, ["check", str(tmp_path / "robot.yaml"), "--json"])
    assert done.exit_code == 0, done.output
    warnings = {
        warning["path"]: warning["sentence"] for warning in json.loads(done.stdout)["warnings"]
    }
    wrong = (
        "Force.msg: line 1: 'uint8 newtons 300': expected a whole number from 0 to 255, got '300'"
    )
    found = {path: text for path, text in warnings.items() if "type" in text}
    assert len(found) == 6, found
    whole, hold, image, bad, none, service = (found[path] for path in sorted(found))
    assert hold.endswith("the type 'claw_msgs/srv/Hold': build its package")
    assert wrong in whole
    assert (
        "no package that is installed here has the type 'sensor_msgs/msg/Imaeg'; did you" in image
    )
    assert image.endswith("did you mean 'sensor_msgs/msg/Image'?")
    assert wrong in bad
    assert none.endswith("did you mean 'claw_msgs/msg/Grip'?")
    assert service.endswith("did you mean 'std_srvs/srv/SetBool'?")


def test_nothing_but_packages_of_messages_is_imported_and_rclpy_is_not(tmp_path: Path) -> None:
    for package in ("plain", "partly/msgs"):
        (tmp_path / package).mkdir(parents=True)
    (tmp_path / "plain" / "__init__.py").write_text("print('imported')")
    (tmp_path / "partly" / "__init__.py").write_text("print('imported')")
    (tmp_path / "alone.py").write_text("print('imported')")
    program = """
import sys
from uoarm_ros2._installed import structure_of_type
for name in ("plain/msg/A", "partly/A", "alone/msg/A", "antigravity/msg/A"):
    assert structure_of_type(name, {}) is None
assert structure_of_type("std_msgs/String", {}) is not None
print("rclpy" in sys.modules, "antigravity" in sys.modules)
"""
    done = run_python("-c", program, cwd=tmp_path)
    assert done.stdout == "False False\n", done.stdout + done.stderr


def test_clients_of_rosbridge_share_messages_of_real_types() -> None:
    with rosbridge("  {}") as (manager, url), connect(url) as client:

        def send(**fields: object) -> None:
            client.send(json.dumps(fields))

        send(op="subscribe", topic="/aim", type="geometry_msgs/Twist")
        send(op="advertise", topic="/aim", type="geometry_msgs/Twist")
        send(op="publish", topic="/aim", msg={"linear": {"x": "fast"}})
        send(op="publish", topic="/aim", msg={"linear": {"x": 0.5}})
        report, got = (json.loads(client.recv(timeout=patience())) for _ in range(2))
    assert report["msg"].startswith("message: /aim: $.linear.x: expected a number"), report
    zero = {"x": 0.0, "y": 0.0, "z": 0.0}
    assert got["msg"] == {"linear": {**zero, "x": 0.5}, "angular": zero}
    assert not manager.status().bridges
