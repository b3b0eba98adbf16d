"""What one prints of a manager is what the command line shows of it, and a `repr` is short."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from uoarm import RobotManager
from uoarm.cli import main
from uoarm.cli._discover import _print_tables
from uoarm.config import loads
from uoarm.model import to_json
from uoarm.testing import Collector, MemoryBridge, patience

NUMBER: Any = {"type": "integer"}
ROBOT = """
version: 1
bridges: {one: {plugin: memory}}
functions:
  camera:
    components:
      - {name: best, bridge: one, priority: 2, output: {endpoint: [best]}}
      - {name: spare, bridge: one, priority: 1, output: {endpoint: [spare]}}
  face:
    components:
      - {name: face, bridge: one, input: {from: camera, endpoint: [face]},
         output: {endpoint: [face]}}
"""
PYTHON = """
version: 1
bridges: {python: {}}
functions:
  wanted:
    components:
      - {name: good, bridge: python, output: {endpoint: ["tests.manager.stage:narrow"]}}
      - {name: bad, bridge: python, priority: 9, output: {endpoint: ["tests.manager.stage:none"]}}
  hopeless:
    components:
      - {name: worse, bridge: python, output: {endpoint: ["tests.manager.stage:none"]}}
"""


def test_a_status_prints_as_the_command_line_shows_it(capsys: pytest.CaptureFixture[str]) -> None:
    bridge = MemoryBridge("one")
    camera = bridge.emitter("spare", NUMBER)
    bridge.loop("face", NUMBER)
    report = Collector()
    with RobotManager(loads(ROBOT), bridges={"one": bridge}) as robot:
        robot.listen(report.deliver)
        connection = robot.request("face")
        camera.emit(1)
        connection.get(patience())
        status = robot.status()
        _print_tables(to_json(status))
        assert capsys.readouterr().out == f"{status}\n"
        lines = str(status).splitlines()
        assert "connections: 1" in lines
        assert "  c1  face      running  0" in lines
        assert any(
            line.split()[:4] == ["spare.default", "face.default", "1", "1"] for line in lines
        )
        report.wait(1)
        assert str(report.messages[0]) == "#1 connection c1 opening"
        assert repr(connection) == "<Connection c1 to 'face': running, spare -> face>"
        assert repr(connection.plan) == "<Plan face: spare -> face>"
        assert repr(robot) == "<RobotManager in memory: 2 functions, 1 connections>"


def test_plans_and_availability_print_as_the_command_line_shows_them(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(PYTHON)
    shown = CliRunner().invoke(main, ["resolve", "wanted", "-f", str(file), "--explain"])
    with RobotManager.from_file(file) as robot:
        plan, availability = robot.resolve("wanted"), robot.check_availability()
    assert shown.output == f"{plan}\n"
    assert str(plan).startswith(
        "plan for wanted\n  1. wanted: good (python, priority 0)\npassed over"
    )
    shown = CliRunner().invoke(main, ["status", "-f", str(file)])
    assert shown.output == "".join(f"{status}\n" for status in availability)
    assert str(availability[0]).startswith("wanted  from good\n       9  bad  (python)  ")
    assert str(availability[1]).startswith("hopeless  unavailable\n")
