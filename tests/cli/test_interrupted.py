"""Ctrl-C and SIGTERM before a command has begun, and in commands that open nothing."""

from __future__ import annotations

import re
import signal
from pathlib import Path

import pytest
from tests.cli.terminal import on_a_terminal

PROJECT = Path(__file__).parents[2] / "pyproject.toml"
WAITING = "print('it imports', flush=True)\nimport signal\nwhile True:\n    signal.pause()\n"
ROBOT = """
version: 1
bridges: {python: {}}
functions:
  late: {components: [{name: late, bridge: python, output: {endpoint: ["late:late"]}}]}
"""


def entry() -> str:
    """Return what the installed script `uoarm` does."""
    found = re.search(r'^uoarm = "(.+):(.+)"$', PROJECT.read_text(encoding="utf-8"), re.MULTILINE)
    assert found is not None
    return f"import sys; from {found[1]} import {found[2]}; sys.exit({found[2]}())"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_it_imports_ends_it_in_silence(
    number: signal.Signals, tmp_path: Path
) -> None:
    (tmp_path / "attrs.py").write_text(WAITING)
    program = ("-c", entry())
    seen = on_a_terminal(
        ["--version"], tmp_path, interrupt_at="it imports", number=number, program=program
    )
    assert seen.text.strip() == "it imports"
    assert seen.code == -number, "a shell shows it as 128 and the signal's number"


def test_the_script_runs_the_command_which_ctrl_c_interrupts_as_ever(tmp_path: Path) -> None:
    seen = on_a_terminal(["--version"], tmp_path, program=("-c", entry()))
    assert (seen.code, "uoarm, version" in seen.text) == (0, True)
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "late.py").write_text(
        "print('it imports', flush=True)\nimport time\ntime.sleep(600)\n"
    )
    seen = on_a_terminal(["check"], tmp_path, interrupt_at="it imports", program=("-c", entry()))
    assert (seen.code, "".join(seen.text.split())) == (130, "itimportsinterrupted")
