"""Ctrl-C and SIGTERM while a program of the examples imports what it uses."""

from __future__ import annotations

import ast
import errno
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

# These act on it in `main`, or print nothing but what is wrong.
WITHIN = {
    "drive/terminal.py",
    "healthbot/scene.py",
    "mixed/mixed.py",
    "mixed/ros2_camera.py",
    "warehouse/warehouse.py",
}


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


def _with_an_end(file: Path, number: int) -> str:
    """Return a program that begins with an error of what it prints, without what it imports."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and node.name == "main":
            node.body = ast.parse(f"raise OSError({number}, os.strerror({number}))").body
    ours = {*sys.stdlib_module_names, "uoarm", "__future__"}
    kept: list[ast.stmt] = []
    for statement in tree.body:
        names = [str(statement.module)] if isinstance(statement, ast.ImportFrom) else []
        if isinstance(statement, ast.Import):
            names = [alias.name for alias in statement.names]
        is_main = isinstance(statement, ast.FunctionDef) and statement.name == "main"
        is_last = isinstance(statement, ast.If) and "__main__" in ast.unparse(statement.test)
        is_value = isinstance(statement, ast.Assign) and not any(
            isinstance(part, ast.Name | ast.Call) for part in ast.walk(statement.value)
        )
        if (
            is_main
            or is_last
            or is_value
            or (names and {name.partition(".")[0] for name in names} <= ours)
        ):
            kept.append(statement)
    return "\n".join(
        ["from __future__ import annotations", "import os", *map(ast.unparse, kept[1:])]
    )


@pytest.mark.parametrize(
    ("number", "said"),
    [(errno.ENOSPC, "No space left on device\n"), (errno.EPIPE, "")],
    ids=["a full disk", "head"],
)
@pytest.mark.parametrize("name", sorted(PROGRAMS.keys() - WITHIN))
def test_what_it_cannot_print_ends_it_with_a_line_at_most(
    name: str, number: int, said: str, tmp_path: Path
) -> None:
    program = tmp_path / "program.py"
    program.write_text(_with_an_end(EXAMPLES / name, number))
    done = run_python(str(program))
    assert (done.returncode, done.stderr) == (1, said)
