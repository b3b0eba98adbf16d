"""`uoarm discover` and `uoarm suggest`, on bridges that see something and on one that cannot."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from tests.manager.test_discovery import ROBOT, make_lab

from uoarm import RobotManager
from uoarm.bridge import Bridge, BridgeType, Registry
from uoarm.cli import _discover, main
from uoarm.config import loads
from uoarm.errors import BridgeError

FILE = ROBOT.replace(", gone: {plugin: nowhere}", "")


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a configuration whose bridge sees a camera and a detector."""
    registry = Registry(())
    registry.add(BridgeType("memory", "", lambda *_: make_lab(), contract=2))
    monkeypatch.setattr(_discover, "Registry", lambda: registry)
    path = tmp_path / "robot.yaml"
    path.write_text(FILE, encoding="utf-8")
    return path


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def test_what_is_seen_is_shown_with_who_uses_it(file: Path) -> None:
    done = run("discover", "-f", file)
    assert done.exit_code == 0, done.output
    assert "lab  2 components" in done.output
    assert "output  head  used by head" in done.output


def test_as_json(file: Path) -> None:
    (lab,) = json.loads(run("discover", "-f", file, "--json").stdout)
    assert [component["name"] for component in lab["components"]] == ["detector", "head"]


def test_the_suggestion_can_be_pasted(file: Path) -> None:
    done = run("suggest", "-f", file)
    assert done.exit_code == 0, done.output
    functions = done.output[done.output.index("functions:\n") + len("functions:\n") :]
    assert set(loads(FILE + functions).functions) == {"camera", "detector"}


def test_the_suggestion_is_added_to_a_file(file: Path) -> None:
    before = file.read_text(encoding="utf-8")
    done = run("suggest", "--merge", file)
    assert (done.exit_code, "lines added" in done.output) == (0, True), done.output
    merged = file.read_text(encoding="utf-8")
    assert merged.startswith(before.rstrip("\n"))
    assert set(loads(merged).functions) == {"camera", "detector"}
    assert "has everything already" in run("suggest", "--merge", file).output
    assert file.read_text(encoding="utf-8") == merged


def test_a_file_that_cannot_be_written_is_known_before_bridges_look(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked: list[object] = []

    def discover(*_: object, **__: object) -> tuple[()]:
        looked.append(1)
        return ()

    monkeypatch.setattr(RobotManager, "discover", discover)
    done = run("suggest", "--merge", tmp_path / "absent" / "robot.yaml")
    assert (done.exit_code, looked) == (1, []), done.output
    assert "robot.yaml cannot be written: No such file" in done.stderr
    assert list(tmp_path.iterdir()) == [file]


def test_the_file_of_the_folder_is_meant_where_none_is_named(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(file.parent)
    assert "lab  2 components" in run("discover").output
    assert "# bridges: those of the configuration" in run("suggest").output
    assert "lab  memory  reachable\n" in run("status", "--bridges").output
    file.unlink()
    assert "lab" not in run("discover").output


def test_frameworks_are_shown_with_what_they_offer(file: Path) -> None:
    done = run("status", "--bridges", "-f", file)
    assert done.exit_code == 0, done.output
    assert "lab  memory  reachable\n" in done.output
    assert "  sees components: 2, ports: 3\n" in done.output
    assert "  for camera\n" in done.output
    printed = json.loads(run("status", "--bridges", "-f", file, "--json").stdout)
    (lab,) = [finding for finding in printed if finding["bridge"] == "lab"]
    assert (lab["is_configured"], lab["is_reachable"], lab["functions"]) == (True, True, ["camera"])
    assert "detector" in lab["components"]


def test_without_a_bridge_that_can_answer_the_exit_code_says_so(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(
        "version: 1\nbridges: {gone: {plugin: nowhere}}\nfunctions: {}\n", encoding="utf-8"
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Registry, "types", {})
        assert run("discover", "-f", path).exit_code == 4
        assert "there is no plugin 'nowhere'" in run("suggest", "-f", path).output


def test_what_is_different_is_reported_as_lines() -> None:
    lab = make_lab()
    with RobotManager(loads(FILE), bridges={"lab": lab}) as robot:
        before = robot.discover()
        lab.emitter("torch", {"type": "boolean"})
        after = robot.discover()
    printed = set(_discover.rows(after)) - set(_discover.rows(before))
    assert printed == {"lab  torch", "lab  torch  output  torch"}


EMPTY = ["", "\n", "# my robot\n", "---\n# my robot\n"]


@pytest.fixture
def alone(file: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return where a first configuration goes; one of the plugins that need none sees a lab."""
    registry = Registry(())
    registry.add(BridgeType("lab", "", lambda *_: make_lab(), contract=2))
    monkeypatch.setattr(_discover, "Registry", lambda: registry)
    monkeypatch.chdir(file.parent)
    file.unlink()
    return file


@pytest.mark.parametrize("empty", EMPTY)
@pytest.mark.parametrize("named", [(), ("robot.yaml",), ("-f", "robot.yaml")])
def test_a_file_that_the_shell_has_just_made_says_nothing_yet(
    alone: Path, empty: str, named: tuple[str, ...]
) -> None:
    alone.write_text(empty, encoding="utf-8")
    done = run("suggest", *named)
    assert done.exit_code == 0, done.output
    assert set(loads(done.stdout).functions) >= {"head", "detector"}
    assert "lab" in loads(done.stdout).bridges
    assert run("discover", *named).exit_code == 0


@pytest.mark.parametrize("empty", [None, *EMPTY])
def test_merging_into_a_file_that_is_not_there_makes_it(alone: Path, empty: str | None) -> None:
    if empty is not None:
        alone.write_text(empty, encoding="utf-8")
    done = run("suggest", "--merge", "robot.yaml")
    assert (done.exit_code, "lines added" in done.output) == (0, True), done.output
    made = alone.read_text(encoding="utf-8")
    assert "lab" in loads(made).bridges
    assert made.startswith((empty or "").strip())
    again = run("suggest", "--merge", "robot.yaml")
    assert "it has everything already" in again.output
    assert alone.read_text(encoding="utf-8") == made


def test_a_new_file_would_not_have_what_another_one_has(file: Path, tmp_path: Path) -> None:
    new = tmp_path / "new.yaml"
    done = run("suggest", "-f", file, "--merge", new)
    assert (done.exit_code, new.exists()) == (2, False)
    assert f"merge into {file}" in " ".join(done.output.split())


def test_a_suggestion_of_nothing_is_a_configuration(
    alone: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_discover, "Registry", lambda: Registry(()))
    alone.write_text(run("suggest").stdout, encoding="utf-8")
    assert run("check", alone).exit_code == 0


def test_of_what_no_file_names_is_said_what_to_write_and_nothing_else(
    alone: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> Bridge:
        raise BridgeError("nothing listens there")

    registry = Registry(())
    url = {"type": "string", "examples": ["lab://127.0.0.1"]}
    schema = {"type": "object", "properties": {"url": url}, "required": ["url"]}
    registry.add(BridgeType("lab", "", fail, bridge_options=schema, contract=2))
    registry.add(BridgeType("absent", "", fail, contract=2))
    monkeypatch.setattr(_discover, "Registry", lambda: registry)
    done = run("suggest", "--merge", "mine.yaml")
    line = 'lab: {plugin: lab, options: {"url": "lab://127.0.0.1"}}'
    assert done.stderr == (
        "to have more looked at, write under `bridges` of mine.yaml, with your own values:\n"
        f"  {line}\n"
    )
    alone.write_text(f"version: 1\nbridges:\n  {line}\nfunctions: {{}}\n", encoding="utf-8")
    assert run("suggest").stderr == "lab: nothing listens there\n"
