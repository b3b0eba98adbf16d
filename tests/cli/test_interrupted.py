"""Ctrl-C and SIGTERM before a command has begun, and in commands that open nothing; a crash."""

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
  crash: {components: [{name: crash, bridge: python, service: {endpoint: ["late:crash"]}}]}
"""


def entry() -> str:
    """Return what the installed script `uoarm` does."""
    found = re.search(r'^uoarm = "(.+):(.+)"$', PROJECT.read_text(encoding="utf-8"), re.MULTILINE)
    assert found is not None
    return f"import sys; from {found[1]} import {found[2]}; sys.exit({found[2]}())"


@pytest.mark.parametrize("late", ["attrs", "click"], ids=["command", "command line"])
@pytest.mark.parametrize("program", [("-c", entry()), ("-m", "uoarm")], ids=["script", "module"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_it_imports_ends_it_in_silence(
    number: signal.Signals, program: tuple[str, str], late: str, tmp_path: Path
) -> None:
    (tmp_path / f"{late}.py").write_text(WAITING)
    seen = on_a_terminal(
        ["check"], tmp_path, interrupt_at="it imports", number=number, program=program
    )
    assert seen.text.strip() == "it imports"
    assert seen.code == -number, "a shell shows it as 128 and the signal's number"


def test_a_program_of_another_name_that_imports_the_package_keeps_its_ctrl_c(
    tmp_path: Path,
) -> None:
    package = tmp_path / "uoarm_of_mine"
    package.mkdir()
    (package / "__init__.py").write_text("import uoarm")
    (package / "__main__.py").write_text(
        "import signal; print(signal.getsignal(signal.SIGINT) is signal.default_int_handler)"
    )
    seen = on_a_terminal(["-m", "uoarm"], tmp_path, program=("-m", "uoarm_of_mine"))
    assert (seen.code, seen.text.strip()) == (0, "True")


@pytest.mark.parametrize("program", [("-c", entry()), ("-m", "uoarm")], ids=["script", "module"])
def test_the_script_runs_the_command_which_ctrl_c_interrupts_as_ever(
    program: tuple[str, str], tmp_path: Path
) -> None:
    seen = on_a_terminal(["--version"], tmp_path, program=program)
    assert (seen.code, "uoarm, version" in seen.text) == (0, True)
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "late.py").write_text(
        "print('it imports', flush=True)\nimport time\ntime.sleep(600)\n"
    )
    seen = on_a_terminal(["check"], tmp_path, interrupt_at="it imports", program=program)
    assert (seen.code, "".join(seen.text.split())) == (130, "itimportsinterrupted")


def test_a_crash_in_c_is_reported_with_the_line_that_called_it(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "late.py").write_text(
        "import ctypes\ndef crash(value: int) -> int:\n    return len(ctypes.string_at(0))\n"
    )
    seen = on_a_terminal(["call", "crash", "1"], tmp_path, program=("-m", "uoarm"))
    assert seen.code == -signal.SIGSEGV
    assert re.search(r'late.py", line 3 in crash', seen.text)
