"""Every error code that is used is explained, and every one explained is used."""

from __future__ import annotations

import inspect
import json
import pkgutil
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest
from click.testing import CliRunner

import uoarm
from uoarm import RobotManager, config, errors
from uoarm.cli import main
from uoarm.error_codes import ERROR_CODES, explain, markdown
from uoarm.model import Reason, StatusEvent, to_json

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "errors.md"
WRITTEN = re.compile(r'"(UOA-\d{3})"')

ROBOT = """
version: 1
bridges: {}
functions:
  camera:
    components: [{name: front, bridge: plain, output: {endpoint: ["cameras:camera"]}}]
"""


def codes_in_the_source() -> set[str]:
    table = ROOT / "src" / "uoarm" / "error_codes.py"
    sources = (path for path in (ROOT / "src" / "uoarm").rglob("*.py") if path != table)
    return {code for path in sources for code in WRITTEN.findall(path.read_text(encoding="utf-8"))}


def classes() -> Iterator[type[errors.UoarmError]]:
    waiting = [errors.UoarmError]
    for kind in waiting:
        waiting.extend(kind.__subclasses__())
        yield kind


def test_every_code_that_is_used_is_explained_and_no_other() -> None:
    assert codes_in_the_source() == set(ERROR_CODES)


def test_a_code_is_one_entry_and_entries_stand_in_order() -> None:
    assert list(ERROR_CODES) == sorted(ERROR_CODES)
    assert len({entry.title for entry in ERROR_CODES.values()}) == len(ERROR_CODES)


def test_every_class_of_errors_has_a_code_that_is_explained() -> None:
    for module in pkgutil.walk_packages(uoarm.__path__, "uoarm."):
        if module.name in {"uoarm._aio", "uoarm.server.front_end", "uoarm.client"}:
            import_module(module.name)
    # Classes that tests define have the code of what they are derived from.
    assert {kind.error_code for kind in classes()} <= set(ERROR_CODES)


@pytest.mark.parametrize("reason", errors.FailureReason)
def test_every_reason_of_a_bridge_has_a_code_of_its_own(reason: errors.FailureReason) -> None:
    found = errors.BridgeError("it failed", reason).error_code
    others = {
        errors.BridgeError("it failed", other).error_code
        for other in errors.FailureReason
        if other is not reason
    }
    assert found in ERROR_CODES
    assert found not in others


def test_every_reason_for_which_a_command_is_refused_has_a_code_of_its_own() -> None:
    documented = re.findall(r"`([a-z-]+)`", inspect.getdoc(errors.CommandRefusedError) or "")
    found = [errors.CommandRefusedError("no", reason).error_code for reason in documented]
    assert len(set(found)) == len(documented) == 7
    assert set(found) <= {code for code in ERROR_CODES if code.startswith("UOA-6")}


def test_the_page_is_made_of_the_table() -> None:
    # uoarm explain --markdown > docs/errors.md
    assert PAGE.read_text(encoding="utf-8") == markdown()


@pytest.mark.parametrize("text", ["UOA-201", "uoa-201", "201", " UOA201 "])
def test_a_code_is_found_however_it_is_written(text: str) -> None:
    assert explain(text).code == "UOA-201"


def test_an_unknown_code_is_refused_with_those_there_are() -> None:
    result = CliRunner().invoke(main, ["explain", "UOA-999"])
    assert result.exit_code == 2
    assert "UOA-001 to UOA-810" in result.output


def test_the_command_prints_one_entry_or_all() -> None:
    one_entry = CliRunner().invoke(main, ["explain", "UOA-408"]).output
    assert "its limit" in one_entry
    assert "`timeout`" in one_entry
    listed = CliRunner().invoke(main, ["explain"]).output.splitlines()
    assert [line.split()[0] for line in listed] == list(ERROR_CODES)
    written = json.loads(CliRunner().invoke(main, ["explain", "408", "--json"]).output)
    assert written["code"] == "UOA-408"


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("version: [", "UOA-102"),
        ("", "UOA-102"),
        ("version: 1\nfunctoins: {}", "UOA-103"),
        (ROBOT, "UOA-104"),
    ],
)
def test_a_mistake_in_a_configuration_has_the_code_of_its_kind(text: str, code: str) -> None:
    with pytest.raises(errors.ConfigurationError) as caught:
        config.loads(text)
    assert caught.value.error_code == code


def test_mistakes_of_several_kinds_have_the_code_of_all(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(ROBOT + "more: 1\n", encoding="utf-8")
    problems = config.inspect(file).problems
    assert {problem.error_code for problem in problems} == {"UOA-103", "UOA-104"}
    with pytest.raises(errors.ConfigurationError) as caught:
        config.load(file)
    assert caught.value.error_code == "UOA-100"


def test_the_command_that_explains_stands_below_an_error(tmp_path: Path) -> None:
    result = CliRunner().invoke(main, ["list", "-f", str(tmp_path / "none.yaml")])
    assert result.output.splitlines()[-1] == "uoarm explain UOA-101 says more"


def test_a_refused_plan_has_a_code_and_each_reason_one(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(ROBOT.replace("bridges: {}", "bridges: {plain: {plugin: python}}"), "utf-8")
    with RobotManager.from_file(file) as robot, pytest.raises(errors.ResolutionError) as caught:
        robot.resolve("camera")
    assert caught.value.error_code == "UOA-201"
    [rejection] = to_json(caught.value.rejections)  # type: ignore[attr-defined]
    assert [reason["error_code"] for reason in rejection["reasons"]] == ["UOA-212"]


def test_an_event_of_a_failure_has_a_code_and_no_other_event() -> None:
    assert StatusEvent(1, 0.0, "component head_camera", "lost").error_code == "UOA-801"
    assert StatusEvent(1, 0.0, "component head_camera", "ok").error_code == ""
    assert to_json(StatusEvent(1, 0.0, "bridge ros", "lost"))["error_code"] == "UOA-803"
    assert Reason("it does not fit").error_code in ERROR_CODES
