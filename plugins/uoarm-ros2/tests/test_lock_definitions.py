"""`uoarm lock --check --against` a folder of ROS definitions: no ROS, no robot."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from uoarm_ros2.definitions import read_definitions

from uoarm.cli import main


def write(folder: Path, width: str = "width", force: str = "float64 newtons\n") -> Path:
    for name, text in {"Grip": f"Force force\nfloat32 {width}\n", "Force": force}.items():
        path = folder / "claw_msgs" / "msg" / f"{name}.msg"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder


def check(tmp_path: Path, against: Path) -> Result:
    grip = read_definitions(write(tmp_path / "before")).structures["claw_msgs/msg/Grip"]
    part = {
        "component": "claw", "function": "grip", "bridge": "ros", "plugin": "ros2",
        "ports": {"output.default": "f"},
    }  # fmt: skip
    function = {"parts": ["claw"], "edges": [], "passed_over": {}, "refused": ""}
    structures = {"f": {"native_type": grip.native_type, "structure": grip.schema}}
    lock = {
        "version": 2, "functions": {"grip": function}, "structures": structures,
        "parts": {"claw": part},
    }  # fmt: skip
    path = tmp_path / "robot.lock"
    path.write_text(json.dumps(lock))
    words = ["--lock", str(path), "--check", "--against", str(against)]
    return CliRunner().invoke(main, ["lock", *words])


def test_the_same_definitions_fit(tmp_path: Path) -> None:
    done = check(tmp_path, write(tmp_path / "after"))
    assert done.exit_code == 0, done.output


def test_a_renamed_field_is_reported(tmp_path: Path) -> None:
    done = check(tmp_path, write(tmp_path / "after", width="opening"))
    assert done.exit_code == 1, done.output
    assert "grip: output.default: breaks: the field 'width' is required" in done.output


def test_a_renamed_field_of_a_nested_type_is_reported(tmp_path: Path) -> None:
    done = check(tmp_path, write(tmp_path / "after", force="float64 pounds\n"))
    assert done.exit_code == 1, done.output
    assert "grip: output.default: breaks: force: the field 'newtons' is required" in done.output


@pytest.mark.parametrize("octets", [b"\xff\xfe", b"Absent force\n"])
def test_a_definition_that_cannot_be_read_is_an_error(tmp_path: Path, octets: bytes) -> None:
    after = write(tmp_path / "after")
    (after / "claw_msgs" / "msg" / "Grip.msg").write_bytes(octets)
    done = check(tmp_path, after)
    assert done.exit_code == 3, done.output
    assert "the definition of claw_msgs/msg/Grip cannot be read: " in done.output


def test_without_the_extra_it_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (after := tmp_path / "after").mkdir()
    write(after)
    check(tmp_path, after)
    definition = after / "claw_msgs" / "msg" / "Grip.msg"
    definition.rename(definition.with_suffix(".idl"))
    monkeypatch.setitem(sys.modules, "rosbags.typesys.idl", None)
    words = ["--lock", str(tmp_path / "robot.lock"), "--check", "--against", str(after)]
    done = CliRunner().invoke(main, ["lock", *words])
    assert done.exit_code == 3, done.output
    assert "rosbags" in done.output
    assert "uoarm-ros2" in done.output
