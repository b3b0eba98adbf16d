"""`uoarm check`: components without hints, addresses that are none, what was not looked at."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from attrs import evolve
from click.testing import CliRunner, Result

from uoarm import RobotManager
from uoarm.bridge import Bridge, BridgeType, Description, Registry
from uoarm.cli import main
from uoarm.config import inspect
from uoarm.errors import ResolutionError
from uoarm.model import Endpoint, Options

COMPONENTS = """
from collections.abc import AsyncIterator, Iterator
from uoarm.local import structure
def bare(x):
    return x
def half(x: float):
    return x
def source():
    yield 1.0
async def asynchronous():
    yield 1.0
@structure(output={"type": "number"})
def declared():
    yield 1.0
class Machine:
    def __call__(self, x):
        return x
"""
ROBOT = """
version: 1
bridges: {{python: {{}}}}
functions:
  asked:
    components:
      - {{name: asked, bridge: python, {}}}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "check_bare.py").write_text(COMPONENTS, encoding="utf-8")
    return tmp_path


def checked(folder: Path, component: str, *more: str) -> Result:
    (folder / "robot.yaml").write_text(ROBOT.format(component), encoding="utf-8")
    return CliRunner().invoke(main, ["check", str(folder / "robot.yaml"), *more])


HINTS = [
    ('service: {endpoint: ["check_bare:bare"]}', "`x: float`, and", "request and reply"),
    ('service: {endpoint: ["check_bare:half"]}', "`-> float`, or", "reply"),
    ('output: {endpoint: ["check_bare:source"]}', "`-> Iterator[float]`, or", "structure"),
    ('output: {endpoint: ["check_bare:asynchronous"]}', "`-> AsyncIterator[float]`", "structure"),
    ('input: {endpoint: ["check_bare:Machine"]}', "`x: float`, or", "structure"),
]


@pytest.mark.parametrize(("component", "hint", "key"), HINTS)
def test_a_component_without_hints_is_said_with_the_hint_first(
    folder: Path, component: str, hint: str, key: str
) -> None:
    done = checked(folder, component)
    assert done.exit_code == 0, done.output
    warning = next(line for line in done.output.splitlines() if "no plan has it" in line)
    assert hint in warning
    assert warning.index(hint) < warning.index(f"declare {key} here")


@pytest.mark.parametrize("component", [component for component, _, _ in HINTS])
def test_a_request_says_the_hint_first_too(folder: Path, component: str) -> None:
    checked(folder, component)
    with (
        RobotManager.from_file(folder / "robot.yaml") as robot,
        pytest.raises(ResolutionError) as caught,
    ):
        robot.resolve("asked")
    output = str(caught.value)
    assert output.index("a type hint") < output.index("declare it in the configuration")


@pytest.mark.parametrize(
    "component",
    [
        'output: {endpoint: ["check_bare:declared"]}',
        'output: {endpoint: ["check_bare:source"], structure: {type: number}}',
        'service: {endpoint: ["check_bare:half"], reply: {type: number}}',
    ],
)
def test_what_is_declared_needs_no_hint(folder: Path, component: str) -> None:
    assert "no plan has it" not in checked(folder, component).output


def test_a_missing_colon_is_one_mistake(folder: Path) -> None:
    done = checked(folder, 'input: {endpoint: ["a.b"]}, output: {endpoint: ["a.b"]}')
    assert done.output.count("expected one string") == 1, done.output
    assert "did you mean 'a:b'? (the same stands in output)" in done.output
    assert "unavailable here" not in done.output


def test_a_space_after_the_colon_is_one_mistake(folder: Path) -> None:
    done = checked(folder, "service: {endpoint: [w: src]}")
    said = [line for line in done.output.splitlines() if "error" in line or "warning" in line]
    assert len(said) == 1, said
    assert 'write "w:src", without the space' in said[0]


def test_two_addresses_that_are_none_are_two_mistakes(folder: Path) -> None:
    done = checked(folder, 'input: {endpoint: ["a.b"]}, output: {endpoint: ["c"]}')
    assert done.output.count("expected one string") == 2, done.output


def test_it_ends_with_what_was_not_looked_at(folder: Path) -> None:
    robot = ROBOT.replace("{{python: {{}}}}", "{{python: {{}}, far: {{plugin: nowhere}}}}")
    robot += '      - {{name: two, bridge: far, output: {{endpoint: ["x"]}}}}\n'
    text = robot.format('output: {endpoint: ["check_bare:declared"]}')
    (folder / "robot.yaml").write_text(text, encoding="utf-8")
    arguments = ["check", str(folder / "robot.yaml")]
    last = CliRunner().invoke(main, arguments).output.splitlines()[-3:]
    assert last[0] == f"not looked at here, but by uoarm status {folder / 'robot.yaml'}:"
    assert last[1:] == [
        "  components of bridge far (nowhere): are they there, of such types?",
        "  do messages fit from component to component?",
    ]
    output = json.loads(CliRunner().invoke(main, [*arguments, "--json"]).stdout)
    assert output["unchecked"] == [line.strip() for line in last[1:]]


def test_what_a_plugin_doubts_is_a_warning_at_its_place(
    tmp_path: Path,
) -> None:
    """Of the addresses of its own bridges, offers included; a plugin that fails is one, too."""
    file = tmp_path / "robot.yaml"
    file.write_text(DOUBTED, encoding="utf-8")
    asked: list[object] = []

    def doubts(options: object, addresses: frozenset[tuple[str, ...]]) -> dict[object, str]:
        asked.append((options, addresses))
        return {("/a", "wrong"): "there is no type 'wrong'", (): "an option is odd"}

    types = {**Registry().types, "doubting": memory_type(doubts)}
    report = inspect(file, types, parameters=True, missing=str)
    assert asked == [({}, frozenset({("/a", "wrong"), ("/b",)}))]
    assert [(warning.path, warning.sentence) for warning in report.warnings] == [
        ("$.bridges.doubting", "an option is odd"),
        ("$.functions.f.components[0].output.endpoint", "there is no type 'wrong'"),
    ]

    def fails(options: object, addresses: object) -> dict[object, str]:
        raise RuntimeError("no way")

    report = inspect(file, {**types, "doubting": memory_type(fails)}, parameters=True, missing=str)
    [warning] = report.warnings
    assert warning.sentence.startswith("its addresses cannot be looked at here: RuntimeError: no")
    assert report.robot is not None


DOUBTED = """
version: 1
bridges: {doubting: {}, elsewhere: {plugin: doubting, host: {}}}
functions:
  f:
    components:
      - {name: a, priority: 2, bridge: doubting, output: {endpoint: [/a, wrong], structure: true}}
      - {name: c, bridge: elsewhere, output: {endpoint: [/c, wrong], structure: true}}
offer:
  doubting:
    f: {outputs: {default: {endpoint: [/b]}}}
"""


def test_a_plugin_is_asked_for_structures_by_the_options_of_a_port(tmp_path: Path) -> None:
    """Also one that has no parameters to be asked about."""
    file = tmp_path / "robot.yaml"
    text = DOUBTED.replace("[/a, wrong], structure: true", "[/a, wrong], options: {content: odd}")
    file.write_text(text, encoding="utf-8")
    asked: list[Endpoint] = []

    def describe(endpoint: Endpoint, options: object) -> Description:
        asked.append(endpoint)
        return Description(hint="say so there")

    types = {**Registry().types, "doubting": evolve(memory_type(None), describe=describe)}
    report = inspect(file, types, parameters=True, missing=str)
    [endpoint] = asked
    assert (endpoint.address, dict(endpoint.options)) == (("/a", "wrong"), {"content": "odd"})
    [warning] = report.warnings
    assert warning.hint == "say so there, or declare structure here; true is any"


def memory_type(doubts: Any) -> BridgeType:
    def create(name: str, options: Options) -> Bridge:
        raise NotImplementedError

    return BridgeType("doubting", "for tests", create, doubts=doubts, contract=2)


def test_each_kind_of_mistake_has_its_code_in_the_text(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text("version: 1\nfunctoins: {}\nbridges: {a: {plugin: nothing}}\n", "utf-8")
    listed = CliRunner().invoke(main, ["check", str(file), "--json"])
    codes = sorted({problem["error_code"] for problem in json.loads(listed.stdout)["problems"]})
    assert codes
    result = CliRunner().invoke(main, ["check", str(file)])
    last = result.stderr.splitlines()[-len(codes) :]
    assert last == [f"uoarm explain {code} says more" for code in codes]


def test_a_server_that_is_not_there_has_a_code_too() -> None:
    result = CliRunner().invoke(main, ["status", "--url", "ws://127.0.0.1:1/"])
    assert result.stderr.splitlines()[-1] == "uoarm explain UOA-402 says more"
