"""The lock: the same plans give the same text; what a difference breaks needs no robot."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from uoarm._lock import LockOutcome, compare, read_lock, write_lock
from uoarm.cli import main
from uoarm.errors import ConfigurationError

COMPONENTS = """
from collections.abc import Iterator
from typing import Annotated, TypedDict


class Reading(TypedDict):
    celsius: Annotated[float, {{"x-unit": "{unit}"}}]
{more}

class Taken(TypedDict):
    celsius: Annotated[float, {{"x-unit": "Cel"}}]
    hot: bool


class Alarm(TypedDict):
    hot: bool


def thermometer() -> Iterator[Annotated[Reading, {{"x-type": "Reading"}}]]:
    yield {{"celsius": 20.0, "hot": False}}


def too_hot(reading: Taken) -> Alarm:
    return {{"hot": True}}
"""
ROBOT = """
version: 1
bridges: {python: {}}
functions:
  temperature:
    components:
      - {name: thermometer, bridge: python, output: {endpoint: ["kitchen:thermometer"]}}
  fireAlarm:
    components:
      - name: too_hot
        bridge: python
        input: {from: temperature, endpoint: ["kitchen:too_hot"]}
        output: {endpoint: ["kitchen:too_hot"]}
"""
HOT = "    hot: bool\n"


def robot(folder: Path, unit: str = "Cel", more: str = HOT) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "kitchen.py").write_text(COMPONENTS.format(unit=unit, more=more), encoding="utf-8")
    (folder / "robot.yaml").write_text(ROBOT, encoding="utf-8")
    return folder


def run(folder: Path, *arguments: str) -> Result:
    files = ["-f", str(folder / "robot.yaml"), "--lock", str(folder / "robot.lock")]
    return CliRunner().invoke(main, ["lock", *files, *arguments])


def locked(folder: Path, **more: str) -> Path:
    done = run(robot(folder, **more))
    assert done.exit_code == 0, done.output
    return folder / "robot.lock"


def test_a_lock_is_the_same_text_for_the_same_plans_and_fits_itself(tmp_path: Path) -> None:
    one, other = locked(tmp_path / "a"), locked(tmp_path / "b")
    assert one.read_bytes() == other.read_bytes()
    checked = run(tmp_path / "a", "--check")
    assert checked.exit_code == 0
    assert "breaks: 0" in checked.output
    data = json.loads(one.read_text())
    (key,) = data["functions"]["fireAlarm"]["edges"]
    edge = data["edges"][key]
    assert (edge["producer"], edge["consumer"], edge["meaning"]) == (
        "thermometer", "too_hot", "stated",
    )  # fmt: skip


def test_a_part_of_many_plans_is_written_once(tmp_path: Path) -> None:
    """Each plan of a chain has all of those before it."""

    def size(length: int) -> int:
        names = ["temperature", *(f"f{number}" for number in range(length))]
        chain = "".join(
            f"  {name}:\n    components:\n      - {{name: c_{name}, bridge: python, "
            f'input: {{from: {before}, endpoint: ["kitchen:pass_on"]}}, '
            f'output: {{endpoint: ["kitchen:pass_on"]}}}}\n'
            for before, name in pairwise(names)
        )
        folder = robot(tmp_path / str(length))
        with (folder / "kitchen.py").open("a") as code:
            code.write("\n\ndef pass_on(reading: Reading) -> Reading:\n    return reading\n")
        file = folder / "robot.yaml"
        file.write_text(file.read_text() + chain)
        assert run(folder).exit_code == 0
        text = (folder / "robot.lock").read_text()
        lock = read_lock(folder / "robot.lock")
        assert write_lock(lock) == text
        assert len(lock.functions[names[-1]].parts) == length + 1
        return text.count('"plugin"')

    assert size(20) - size(10) == 10


@pytest.mark.parametrize("suffix", [".json", ".schema"])
def test_another_unit_breaks_the_edge_and_the_line_that_mends_it_is_shown(
    tmp_path: Path, suffix: str
) -> None:
    locked(tmp_path / "a")
    schemas = tmp_path / "schemas"
    schemas.mkdir()
    fields = {"celsius": {"type": "number", "x-unit": "[degF]"}, "hot": {"type": "boolean"}}
    schema = {
        "type": "object", "properties": fields, "required": [*fields],
        "additionalProperties": False,
    }  # fmt: skip
    (schemas / f"Reading{suffix}").write_text(json.dumps(schema))
    done = run(tmp_path / "a", "--check", "--against", str(schemas))
    assert done.exit_code == 1
    assert "thermometer.default -> too_hot.default: fits with a map: celsius: " in done.output
    assert "map: {celsius: {from: celsius, scale: 0.5555555555555556, offset: -17.7" in done.output
    # Applications that ask for the temperature take it for degrees Celsius.
    assert "temperature: output.default: breaks: celsius" in done.output


@pytest.mark.parametrize("form", ["text", "json", "github"])
def test_a_field_that_went_breaks_and_says_so_in_each_form(tmp_path: Path, form: str) -> None:
    locked(tmp_path / "a")
    before = read_lock(tmp_path / "a" / "robot.lock")
    after = json.loads((tmp_path / "a" / "robot.lock").read_text())
    for item in after["structures"].values():
        if "celsius" in item["structure"]["properties"] and item["structure"]["required"]:
            item["structure"]["required"] = ["hot"]
    # The producer's structure may do without the field now; its consumer's still demands it.
    assert before.functions["fireAlarm"].parts
    ports = after["parts"]["thermometer"]["ports"]
    structure = after["structures"][ports["output.default"]]
    after["structures"]["changed"] = structure
    ports["output.default"] = "changed"
    other = tmp_path / "other.lock"
    kept = json.loads((tmp_path / "a" / "robot.lock").read_text())["structures"]
    after["structures"] = {**after["structures"], **kept, "changed": structure}
    other.write_text(json.dumps(after))
    done = run(tmp_path / "a", "--check", "--against", str(other), "--format", form)
    assert done.exit_code == 1, done.output
    if form == "json":
        findings = json.loads(done.stdout)["findings"]
        assert {finding["outcome"] for finding in findings} == {"fits", "breaks"}
    else:
        assert "thermometer.default -> too_hot.default: breaks" in done.output
        # Who asks for temperature got the field always; now not.
        assert "temperature: output.default: breaks" in done.output
    assert done.output.startswith("::error") is (form == "github")


def test_outputs_may_narrow_and_components_may_not_go(tmp_path: Path) -> None:
    locked(tmp_path / "a")
    lock = read_lock(tmp_path / "a" / "robot.lock")
    narrower: Any = json.loads((tmp_path / "a" / "robot.lock").read_text())
    for structure in narrower["structures"].values():
        fields = structure["structure"]["properties"]
        if "celsius" in fields and structure["structure"].get("required"):
            fields["celsius"] = {**fields["celsius"], "minimum": 0}
    path = tmp_path / "narrower.lock"
    path.write_text(json.dumps(narrower))
    outcomes = {finding.subject: finding.outcome for finding in compare(lock, read_lock(path))}
    assert outcomes["output.default"] is LockOutcome.FITS
    narrower["functions"].pop("temperature")
    narrower["functions"].pop("fireAlarm")
    path.write_text(json.dumps(narrower))
    gone = list(compare(lock, read_lock(path)))
    assert {finding.outcome for finding in gone} == {LockOutcome.BREAKS}
    assert "no output.default of a component 'thermometer'" in " ".join(
        finding.sentence for finding in gone
    )


NO_PORT = (
    '{"version": 2, "functions": {"f": {"parts": ["a"]}}, "parts": {"a": {"component": "a",'
    ' "function": "f", "bridge": "b", "plugin": "p", "ports": {"x": "gone"}}}, "structures": {}}'
)
NO_FUNCTION = '{"version": 2, "functions": {"f": 3}, "structures": {}}'
NO_PART = '{"version": 2, "functions": {"f": {"parts": ["a"]}}, "structures": {}}'


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"version": 1}', NO_FUNCTION, NO_PART, NO_PORT])
def test_what_is_no_lock_is_refused_with_its_name(tmp_path: Path, text: str) -> None:
    path = tmp_path / "robot.lock"
    path.write_text(text)
    with pytest.raises(ConfigurationError, match=r"robot\.lock"):
        read_lock(path)
    assert run(robot(tmp_path), "--check").exit_code == 3


@pytest.mark.parametrize(
    ("octets", "text"),
    [
        (b"functions: {}", "expected a lock, as `uoarm lock` writes it, got what is no JSON: "),
        (b'{"a": 1}', "expected a lock, as `uoarm lock` writes it, got other JSON"),
        (b'{"version": 7}', "expected a lock of version 2, got version 7"),
        (b"{\xff", "the file is not UTF-8: byte 2 cannot be decoded (save it as UTF-8)"),
        (None, "the file cannot be read: it is a folder"),
    ],
)
def test_of_a_file_that_is_no_lock_it_is_said_what_was_expected(
    tmp_path: Path, octets: bytes | None, text: str
) -> None:
    path = tmp_path / "robot.lock"
    path.mkdir() if octets is None else path.write_bytes(octets)
    done = run(robot(tmp_path), "--check")
    assert (done.exit_code, f"error: {path}: {text}" in done.stderr) == (3, True), done.output


def test_a_lock_alone_does_not_stand_for_a_configuration_that_is_not_there(tmp_path: Path) -> None:
    path = locked(tmp_path)
    file = tmp_path / "robot.yaml"
    file.unlink()
    words = ["-f", str(file), "--check", "--against", str(path)]
    done = CliRunner().invoke(main, ["lock", *words])
    assert (done.exit_code, "robot.yaml: the file cannot be read" in done.stderr) == (3, True)


def test_a_function_without_a_plan_is_locked_as_refused(tmp_path: Path) -> None:
    done = run(robot(tmp_path, unit="s"))
    assert done.exit_code == 1
    assert "fireAlarm has no plan" in done.output
    assert read_lock(tmp_path / "robot.lock").functions["fireAlarm"].refused


def test_a_schema_that_is_no_json_is_named(tmp_path: Path) -> None:
    locked(tmp_path / "a")
    (tmp_path / "a" / "Order.schema").write_text('{"title": "Order",}')
    checked = run(tmp_path / "a", "--check", "--against", str(tmp_path / "a"))
    assert checked.exit_code == 3
    assert "Order.schema: expected JSON, got what is no JSON" in checked.output


def test_a_type_that_is_defined_in_an_older_draft_is_compared_in_the_newest(tmp_path: Path) -> None:
    locked(tmp_path / "a")
    (known,) = (
        structure.structure
        for structure in read_lock(tmp_path / "a" / "robot.lock").structures.values()
        if "Reading" in str(structure)
    )
    for draft, exit_code in (("draft-07", 0), ("draft-03", 3)):
        old = {"$schema": f"http://json-schema.org/{draft}/schema#", **known}
        (tmp_path / "a" / "Reading.schema").write_text(json.dumps(old))
        checked = run(tmp_path / "a", "--check", "--against", str(tmp_path / "a"))
        assert checked.exit_code == exit_code, checked.output
    assert "Reading.schema: #/$schema: expected draft 04" in checked.output


def test_a_type_that_two_files_define_otherwise_is_not_guessed(tmp_path: Path) -> None:
    locked(tmp_path / "a")
    new = tmp_path / "new"
    for folder, unit in (("old", "Cel"), ("now", "[degF]")):
        (new / folder).mkdir(parents=True)
        (new / folder / "Reading.schema").write_text(json.dumps({"x-unit": unit}))
        (new / folder / "Else.schema").write_text(json.dumps({"x-unit": unit}))
    checked = run(tmp_path / "a", "--check", "--against", str(new))
    assert checked.exit_code == 3
    names = [str(new / folder / "Reading.schema") for folder in ("now", "old")]
    assert f"{names[0]} and {names[1]} define Reading otherwise" in checked.output
    (new / "old" / "Reading.schema").unlink()
    assert run(tmp_path / "a", "--check", "--against", str(new)).exit_code == 1


@pytest.mark.parametrize("words", [("lock", "--lock"), ("types", "--python", "-o")])
def test_no_configuration_is_written_over(tmp_path: Path, words: tuple[str, ...]) -> None:
    file = str(robot(tmp_path) / "robot.yaml")
    done = CliRunner().invoke(main, [*words, file, "-f", file])
    assert done.exit_code == 3
    assert f"{file}: it may be a configuration, and is not written over" in done.stderr
    assert Path(file).read_text(encoding="utf-8") == ROBOT
