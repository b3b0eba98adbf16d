"""Relative paths of a configuration begin at its file, wherever the program runs."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from uoarm import RobotManager
from uoarm.bridge import BridgeType, Registry
from uoarm.cli import main
from uoarm.config import load, loads
from uoarm.testing import MemoryBridge

ROBOT = """
version: 1
bridges:
  python: {options: {path: [parts]}, host: HOST}
functions:
  greeting:
    components:
      - name: greeter
        bridge: python
        parameters: {PARAMETER: hello}
        service: {endpoint: ["paths_greeter:Greeter"]}
"""
GREETER = """
class Greeter:
    def __init__(self, word: str) -> None:
        self.word = word
    def __call__(self, name: str) -> str:
        return f"{self.word} {name}"
"""


@pytest.fixture(params=["relative", "absolute"])
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Path:
    """Return a robot's folder, as it is named from another one that has nothing of it."""
    parts = tmp_path / "robot" / "parts"
    parts.mkdir(parents=True)
    (parts / "paths_greeter.py").write_text(GREETER, encoding="utf-8")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    return Path("../robot") if request.param == "relative" else tmp_path / "robot"


def written(folder: Path, host: str = "false", parameter: str = "word") -> Path:
    text = ROBOT.replace("HOST", host).replace("PARAMETER", parameter)
    (folder / "robot.yaml").write_text(text, encoding="utf-8")
    return folder / "robot.yaml"


@pytest.mark.parametrize("host", ["false", "true", "{python: ./bin/python}"])
def test_modules_of_python_are_found(folder: Path, host: str) -> None:
    (folder / "bin").mkdir()
    start = f'#!/bin/sh\nexec "{sys.executable}" "$@"\n'
    (folder / "bin" / "python").write_text(start, encoding="utf-8")
    (folder / "bin" / "python").chmod(0o755)
    with RobotManager.from_file(written(folder, host)) as robot:
        assert robot.call("greeting", "you") == "hello you"


def test_a_program_may_go_elsewhere_meanwhile(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with RobotManager.from_file(written(folder)) as robot:
        monkeypatch.chdir("/")
        assert robot.call("greeting", "you") == "hello you"


def test_check_looks_at_the_same_modules(folder: Path) -> None:
    done = CliRunner().invoke(main, ["check", str(written(folder, parameter="wrod"))])
    assert done.exit_code == 3
    assert "wrod" in done.output
    assert "unavailable here" not in done.output


OPTIONS: dict[str, Any] = {
    "type": "object",
    "properties": {
        "file": {"type": "string", "x-uoarm-path": True},
        "url": {"type": "string", "x-uoarm-path": r"\./.*"},
        "name": {"type": "string"},
        "files": {
            "anyOf": [
                {"type": "string", "x-uoarm-path": True},
                {"type": "array", "items": {"type": "string", "x-uoarm-path": True}},
            ]
        },
        "parts": {
            "type": "object",
            "additionalProperties": {"properties": {"key": {"x-uoarm-path": True}}},
        },
    },
}
WRITTEN = """
version: 1
bridges:
  lab:
    plugin: lab
    options: {file: a/b, url: ./tty, name: a/b, files: FILES, parts: {one: {key: ../k, on: true}}}
functions: {}
"""


@pytest.mark.parametrize(("files", "expected"), [("a", "IN/a"), ("[a, /b]", ["IN/a", "/b"])])
def test_a_schema_says_which_options_are_paths(
    tmp_path: Path, files: str, expected: str | list[str]
) -> None:
    given: list[Any] = []

    def make(name: str, options: Any) -> MemoryBridge:
        given.append(options)
        return MemoryBridge(name)

    registry = Registry(())
    registry.add(BridgeType("lab", "", make, OPTIONS, contract=2))
    (tmp_path / "robot.yaml").write_text(WRITTEN.replace("FILES", files), encoding="utf-8")
    robot = load(tmp_path / "robot.yaml", registry.types)
    registry.create(robot.bridges["lab"]).close()
    inside = str(tmp_path.resolve())
    expected = (
        [text.replace("IN", inside) for text in expected] if files[0] == "[" else f"{inside}/a"
    )
    assert given[0] == {
        "file": f"{inside}/a/b",
        "url": f"{inside}/./tty".replace("/./", "/"),
        "name": "a/b",
        "files": expected,
        "parts": {"one": {"key": f"{inside}/../k", "on": True}},
    }
    assert robot.bridges["lab"].options["file"] == "a/b", "as it was written"


def test_without_a_file_paths_begin_where_the_program_runs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("HOME", "/home/lab")
    kind = BridgeType("lab", "", lambda name, _: MemoryBridge(name), OPTIONS, contract=2)
    assert kind.located({"file": "~/a", "files": "", "name": "~"}, "") == {
        "file": "/home/lab/a",
        "files": "",
        "name": "~",
    }


def test_a_path_that_is_left_out_is_its_default_in_the_folder() -> None:
    option = {"type": "string", "x-uoarm-path": True, "default": "."}
    schema = {"type": "object", "properties": {"folder": option, "other": {"default": "."}}}
    kind = BridgeType("lab", "", lambda name, _: MemoryBridge(name), schema, contract=2)
    assert kind.located({}, "/lab") == {"folder": "/lab"}
    assert kind.located({"folder": "idl"}, "/lab") == {"folder": "/lab/idl"}


def test_a_robot_in_memory_names_no_folder() -> None:
    assert loads(WRITTEN.replace("FILES", "[]")).bridges["lab"].folder == ""
