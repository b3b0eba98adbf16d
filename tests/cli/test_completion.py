"""The tab key completes names of functions from the configuration."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from uoarm.cli import main

ROBOT = """
version: 1
bridges: {python: {plugin: python}}
functions:
  count: {components: [{name: a, bridge: python, output: {endpoint: [robot:numbers]}}]}
  counter: {components: [{name: b, bridge: python, output: {endpoint: [robot:numbers]}}]}
  camera: {components: [{name: c, bridge: python, output: {endpoint: [robot:numbers]}}]}
"""


def completed(monkeypatch: pytest.MonkeyPatch, line: str) -> list[str]:
    words = line.split(" ")
    monkeypatch.setenv("_UOARM_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", line)
    monkeypatch.setenv("COMP_CWORD", str(len(words) - 1))
    told = CliRunner().invoke(main, prog_name="uoarm").output
    return [found.partition(",")[2] for found in told.split()]


@pytest.mark.parametrize("command", ["request", "resolve", "call"])
def test_functions_are_completed(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "other.yaml").write_text(ROBOT.replace("counter", "counted"))
    (tmp_path / "broken.yaml").write_text("version: [")
    monkeypatch.chdir(tmp_path)
    assert completed(monkeypatch, f"uoarm {command} count") == ["count", "counter"]
    assert completed(monkeypatch, f"uoarm {command} -f other.yaml count") == ["count", "counted"]
    assert completed(monkeypatch, f"uoarm {command} -f broken.yaml c") == []
    assert completed(monkeypatch, f"uoarm {command} -f absent.yaml c") == []
    monkeypatch.setenv("UOARM_CONFIG", "other.yaml")
    assert completed(monkeypatch, f"uoarm {command} counted") == ["counted"]
