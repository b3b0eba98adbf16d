"""The tab key completes names of functions from the configuration."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.processes import run_program

from uoarm.cli import main

ROBOT = """
version: 1
bridges: {python: {plugin: python}}
functions:
  count: {components: [{name: a, bridge: python, output: {endpoint: [robot:numbers]}}]}
  counter: {components: [{name: b, bridge: python, output: {endpoint: [robot:numbers]}}]}
  camera: {components: [{name: c, bridge: python, output: {endpoint: [robot:numbers]}}]}
  say: {components: [{name: d, bridge: python, service: {endpoint: [robot:say]}}]}
  seen: {needs: {name: "x*"}}
  asked: {needs: {name: "x*", role: service}}
"""
STREAMS, SERVICES = ["count", "counter", "camera", "seen"], ["say", "asked"]


def completed(monkeypatch: pytest.MonkeyPatch, line: str) -> list[str]:
    words = line.split(" ")
    monkeypatch.setenv("_UOARM_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", line)
    monkeypatch.setenv("COMP_CWORD", str(len(words) - 1))
    text = CliRunner().invoke(main, prog_name="uoarm").output
    return [found.partition(",")[2] for found in text.split()]


@pytest.mark.parametrize("command", ["request", "resolve"])
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


def test_codes_of_errors_are_completed(monkeypatch: pytest.MonkeyPatch) -> None:
    assert completed(monkeypatch, "uoarm explain UOA-00") == ["UOA-001", "UOA-002", "UOA-003"]
    assert completed(monkeypatch, "uoarm explain uoa-80")[:2] == ["UOA-801", "UOA-802"]


def test_what_is_called_is_offered_to_calls_and_what_flows_to_requests(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "robot.yaml").write_text(ROBOT)
    monkeypatch.chdir(tmp_path)
    assert completed(monkeypatch, "uoarm request ") == STREAMS
    assert completed(monkeypatch, "uoarm record camera ") == STREAMS
    assert completed(monkeypatch, "uoarm call ") == SERVICES
    assert set(completed(monkeypatch, "uoarm resolve ")) == {*STREAMS, *SERVICES}


@pytest.mark.skipif(shutil.which("bash") is None, reason="the command bash is not installed")
def test_a_shell_has_them(tmp_path: Path) -> None:
    """As the page says it for bash; what zsh and fish ask for is the same."""
    (tmp_path / "robot.yaml").write_text(ROBOT)
    command = tmp_path / "uoarm"
    # As pip writes it where the interpreter's path is no first line: for sh, then for Python.
    head = f"""#!/bin/sh\n'''exec' "{sys.executable}" "$0" "$@"\n' '''"""
    command.write_text(f"{head}\nfrom uoarm.cli import main\nmain()\n")
    command.chmod(0o755)
    typed = """
        eval "$(_UOARM_COMPLETE=bash_source uoarm)"
        COMP_WORDS=(uoarm request "c") COMP_CWORD=2
        _uoarm_completion uoarm
        echo "${COMPREPLY[*]}"
    """
    path = f"{tmp_path}{os.pathsep}{os.environ['PATH']}"
    done = run_program("bash", "--norc", "-c", typed, cwd=tmp_path, env={"PATH": path}, check=True)
    assert (done.stdout.split(), done.stderr) == (["count", "counter", "camera"], "")
