"""Ctrl-C and SIGTERM while a program of the examples imports what it uses."""

from __future__ import annotations

import ast
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.cli.test_interrupted import WAITING
from tests.processes import run_python

from uoarm.testing import patience

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
# Started by mixed.py, which keeps what they write.
PARTS = {"mixed/ros1_camera.py", "mixed/sensor.py"}


def programs() -> Iterator[tuple[str, str]]:
    """Yield programs that a person starts, each with the first package that it imports."""
    for file in sorted(EXAMPLES.glob("*/*.py")):
        text = file.read_text(encoding="utf-8")
        name = str(file.relative_to(EXAMPLES))
        if "__main__" not in text or name in PARTS:
            continue
        for node in ast.parse(text).body:
            modules = [node.module] if isinstance(node, ast.ImportFrom) else []
            modules += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            packages = {str(module).partition(".")[0] for module in modules}
            if foreign := packages - sys.stdlib_module_names:
                yield name, foreign.pop()
                break


PROGRAMS = dict(programs())


def test_programs_are_found() -> None:
    assert {"agent/visit.py", "ros2/talker.py", "fleet/desk.py"} <= PROGRAMS.keys()


@pytest.mark.parametrize("name", PROGRAMS)
def test_it_is_ready_for_one_before_all_other_imports(name: str) -> None:
    text = (EXAMPLES / name).read_text(encoding="utf-8")
    imports = re.findall(r"^(?:import|from) (?!__future__)\S+", text, re.MULTILINE)
    assert imports[0] == "import signal"
    assert text.index("SIG_DFL)") < text.index(imports[1])


@pytest.mark.parametrize(
    "shared",
    [
        pytest.param("healthbot/experiments/stage.py", marks=pytest.mark.needs("rtm")),
        "warehouse/experiments/experiment.py",
    ],
)
def test_an_experiment_ends_in_silence(shared: str) -> None:
    file = EXAMPLES / shared
    code = f"import signal, {file.stem}; signal.raise_signal(signal.SIGINT)"
    done = run_python("-c", code, env={**os.environ, "PYTHONPATH": str(file.parent)})
    assert (done.returncode, done.stderr) == (-signal.SIGINT, "")


@pytest.mark.needs("rocos")
def test_the_loops_of_an_experiment_end_with_their_input_alone() -> None:
    command = [sys.executable, str(EXAMPLES / "healthbot/experiments/loops.py"), "rocos"]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline().startswith("tcp://")
            process.send_signal(signal.SIGINT)
            _, said = process.communicate(timeout=patience())
        finally:
            process.kill()
    assert (process.returncode, said) == (0, "")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("name", PROGRAMS)
def test_a_signal_while_it_imports_ends_it_in_silence(
    name: str, number: signal.Signals, tmp_path: Path
) -> None:
    (tmp_path / f"{PROGRAMS[name]}.py").write_text(WAITING)
    pipe, env = subprocess.PIPE, {**os.environ, "PYTHONPATH": str(tmp_path)}
    command = [sys.executable, str(EXAMPLES / name)]
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, env=env) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "it imports\n"
        process.send_signal(number)
        _, said = process.communicate(timeout=patience())
    assert (process.returncode, said) == (-number, "")
