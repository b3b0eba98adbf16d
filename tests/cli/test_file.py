"""The configuration: every command that has one takes it as a word, with -f, or as a variable."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from importlib.metadata import entry_points
from pathlib import Path
from textwrap import dedent

import click
import pytest
from click.testing import CliRunner, Result
from tests.cli.commands import members
from tests.processes import run_program

from uoarm.bridge import Registry
from uoarm.cli import _discover, main

ROBOT = """
version: 1
bridges: {python: {}}
functions:
  greeting:
    components:
      - {name: greeter, bridge: python, service: {endpoint: ["file_greeting:greet"]}}
  ticks:
    components:
      - {name: ticker, bridge: python, output: {endpoint: ["file_greeting:ticks"]}}
"""
COMPONENTS = """
from collections.abc import Iterator
from typing import TypedDict
class Text(TypedDict):
    text: str
def greet(asked: Text) -> Text:
    return {"text": f"hello {asked['text']}"}
def ticks() -> Iterator[Text]:
    yield {"text": "tick"}
"""
SERVING = {"serve", "up", "offer", "host", "apply"}  # they need a server or go on
# What the one finds may be other a second later; the other never writes over its file.
ASKED_EACH_TIME = {"doctor", "record"}


def commands(group: click.Group) -> Iterator[click.Command]:
    for command in members(group).values():
        if isinstance(command, click.Group):
            yield from commands(command)
        elif any(parameter.name == "file" for parameter in command.params):
            yield command


CONFIGURED = {str(command.name): command for command in commands(main)}
WORDS = {"resolve": ["ticks"], "request": ["ticks"], "call": ["greeting", '{"text": "you"}']}
MORE = {"types": ["--python"], "request": ["-n", "1"], "lock": ["--lock", "made.lock"]}


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a configuration in another folder than the current one, which has none."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    (folder / "file_greeting.py").write_text(COMPONENTS, encoding="utf-8")
    (folder / "lab.yaml").write_text(ROBOT, encoding="utf-8")
    points = [entry for entry in entry_points(group="uoarm.bridges") if entry.name == "python"]
    monkeypatch.setattr(_discover, "Registry", lambda: Registry(points))  # no other frameworks
    return Path("elsewhere/lab.yaml")


def run(*arguments: str | Path, env: dict[str, str] | None = None) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments], env=env)


def test_every_command_that_reads_a_configuration_is_among_them() -> None:
    expected = {"check", "list", "resolve", "status", "request", "call", "discover", "suggest"}
    expected |= {
        "lock",
        "types",
        "offer",
        "serve",
        "apply",
        "up",
        "host",
        "bridges",
        "doctor",
        "record",
    }
    assert CONFIGURED.keys() == expected


@pytest.mark.parametrize("name", sorted(CONFIGURED.keys() - SERVING - ASKED_EACH_TIME))
def test_each_way_of_naming_it_does_the_same(file: Path, name: str) -> None:
    words, more = WORDS.get(name, []), MORE.get(name, [])
    ways = [
        run(name, *words, file, *more),
        run(name, file, *words, *more),
        run(name, *words, "-f", file, *more),
        run(name, *words, *more, env={"UOARM_CONFIG": str(file)}),
        run(name, *words, file, *more, env={"UOARM_CONFIG": "other.yaml"}),
    ]
    exits = [(way.exit_code, way.stdout) for way in ways]
    assert exits == [exits[0]] * len(ways), [way.output for way in ways]
    assert exits[0][0] == 0, ways[0].output


@pytest.mark.parametrize("name", sorted(CONFIGURED))
def test_naming_it_twice_is_refused(file: Path, name: str) -> None:
    words = WORDS.get(name, [])
    done = run(name, *words, file, "-f", "other.yaml")
    assert done.exit_code == 2, done.output
    assert f"the configuration is named twice: {file} and -f other.yaml" in done.output


@pytest.mark.parametrize("name", ["record", "host"])
def test_of_two_files_among_any_number_of_words_none_is_left_out(file: Path, name: str) -> None:
    done = run(name, "ticks", file, "other.yaml")
    assert done.exit_code == 2, done.output
    assert f"the configuration is named twice: {file} and other.yaml" in done.output


@pytest.mark.parametrize("name", sorted(CONFIGURED.keys() - {"doctor"}))
@pytest.mark.parametrize("kind", ["a folder", "not a regular file"])
def test_what_is_no_file_is_a_configuration_that_cannot_be_read(
    tmp_path: Path, name: str, kind: str
) -> None:
    """A FIFO could be waited for without end."""
    place = tmp_path / "robot.yaml"
    place.mkdir() if kind == "a folder" else os.mkfifo(place)
    more = {
        "record": ["-o", "run.mcap"],
        "types": ["--python"],
        "host": ["python", "--xmlrpc", "0"],
    }
    done = run(name, *WORDS.get(name, []), *more.get(name, []), place)
    assert done.exit_code == 3, done.output
    assert f"{place}: the file cannot be read: it is {kind}" in done.output


@pytest.mark.parametrize("words", [["check"], ["check", "-f"], ["suggest", "--merge"]])
def test_what_this_user_may_not_read_is_a_file_that_cannot_be_read(
    tmp_path: Path, words: list[str]
) -> None:
    """Root may read it all the same, but for the capabilities that are dropped here."""
    (tmp_path / "robot.yaml").write_text(ROBOT, encoding="utf-8")
    (tmp_path / "locked.yaml").touch(mode=0)
    drop = """
        import ctypes, os, sys
        for capability in (1, 2):  # CAP_DAC_OVERRIDE and CAP_DAC_READ_SEARCH of linux/capability.h
            ctypes.CDLL(None).prctl(24, capability, 0, 0, 0)  # PR_CAPBSET_DROP
        os.execv(sys.executable, [sys.executable, *sys.argv[1:]])
    """
    run_main = ["-c", "from uoarm.cli import main; main()", *words, "locked.yaml"]
    done = run_program(sys.executable, "-c", dedent(drop), *run_main, cwd=tmp_path)
    assert done.returncode == 3, done.stderr
    expected = "error: locked.yaml: the file cannot be read: Permission denied\n"
    assert done.stderr.startswith(expected), done.stderr


@pytest.mark.parametrize("words", [["lock"], ["types", "--python"]])
@pytest.mark.parametrize("place", [".", "/"])
def test_no_lock_is_sought_beside_a_folder(words: list[str], place: str) -> None:
    done = run(*words, place)
    assert (done.exit_code, done.stdout) == (3, "")
    assert "the file cannot be read: it is a folder" in done.stderr


@pytest.mark.parametrize("name", [b"loop.yaml", b"\xff.yaml"])
def test_a_server_says_of_any_name_why_its_file_cannot_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: bytes
) -> None:
    """The state of its robot has a place by the name, links followed."""
    monkeypatch.chdir(tmp_path)
    Path("loop.yaml").symlink_to("loop.yaml")
    done = run("serve", os.fsdecode(name), "--port", "0")
    assert done.exit_code == 3, done.output
    assert "the file cannot be read: " in done.stderr


@pytest.mark.parametrize("name", ["resolve", "request", "call"])
def test_the_file_alone_is_no_function(file: Path, name: str) -> None:
    done = run(name, file)
    assert (done.exit_code, "Missing argument 'NAME'" in done.output) == (2, True), done.output


def test_a_file_of_another_ending_is_the_last_word(file: Path) -> None:
    robot = file.rename(file.with_suffix(".conf"))
    done = run("call", "greeting", '{"text": "you"}', robot)
    assert done.stdout == '{"text": "hello you"}\n', done.output


@pytest.mark.parametrize("name", ["check", "list", "status", "resolve", "request", "call", "serve"])
@pytest.mark.usefixtures("file")
def test_where_none_is_there_it_is_said_what_to_do(name: str) -> None:
    done = run(name, *WORDS.get(name, []))
    assert done.exit_code == 3, done.output
    assert "robot.yaml: the file cannot be read: No such file" in done.output
    assert "uoarm suggest > robot.yaml" in done.output
    assert "FILE names another" in done.output


@pytest.mark.parametrize("name", ["list", "status"])
def test_a_configuration_without_functions_is_no_empty_answer(name: str, tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text("version: 1\nbridges: {python: {}}\nfunctions: {}\n", encoding="utf-8")
    done = CliRunner().invoke(main, [name, str(file)])
    assert (done.exit_code, done.stdout.strip(), done.stderr) == (0, "", "no functions\n")
    assert CliRunner().invoke(main, [name, str(file), "--json"]).stderr == ""
