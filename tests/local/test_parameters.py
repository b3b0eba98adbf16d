"""Parameters are checked against the hints of what takes them: by `check`, by a plan, by a run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from attrs import evolve
from click.testing import CliRunner
from tests.local import talk

from uoarm import RobotManager
from uoarm.bridge import Registry
from uoarm.cli import main
from uoarm.config import inspect, loads
from uoarm.errors import BridgeError, FailureReason, ResolutionError
from uoarm.model import Role
from uoarm.testing import patience

LIMITS = {"least": 0.0, "most": 1.0}
MESSAGE = {"value": 7.0, "truth": True}
ROBOT = """\
version: 1
bridges: {python: {}}
functions:
  clip:
    components:
      - name: clip
        bridge: python
        parameters: {PARAMETERS}
        service: {endpoint: ["tests.local.typed_parts:clip"]}
"""


def test_parameters_are_what_their_hints_say() -> None:
    assert talk.call("clip", MESSAGE, limits=LIMITS) == {"value": 1.0, "truth": True}


def test_what_takes_the_message_depends_on_what_is_given() -> None:
    with talk.bridge() as made:
        first = talk.at("clip", Role.SERVICE, limits=LIMITS)
        second = evolve(talk.at("clip", Role.SERVICE, message=MESSAGE), component="other")
        assert made.call(first, MESSAGE, timeout=patience())["value"] == 1.0
        assert made.call(second, LIMITS, timeout=patience())["value"] == 1.0


@pytest.mark.parametrize(
    ("name", "given", "expected"),
    [
        ("clip", {"limits": LIMITS, "neer": 1.0}, "'neer': there is no .* did you mean 'near'"),
        ("clip", {"limits": LIMITS, "near": "far"}, "'near': expected a number, got \"far\""),
        ("clip", {"limits": {"least": 0.0}}, "'limits': the key .most. is missing"),
        ("Named", {"factor": 0}, "'factor': expected at least 1, got 0"),
        ("Named", {"other": 0}, "'other': there is no such parameter: there are factor"),
        ("double", {"other": 0}, "'other': there is no such parameter: it takes none"),
    ],
)
def test_wrong_parameters_are_reported_when_a_plan_is_made(
    name: str, given: Any, expected: str
) -> None:
    port = "left" if name == "Named" else "default"
    address = "tests.local.parts:double" if name == "double" else name
    with talk.bridge() as made:
        endpoint = talk.at(address, Role.INPUT, port, **given)
        with pytest.raises(BridgeError, match=expected) as caught:
            made.describe(endpoint)
        assert caught.value.reason is FailureReason.BAD_ENDPOINT
        with pytest.raises(BridgeError, match=expected):
            made.open_sink(endpoint, talk.ANY)


def test_a_robot_with_wrong_parameters_has_no_plan() -> None:
    robot = loads(ROBOT.replace("PARAMETERS", "limits: {least: 0.0, most: 1.0}, neer: 1.0"))
    with (
        RobotManager(robot) as manager,
        pytest.raises(ResolutionError, match="did you mean 'near'"),
    ):
        manager.resolve("clip")


@pytest.mark.parametrize(
    ("written", "place", "expected"),
    [
        ("limits: {least: 0, most: 1}, neer: 1.0", "parameters.neer", "did you mean 'near'"),
        ("limits: {least: 0, most: 1}, near: far", "parameters.near", "expected a number"),
        ("near: 1.0", "components[0]", "comes whole, in 'message'"),
    ],
)
def test_check_reports_the_place_of_a_wrong_parameter(
    tmp_path: Path, written: str, place: str, expected: str
) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(ROBOT.replace("PARAMETERS", written), encoding="utf-8")
    done = CliRunner().invoke(main, ["check", str(file)])
    assert done.exit_code == 3, done.output
    assert f"{place}: " in done.output
    assert expected in done.output


def test_check_reports_the_place_of_an_endpoint_that_can_be_nowhere(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    written = ROBOT.replace("PARAMETERS", "").replace(":clip", ":Named.left")
    file.write_text(written, encoding="utf-8")
    done = CliRunner().invoke(main, ["check", str(file)])
    assert done.exit_code == 3, done.output
    assert "endpoint: tests.local.typed_parts:Named.left is a method" in done.output


def test_check_takes_parameters_that_fit_and_modules_that_are_not_there(tmp_path: Path) -> None:
    types = Registry().types
    for name, written in (("here", "limits: {least: 0, most: 1}"), ("not_here", "what: ever")):
        file = tmp_path / "robot.yaml"
        text = ROBOT.replace("PARAMETERS", written)
        if name == "not_here":
            text = text.replace("tests.local.typed_parts", "no_such_module_here")
        file.write_text(text, encoding="utf-8")
        assert inspect(file, types, parameters=True).robot is not None


def test_check_finds_modules_beside_the_file(tmp_path: Path) -> None:
    (tmp_path / "beside.py").write_text("def clip(message, near: float): return message\n")
    file = tmp_path / "robot.yaml"
    text = ROBOT.replace("tests.local.typed_parts", "beside").replace("PARAMETERS", "near: far")
    file.write_text(text, encoding="utf-8")
    problems = inspect(file, Registry().types, parameters=True).problems
    assert [problem.sentence for problem in problems] == ['expected a number, got "far"']


def test_check_goes_on_past_a_module_that_ends_the_program(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text("raise SystemExit(0)\n")
    file = tmp_path / "robot.yaml"
    text = ROBOT.replace("tests.local.typed_parts", "script").replace("PARAMETERS", "near: far")
    file.write_text(text, encoding="utf-8")
    done = CliRunner().invoke(main, ["check", str(file)])
    assert "no errors" in done.output


def test_a_file_is_loaded_without_importing_its_components(tmp_path: Path) -> None:
    (tmp_path / "bursts.py").write_text("raise SystemExit('imported')\n")
    file = tmp_path / "robot.yaml"
    text = ROBOT.replace("tests.local.typed_parts", "bursts").replace("PARAMETERS", "near: far")
    file.write_text(text, encoding="utf-8")
    assert inspect(file, Registry().types).robot is not None
