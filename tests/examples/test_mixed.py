"""ROS 1, ROS 2 and MQTT serve one application; a camera is killed, replaced and returned to."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from tests.processes import hold_dies_whole, hold_ends_all, hold_ends_unread, run_python

from uoarm.testing import patience

SCRIPT = Path(__file__).parents[2] / "examples" / "mixed" / "mixed.py"


@pytest.mark.parametrize("alone", [(), ("--alone",)], ids=["as it comes", "without rospy"])
def test_the_camera_is_replaced_and_returned_to(alone: tuple[str, ...]) -> None:
    """Where rospy is not installed, both are the same."""
    # USER is what a container or sudo left there, and no user whom the system knows.
    env = {"USER": "stranger-here", "LOGNAME": "stranger-here"}
    done = run_python(SCRIPT, "--times", "1", "--patience", str(patience()), *alone, env=env)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].startswith("ROS 1: no rospy here" if alone else "ROS 1: ")
    assert [line.partition(" after ")[0] for line in lines[1:]] == [
        "the application gets pictures of ROS 1, and temperatures of MQTT",
        "kill -9: ROS 2 takes over",
        "it was started again: ROS 1 is back",
        "all is ended",
    ]


def test_what_does_not_come_in_time_is_reported() -> None:
    done = run_python(SCRIPT, "--patience", "0")
    assert done.returncode == 1
    assert done.stderr.endswith(" within 0 s\n")
    assert "Traceback" not in done.stderr


def test_a_part_that_ends_by_itself_is_not_waited_for(tmp_path: Path) -> None:
    (tmp_path / "rclpy.py").write_text("raise ModuleNotFoundError(\"No module named 'rclpy'\")")
    done = run_python(SCRIPT, "--patience", "1e9", env={"PYTHONPATH": str(tmp_path)})
    why = "ModuleNotFoundError: No module named 'rclpy'"
    assert (done.returncode, done.stderr) == (2, f"new camera ended with 1: {why}\n")


def test_a_signal_ends_every_part() -> None:
    hold_ends_all(sys.executable, "-u", str(SCRIPT))


def test_it_ends_with_what_reads_it() -> None:
    hold_ends_unread(sys.executable, "-u", str(SCRIPT))


def test_no_part_outlives_it(tmp_path: Path) -> None:
    after, env = "the application gets pictures", {"TMPDIR": str(tmp_path)}
    hold_dies_whole(sys.executable, "-u", str(SCRIPT), after=after, env=env)
