"""A lock is compared with what plugins read; what they cannot read never passes for unchanged."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from uoarm._lock import _compare
from uoarm.cli import main
from uoarm.errors import ConfigurationError
from uoarm.plugins import DefinitionFormat, Definitions, hookimpl

BEFORE = {"type": "object", "properties": {"width": {"type": "number"}}, "required": ["width"]}


def read(folder: Path) -> Definitions:
    schemas: dict[str, Mapping[str, Any]] = {}
    problems: dict[str, str] = {}
    for path in folder.rglob("*.fields"):
        text = path.read_text()
        if text == "absent":
            raise ConfigurationError("the parser is not installed: install uoarm-mine[parser]")
        if text == "broken":
            raise RuntimeError("out of luck")
        if text == "?":
            problems[f"mine/{path.stem}"] = "line 1 is no field"
        else:
            fields = {name: {"type": "number"} for name in text.split()}
            schemas[f"mine/{path.stem}"] = {
                "type": "object", "properties": fields, "required": [*fields],
            }  # fmt: skip
    return Definitions(schemas, problems)


@hookimpl
def uoarm_definition_formats() -> list[DefinitionFormat]:
    return [DefinitionFormat("lists of fields", frozenset({".fields"}), read, contract=1)]


@pytest.fixture(autouse=True)
def plugins(monkeypatch: pytest.MonkeyPatch) -> list[EntryPoint]:
    points = [EntryPoint("mine", __name__, "uoarm.definitions")]
    monkeypatch.setattr(_compare, "installed", lambda group: points)
    return points


def check(folder: Path, **files: str) -> Result:
    part = {
        "component": "gripper", "function": "grip", "bridge": "b", "plugin": "mine",
        "ports": {"output.default": "f"},
    }  # fmt: skip
    function = {"parts": ["gripper"], "edges": [], "passed_over": {}, "refused": ""}
    structures = {"f": {"native_type": "mine/Grip", "structure": BEFORE}}
    lock = {
        "version": 2, "functions": {"grip": function}, "structures": structures,
        "parts": {"gripper": part},
    }  # fmt: skip
    (folder / "robot.lock").write_text(json.dumps(lock))
    against = folder / "definitions"
    against.mkdir(exist_ok=True)
    for name, text in files.items():
        (against / name.replace("__", ".")).write_text(text)
    return compared(folder, "--against", str(against))


def compared(folder: Path, *words: str) -> Result:
    lock = ["lock", "--lock", str(folder / "robot.lock"), "--check"]
    return CliRunner().invoke(main, [*lock, *words])


def test_what_a_plugin_reads_is_compared(tmp_path: Path) -> None:
    done = check(tmp_path, Grip__fields="opening", Other__fields="?")
    assert done.exit_code == 1, done.output
    assert "grip: output.default: breaks: the field 'width' is required" in done.output


def test_what_is_the_same_fits(tmp_path: Path) -> None:
    done = check(tmp_path, Grip__fields="width", Other__json="{}")
    assert done.exit_code == 0, done.output


def test_what_lies_beside_a_definition_is_no_schema(tmp_path: Path) -> None:
    schema = json.dumps({"title": "mine/Grip", "type": "string"})
    done = check(tmp_path, Width__fields="width", Width__json=schema)
    assert done.exit_code == 0, done.output
    done = check(tmp_path, Width__json=schema, Width__fields="", Other__json=schema)
    assert done.exit_code == 1, done.output


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ({"Grip__fields": "?"}, "the definition of mine/Grip cannot be read: line 1 is no field"),
        ({"Grip__fields": "absent"}, "install uoarm-mine[parser]"),
        ({"Grip__fields": "broken"}, "lists of fields cannot be read: RuntimeError: out of luck"),
        ({"Grip__msg": "int8 a", "Other__json": "{}"}, "uoarm-ros2[definitions]"),
        ({"Grip__idl": "struct Grip {};", "Other__json": "{}"}, "uoarm-ros2[definitions]"),
        (
            {},
            "expected 1 to 20,000 files of *.action, *.fields, *.idl, *.json, *.msg",
        ),
    ],
)
def test_what_cannot_be_read_is_an_error(tmp_path: Path, files: dict[str, str], said: str) -> None:
    done = check(tmp_path, **files)
    assert done.exit_code == 3, done.output
    assert said in done.output


def test_a_plugin_that_cannot_be_loaded_is_an_error(
    tmp_path: Path, plugins: list[EntryPoint]
) -> None:
    plugins.append(EntryPoint("gone", "no_such_module", "uoarm.definitions"))
    done = check(tmp_path, Grip__fields="width")
    assert done.exit_code == 3, done.output
    assert "the plugin gone cannot be used: ModuleNotFoundError" in done.output


def test_what_the_definitions_do_not_have_is_reported(tmp_path: Path) -> None:
    done = check(tmp_path, Other__fields="width")
    assert done.exit_code == 0, done.output
    assert "and taken to be as they were: mine/Grip" in done.stderr


def test_an_environment_is_compared_by_what_is_installed_in_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UOARM_HOME", str(tmp_path))
    check(tmp_path, Grip__fields="width")
    share = tmp_path / "environments" / "newer" / "share"
    share.mkdir(parents=True)
    (share / "Grip.fields").write_text("opening")
    # What a library of it has for itself stands for no type.
    (share / "mine.json").write_text(json.dumps({"title": "mine/Grip", **BEFORE}))
    done = compared(tmp_path, "--environment", "newer")
    assert done.exit_code == 4, done.output
    assert "the environment 'newer' is incomplete: uoarm env remove newer" in done.output
    none = compared(tmp_path, "--environment", "none")
    assert "there is no environment 'none' (there is none)" in none.output
    (share.parent / "uoarm-environment.json").write_text('{"requirements": []}')
    done = compared(tmp_path, "--environment", "newer")
    assert done.exit_code == 1, done.output
    assert "grip: output.default: breaks: the field 'width' is required" in done.output
    assert compared(tmp_path, "--environment", "none").exit_code == 4
    both = compared(tmp_path, "--environment", "newer", "--against", str(tmp_path))
    assert both.exit_code == 2
