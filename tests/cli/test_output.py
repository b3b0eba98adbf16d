"""What components print is no part of what a command was asked for."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.processes import run_python

from uoarm.cli import main
from uoarm.testing import patience

ROBOT = """
version: 1
bridges: {python: {}}
functions:
  ticks: {components: [{name: ticker, bridge: python, output: {endpoint: ["noisy:ticks"]}}]}
  add: {components: [{name: adder, bridge: python, service: {endpoint: ["noisy:add"]}}]}
"""
NOISY = """
import ctypes, os
from collections.abc import Iterator
def say(when):
    print("Python says", when)
    os.system(f"echo a program says {when}")
    ctypes.CDLL(None).printf(f"C says {when}\\n".encode())
say("import")
def ticks() -> Iterator[dict[str, int]]:
    say("tick")
    yield {"n": 1}
def add(numbers: dict[str, int]) -> dict[str, int]:
    say("call")
    return {"sum": sum(numbers.values())}
"""
COMMANDS = [
    ("request", "ticks", "-n", "1", "--json"),
    ("request", "ticks", "-n", "1"),
    ("call", "add", '{"a": 1}'),
    ("status", "--json"),
    ("resolve", "ticks", "--json"),
    ("record", "ticks", "-o", "run.mcap", "--json"),
    ("types", "--jsonschema"),
]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "robot.yaml").write_text(ROBOT)
    (tmp_path / "noisy.py").write_text(NOISY)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_what_components_print_goes_to_standard_error(words: tuple[str, ...], folder: Path) -> None:
    done = run_python("-m", "uoarm", *words, cwd=folder)
    assert done.returncode == 0, done.stderr
    decoder, rest = json.JSONDecoder(), done.stdout
    assert rest
    while rest:
        _, end = decoder.raw_decode(rest)
        rest = rest[end:].lstrip()
    assert "says" not in done.stdout
    for who in ("Python", "a program", "C"):
        assert f"{who} says import\n" in done.stderr


def test_a_command_within_a_program_gives_standard_output_back(
    capfd: pytest.CaptureFixture[str],
) -> None:
    done = CliRunner().invoke(main, ["call", "add", '{"a": 1}'])
    assert (done.stdout, "Python says call" in done.stderr) == ('{"sum": 1}\n', True)
    with pytest.raises(SystemExit):
        main(["call", "add", '{"a": 2}'])
    os.write(1, b"the program goes on\n")
    assert capfd.readouterr().out.endswith("the program goes on\n")


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8"])
def test_what_an_encoding_has_not_is_written_as_an_escape(encoding: str, folder: Path) -> None:
    name = os.fsencode(folder) + b"/\xff.yaml"
    Path(os.fsdecode(name)).write_text(
        ROBOT.replace("{components", "{description: Ü ☃, components")
    )
    env = {**os.environ, "PYTHONIOENCODING": encoding}
    for words in (("list",), ("list", "--json"), ("check",)):
        command = [sys.executable, "-m", "uoarm", *words, name]
        done = subprocess.run(command, env=env, capture_output=True, check=False)
        assert done.returncode == 0, done.stderr
        done.stdout.decode(encoding)
    assert b"\\udcff.yaml: no errors" in done.stdout


@pytest.mark.parametrize(
    ("words", "closed"),
    [(COMMANDS[5], ">&-"), (COMMANDS[5], "2>&-"), (COMMANDS[1], "<&- >&- 2>&-"),
     (COMMANDS[4], "<&- >&- 2>&-"), (COMMANDS[5], "<&- >&- 2>&-")],
    ids=lambda part: part if isinstance(part, str) else " ".join(part),
)  # fmt: skip
def test_a_command_runs_where_standard_streams_are_closed(
    words: tuple[str, ...], closed: str, folder: Path
) -> None:
    """What it opens then has their numbers: nothing is printed into that."""
    written = folder / "written"
    command = f'exec "$@" {closed} {"" if ">&-" in closed.split() else ">written"}'
    done = subprocess.run(
        ["/bin/sh", "-c", command, "sh", sys.executable, "-m", "uoarm", *words],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
        timeout=2 * patience(),
    )
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    assert not written.exists() or written.read_text()
    if "record" in words:
        assert (folder / "run.mcap").read_bytes()[:5] == b"\x89MCAP"
