"""The page's example runs as printed, with Debian's own master and rospy."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
from pathlib import Path
from typing import Any

import yaml
from peers import Master
from tests.processes import run_python  # type: ignore[import-not-found]
from uoarm_ros1._options import Ros1BridgeOptions, Ros1Options
from uoarm_ros1._types import TypeStore

from uoarm._adapt import check_edge
from uoarm.bridge import options_table
from uoarm.model import MessageStructure
from uoarm.testing import wait

ROOT = Path(__file__).parents[3]
PAGE = ROOT / "docs" / "ros1.md"
EXAMPLE = ROOT / "examples" / "ros1" / "README.md"


def test_the_example_runs_as_printed(master: Master, tmp_path: Path) -> None:
    text = EXAMPLE.read_text(encoding="utf-8")
    _, peers, robot, commands, printed, application, *_ = (
        found[1] for found in re.finditer(r"```\w+\n(.*?)```", text, re.DOTALL)
    )
    (tmp_path / "robot.yaml").write_text(robot.replace("127.0.0.1", master.host))
    _, _, node = peers.partition("&\n")  # the test has a master of its own
    shell = subprocess.Popen(
        ["bash", "-c", node], cwd=tmp_path, env=master.environment, start_new_session=True
    )
    try:
        said: list[str] = []

        def answered() -> bool:
            done = [_run(line, tmp_path) for line in commands.splitlines()]
            said[:] = [run.stdout + run.stderr for run in done]
            return not any(run.returncode for run in done)

        wait(answered, "the node of the example did not come up")
        assert "".join(said) == printed
        (tmp_path / "application.py").write_text(application)
        done = _run("application", tmp_path)
        assert done.stdout == "Kia ora\noff\n", done.stderr
        assert "output  /chatter, std_msgs/String" in _run("uoarm discover", tmp_path).stdout
        # It is named there already, without its type; where it is not, it is suggested.
        assert "/chatter" not in _run("uoarm suggest", tmp_path).stdout
        bridges, _, _ = robot.replace("127.0.0.1", master.host).partition("functions:")
        (tmp_path / "robot.yaml").write_text(f"{bridges}functions: {{}}\n")
        assert "chatter: {endpoint:" in _run("uoarm suggest", tmp_path).stdout
    finally:
        os.killpg(shell.pid, 9)
        shell.wait()


def test_the_map_of_the_page_is_the_one_that_is_offered() -> None:
    text = PAGE.read_text(encoding="utf-8")
    block = next(
        found[1]
        for found in re.finditer(r"```yaml\n(.*?)```", text, re.DOTALL)
        if "map:" in found[1]
    )
    (component,) = yaml.safe_load(block)["functions"]["stamped"]["components"]
    header = TypeStore(()).require("std_msgs/Header").structure
    seconds = {"type": "integer", "minimum": -(2**31), "maximum": 2**31 - 1, "x-unit": "s"}
    rest = {"type": "integer", "minimum": 0, "maximum": 2**32 - 1, "x-unit": "ns"}
    time = _closed("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
    other = _closed("std_msgs/msg/Header", stamp=time, frame_id={"type": "string"})
    offered = check_edge(header, MessageStructure(other)).reasons[0].suggestion
    keys = ("map", "allow_loss")
    assert yaml.safe_load(offered) == {key: component["input"][key] for key in keys}


def _closed(name: str, **fields: Any) -> dict[str, Any]:
    described = {"type": "object", "properties": fields, "required": [*fields], "x-type": name}
    return {**described, "additionalProperties": False}


def _run(line: str, folder: Path) -> Any:
    return run_python("-m", *shlex.split(line), cwd=folder, env={"HOME": str(folder)})


def test_the_table_of_options_is_what_the_plugin_declares() -> None:
    for kind in (Ros1Options, Ros1BridgeOptions):
        assert options_table(kind.schema()) in PAGE.read_text(encoding="utf-8")
