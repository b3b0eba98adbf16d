"""Options that a plugin declares once: one line is all that an option takes."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import attrs
import pytest
from attrs import frozen
from hypothesis import given
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from uoarm.bridge import (
    BridgeOptions,
    BridgeType,
    DeclaredOptions,
    EndpointOptions,
    PeerOptions,
    Registry,
    TlsOptions,
    address_check,
    option,
    options_table,
)
from uoarm.config import completed_schema, inspect, published_schema
from uoarm.errors import BridgeError, ConfigurationError, FailureReason
from uoarm.local import PythonOptions
from uoarm.model import BridgeSpec, Endpoint, Role
from uoarm.testing import MemoryBridge


@frozen
class Lamp(EndpointOptions):
    """Options of a member."""

    colour: str = option("white", {"enum": ["white", "red"]}, "of the light", required=True)
    level: int = option(5, {"type": "integer", "minimum": 0, "maximum": 9}, "of brightness")


@frozen
class Options(EndpointOptions):
    """Options of a port."""

    period: float = option(0.5, {"type": "number", "exclusiveMinimum": 0}, "of a look", unit="s")
    label: str | None = option(None, {"type": "string"}, "that people see")
    lamp: Lamp | None = option(None, Lamp, "that shines")


KIND = BridgeType("shed", "a shed", MemoryBridge, endpoint_options=Options, contract=2)
FILE = """version: 1
bridges: {shed: {}}
functions:
  door:
    components:
      - name: door
        bridge: shed
        output:
          endpoint: [door]
          structure: {type: integer}
          options:
            OPTIONS
"""


def written(folder: Path, options: str) -> Path:
    file = folder / "robot.yaml"
    file.write_text(FILE.replace("OPTIONS", options), encoding="utf-8")
    return file


def test_what_is_left_out_has_its_default() -> None:
    assert Options.of({}) == Options(0.5, None, None)
    assert Options.of({"lamp": {"colour": "red"}}) == Options(lamp=Lamp("red", 5))


def test_every_mistake_is_named_with_what_was_expected() -> None:
    wrong = {"perod": 1, "label": 3, "lamp": {"level": 12}}
    with pytest.raises(ValueError, match="perod") as caught:
        Options.of(wrong)
    for sentence in (
        'option $.perod: unknown key "perod" (did you mean "period"?)',
        "option $.label: expected text, got 3",
        "option $.lamp.level: expected at most 9, got 12",
        'option $.lamp: the key "colour" is missing',
    ):
        assert sentence in str(caught.value)


@frozen
class Switch(EndpointOptions):
    """An option of a choice that is not only of texts."""

    on: bool | str = option(False, {"enum": [False, True, "keep"]}, "whether it is on")


def test_a_choice_is_written_as_in_a_file() -> None:
    assert Switch.of({"on": "keep"}).on == "keep"
    with pytest.raises(
        ValueError, match=r"option \$\.on: expected false, true or keep, got \"yes\""
    ):
        Switch.of({"on": "yes"})


def test_an_endpoint_is_named_in_the_error() -> None:
    endpoint = Endpoint("shed", "door", Role.OUTPUT, ("door",), options={"period": 0})
    with pytest.raises(BridgeError, match=r"bridge 'shed': .*door.*expected more than 0") as caught:
        Options.of_endpoint(endpoint)
    assert caught.value.reason is FailureReason.BAD_ENDPOINT


def test_the_check_of_a_file_names_line_and_column_of_each_without_a_bridge(tmp_path: Path) -> None:
    report = inspect(written(tmp_path, "{perod: 1, lamp: {colour: blue}}"), types={"shed": KIND})
    found = {(problem.path, problem.sentence, problem.hint) for problem in report.problems}
    path = "$.functions.door.components[0].output.options"
    assert found == {
        (f"{path}.perod", 'the plugin shed: unknown key "perod"', 'did you mean "period"?'),
        (
            f"{path}.lamp.colour",
            'the plugin shed: expected white or red, got "blue"',
            "",
        ),
    }
    assert {problem.place.line for problem in report.problems} == {12}


def test_the_check_of_addresses_sees_options_only_that_are_right(tmp_path: Path) -> None:
    seen: list[Mapping[str, Any]] = []

    def check(address: tuple[str, ...], options: Mapping[str, Any]) -> str:
        seen.append(options)
        return ""

    kind = attrs.evolve(KIND, check_endpoint=check)
    inspect(written(tmp_path, "{perod: 1}"), types={"shed": kind})
    assert seen == []
    inspect(written(tmp_path, "{period: 1}"), types={"shed": kind})
    assert seen == [{"period": 1}]


def test_an_editor_completes_and_explains_what_a_plugin_has() -> None:
    schema = completed_schema({"python": Registry().types["python"], "shed": KIND})
    Draft202012Validator.check_schema(schema)
    known = schema["$defs"]["output"]["properties"]["options"]["properties"]
    assert known["period"]["description"] == "shed: of a look"
    assert (known["period"]["default"], known["period"]["x-unit"]) == (0.5, "s")
    assert "$defs" in published_schema(), "the published one is not changed"
    assert "properties" not in published_schema()["$defs"]["output"]["properties"]["options"]


@pytest.mark.parametrize(
    ("bridges", "fits"),
    [
        ({"shed": {}}, True),
        ({"shed": {"options": {"roof": "flat"}}}, False),
        ({"mine": {"plugin": "shed", "options": {"roof": "flat"}}}, False),
        ({"mine": {"plugin": "other", "options": {"roof": "flat"}}}, True),
        ({"shed": {"plugin": "other", "options": {"roof": "flat"}}}, True),
    ],
)
def test_an_editor_knows_the_options_of_a_bridge_by_its_plugin(
    bridges: dict[str, Any], *, fits: bool
) -> None:
    schema = completed_schema({"shed": KIND})
    assert (
        Draft202012Validator(schema).is_valid({"version": 1, "bridges": bridges, "functions": {}})
        is fits
    )


def test_references_in_options_lead_where_they_did_alone() -> None:
    roof = {"enum": ["flat", "steep"]}
    schema = {"properties": {"roof": {"$ref": "#/$defs/bridge"}}, "$defs": {"bridge": roof}}
    kind = attrs.evolve(KIND, bridge_options=schema)
    known = Draft202012Validator(completed_schema({"shed": kind}))
    for form, fits in (("flat", True), ("round", False)):
        bridges = {"shed": {"options": {"roof": form}}}
        assert known.is_valid({"version": 1, "bridges": bridges, "functions": {}}) is fits


def test_an_option_of_several_plugins_is_explained_for_each() -> None:
    other = attrs.evolve(KIND, name="barn")
    known = completed_schema({"shed": KIND, "barn": other})["$defs"]["input"]["properties"]
    period = known["options"]["properties"]["period"]
    assert period["description"] == "shed: of a look\nbarn: of a look"
    assert len(period["anyOf"]) == 2


def test_a_further_option_is_one_line_and_shows_everywhere(tmp_path: Path) -> None:
    further: Any = attrs.make_class(
        "Further",
        {"depth": option(3, {"type": "integer"}, "of the water", unit="m")},
        bases=(EndpointOptions,),
        frozen=True,
    )
    kind = attrs.evolve(KIND, endpoint_options=further)
    (problem,) = inspect(written(tmp_path, "{depth: deep}"), types={"shed": kind}).problems
    assert problem.sentence == 'the plugin shed: expected a whole number, in m, got "deep"'
    assert "depth" in json.dumps(completed_schema({"shed": kind}))
    assert options_table(further.schema()).splitlines()[2] == "| `depth` | 3 | of the water |"


def test_a_table_says_what_must_be_given_and_what_is_left_out() -> None:
    rows = options_table(Lamp.schema(), "option of a lamp").splitlines()
    assert rows[0] == "| option of a lamp | default | meaning |"
    assert rows[2:] == [
        "| `colour` | must be given | of the light |",
        "| `level` | 5 | of brightness |",
    ]
    assert "| `label` |  | that people see |" in options_table(Options.schema())


@given(
    period=st.floats(min_value=0, exclude_min=True, allow_infinity=False),
    level=st.integers(-2, 12),
    label=st.none() | st.text(),
)
def test_what_the_schema_takes_is_read_as_it_was_written(
    period: float, level: int, label: str | None
) -> None:
    options = {"period": period, "lamp": {"colour": "red", "level": level}, "label": label}
    if label is None:
        del options["label"]
    if Draft202012Validator(Options.schema()).is_valid(options):
        assert Options.of(options) == Options(period, label, Lamp("red", level))
    else:
        with pytest.raises(ValueError, match="option"):
            Options.of(options)


@frozen
class Door(DeclaredOptions):
    """What stands in a mapping of names."""

    wide: float = option(1.0, {"type": "number", "minimum": 0}, "of the opening", unit="m")


@frozen
class House(BridgeOptions):
    """Options of a bridge: members of every kind."""

    street: str = option("", {"type": "string", "minLength": 1}, "that it is in", required=True)
    from_: float = option(0.0, {"type": "number", "minimum": 0}, "when it begins", unit="s")
    files: tuple[str, ...] = option(
        (), {"type": "array", "items": {"type": "string", "x-uoarm-path": True}}, "of its plans"
    )
    doors: Mapping[str, Door] = option(
        {},
        {"type": "object", "additionalProperties": Door},
        "by name",
    )
    locked: bool = option(False, {"type": "boolean"}, "whether there is a key")
    tls: TlsOptions = option(TlsOptions(), TlsOptions, "of its line")

    def check_together(self) -> None:
        """Refuse a lock without a door."""
        if self.locked and not self.doors:
            raise ValueError("`locked` goes with `doors`")


class HouseBridge(MemoryBridge):
    """Keeps what it was made of."""


HOUSE = BridgeType("house", "a house", HouseBridge, bridge_options=House, contract=2)


def house(folder: Path, options: str) -> Path:
    file = folder / "robot.yaml"
    file.write_text(
        "version: 1\nbridges:\n  home:\n    plugin: house\n"
        f"    options: {options}\nfunctions: {{}}\n",
        encoding="utf-8",
    )
    return file


def test_a_bridge_gets_a_value_that_is_complete() -> None:
    registry = Registry([])
    registry.add(HOUSE)
    spec = BridgeSpec(
        "home",
        "house",
        {"street": "High St", "from": 2, "files": ["a"], "doors": {"front": {}}},
        folder="/lab",
    )
    bridge = registry.create(spec)
    assert bridge.options == House("High St", 2, ("/lab/a",), {"front": Door(1.0)})
    bridge.close()


def test_a_file_names_every_mistake_in_the_options_of_a_bridge_at_its_place(tmp_path: Path) -> None:
    file = house(tmp_path, "{stret: x, from: -1, doors: {front: {wid: 2}}, tls: {ca: 3}}")
    report = inspect(file, types={"house": HOUSE})
    found = {(problem.path, problem.sentence, problem.hint) for problem in report.problems}
    path = "$.bridges.home.options"
    assert found == {
        (path, 'the plugin house: the key "street" is missing', ""),
        (f"{path}.stret", 'the plugin house: unknown key "stret"', 'did you mean "street"?'),
        (f"{path}.from", "the plugin house: expected at least 0 s, got -1", ""),
        (
            f"{path}.doors.front.wid",
            'the plugin house: unknown key "wid"',
            'did you mean "wide"?',
        ),
        (f"{path}.tls.ca", "the plugin house: expected text, got 3", "write it in quotes"),
    }
    assert {problem.place.line for problem in report.problems} == {5}


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ("{street: x, locked: true}", "`locked` goes with `doors`"),
        ("{street: x, tls: {key: k.pem}}", "tls: a `key` goes with a `certificate`"),
    ],
)
def test_options_that_do_not_go_together_are_found_by_the_check(
    tmp_path: Path, options: str, sentence: str
) -> None:
    (problem,) = inspect(house(tmp_path, options), types={"house": HOUSE}).problems
    assert (problem.path, problem.sentence) == (
        "$.bridges.home.options",
        f"the plugin house: {sentence}",
    )


def test_options_of_an_endpoint_that_do_not_go_together_are_found_too(tmp_path: Path) -> None:
    @frozen
    class Contrary(Options):
        def check_together(self) -> None:
            if self.label and not self.lamp:
                raise ValueError("`label` goes with `lamp`")

    kind = attrs.evolve(KIND, endpoint_options=Contrary)
    (problem,) = inspect(written(tmp_path, "{label: a}"), types={"shed": kind}).problems
    assert problem.path == "$.functions.door.components[0].output.options"
    assert problem.sentence == "the plugin shed: `label` goes with `lamp`"


def test_a_program_is_refused_with_the_same_words() -> None:
    registry = Registry([])
    registry.add(HOUSE)
    spec = BridgeSpec("home", "house", {"street": "x", "locked": True})
    with pytest.raises(ConfigurationError, match=r"bridge 'home': .*`locked` goes with `doors`"):
        registry.create(spec)


def test_a_structure_in_an_option_is_checked_as_that_of_a_port_and_a_name_at_its_key(
    tmp_path: Path,
) -> None:
    structure = {"type": ["object", "boolean"], "x-uoarm-structure": True}

    @frozen
    class Further(House):
        kinds: Mapping[str, Any] = option(
            {},
            {
                "type": "object",
                "propertyNames": {"pattern": "^[a-z]+$"},
                "additionalProperties": structure,
            },
            "of what comes in",
        )
        both: tuple[Any, ...] = option((), {"type": "array", "items": structure}, "in and out")

    kind = attrs.evolve(HOUSE, bridge_options=Further)
    options = "{street: x, kinds: {a: {type: obect}, b: true}, both: [{items: {minLength: x}}]}"
    found = {
        problem.path: problem.sentence
        for problem in inspect(house(tmp_path, options), types={"house": kind}).problems
    }
    path = "$.bridges.home.options"
    assert found.keys() == {f"{path}.kinds.a.type", f"{path}.both[0].items.minLength"}
    assert all(sentence.startswith("not a JSON Schema: ") for sentence in found.values())
    (problem,) = inspect(
        house(tmp_path, "{street: x, kinds: {3x: true}}"), types={"house": kind}
    ).problems
    assert problem.path == f'{path}.kinds["3x"]'
    assert problem.sentence == ('the plugin house: expected a name that matches ^[a-z]+$, got "3x"')


def test_what_is_wrong_is_not_also_doubted(tmp_path: Path) -> None:
    asked: list[object] = []

    def doubts(options: object, addresses: frozenset[tuple[str, ...]]) -> dict[Any, str]:
        asked.append((options, addresses))
        return {(): "it is far away"}

    kind = attrs.evolve(HOUSE, doubts=doubts)
    for options, sentences in (("{street: 5}", []), ("{street: x}", ["it is far away"])):
        file = house(tmp_path, options)
        report = inspect(file, types={"house": kind}, missing=lambda _: "it is not installed")
        found = [warning.sentence for warning in report.warnings]
        assert [text for text in found if "far away" in text or "looked at" in text] == sentences
    assert len(asked) == 1


def test_a_component_is_not_called_unavailable_for_a_mistake_in_an_option(tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(
        "version: 1\nbridges: {python: {options: {timeout: long}}}\nfunctions:\n"
        "  a: {components: [{name: a, bridge: python, service: {endpoint: ['json:loads']}}]}\n"
    )
    report = inspect(file, types=Registry().types, parameters=True, missing=str)
    assert [problem.path for problem in report.problems] == ["$.bridges.python.options.timeout"]
    assert not report.warnings


def test_a_text_that_has_a_form_is_explained_by_an_example() -> None:
    """Of each plugin that is installed: a pattern is no explanation."""
    schemas = [
        schema
        for kind in Registry().types.values()
        for schema in (
            kind.options_schema,
            kind.endpoint_options and kind.endpoint_options.schema(),
        )
    ]
    forms = [rules for rules in parts(schemas) if isinstance(rules.get("pattern"), str)]
    own: Any = PythonOptions.schema()
    unwritten = {own["properties"]["code"]["pattern"]}  # by people
    unexplained = [rules for rules in forms if not rules.get("examples")]
    assert {rules["pattern"] for rules in unexplained} == unwritten
    assert all(
        re.search(form["pattern"], text) for form in forms for text in form.get("examples", ())
    )


@pytest.mark.parametrize("place", ["/:9", "//a:99999", "//a:0", "//a:x", "//[::1"])
def test_an_address_that_cannot_be_one_is_a_mistake_in_the_configuration(place: str) -> None:
    """Of each plugin that is installed: it is not found as the bridge connects."""
    tried = 0
    for kind in Registry().types.values():
        schema: Any = kind.options_schema
        needed = {name: schema["properties"][name]["examples"][0] for name in kind.lacking({})}
        for name, rules in schema.get("properties", {}).items():
            example = next(iter(rules.get("examples", ())), "")
            if "://" not in str(example) or not isinstance(example, str):
                continue
            wrong = {**needed, name: f"{example.partition('//')[0]}/{place}"}
            with pytest.raises(ValueError, match=r"//|expected") as raised:
                kind.value_of(wrong, "")
            assert not isinstance(raised.value, ConfigurationError), kind.name
            tried += 1
    assert tried >= min(1, len(Registry().types) - 3)  # of the core: none


def parts(schema: Any) -> Iterator[Mapping[str, Any]]:
    """Yield a schema and all that stands in it."""
    if isinstance(schema, Mapping):
        yield schema
    values = schema.values() if isinstance(schema, Mapping) else schema
    for value in values if isinstance(schema, Mapping | list | tuple) else ():
        yield from parts(value)


@pytest.mark.parametrize(
    ("types", "said"),
    [
        ("string", "expected text such as auto, got"),
        (["string", "object"], "expected text such as auto, or a mapping, got"),
        (["number", "string", "null"], "expected text such as auto, or a number or nothing, got"),
    ],
)
def test_what_may_be_text_of_one_form_or_something_else_says_both(
    tmp_path: Path, types: str | list[str], said: str
) -> None:
    @frozen
    class Further(House):
        qos: Any = option("auto", {"type": types, "pattern": "^auto$", "examples": ["auto"]}, "x")

    file = house(tmp_path, "{street: x, qos: best_effort}")
    kind = attrs.evolve(HOUSE, bridge_options=Further)
    (problem,) = inspect(file, types={"house": kind}).problems
    assert problem.sentence == f'the plugin house: {said} "best_effort"'


def test_what_is_left_out_is_shared_with_no_other() -> None:
    first, second = House.of({"street": "x"}), House.of({"street": "x"})
    first.doors["front"] = Door(1.0)  # type: ignore[index]
    assert not second.doors


def test_a_further_option_of_a_bridge_is_one_line_and_shows_everywhere(tmp_path: Path) -> None:
    @frozen
    class Further(House):
        depth: int = option(3, {"type": "integer"}, "of the cellar", unit="m")

    kind = attrs.evolve(HOUSE, bridge_options=Further)
    file = house(tmp_path, "{street: x, depth: deep}")
    (problem,) = inspect(file, types={"house": kind}).problems
    assert problem.sentence == 'the plugin house: expected a whole number, in m, got "deep"'
    shown = completed_schema({"house": kind})["$defs"]["options.house"]["properties"]["depth"]
    assert shown == {
        "type": "integer",
        "default": 3,
        "x-unit": "m",
        "description": "of the cellar",
    }
    assert "| `depth` | 3 | of the cellar |" in options_table(Further.schema())


def test_a_table_of_a_bridge_has_what_is_a_mapping_or_a_list() -> None:
    rows = options_table(House.schema()).splitlines()
    assert "| `from` | 0.0 | when it begins |" in rows
    assert "| `files` |  | of its plans |" in rows
    assert "| `doors` |  | by name |" in rows


@frozen
class Gate(PeerOptions):
    width: float = option(1.0, {"type": "number"}, "of the gate")


@pytest.mark.parametrize("is_offered", [False, True])
def test_what_is_offered_needs_no_peer(*, is_offered: bool) -> None:
    endpoint = Endpoint(
        "b", "gate", Role.OUTPUT, ("a",), options={"width": 2.0}, is_offered=is_offered
    )
    options = Gate.of_endpoint(endpoint)
    assert (options.width, options.at_once, options.stale_after) == (2.0, 8, None)
    assert options.peer_required is not is_offered


def test_an_address_that_cannot_be_read_is_a_sentence() -> None:
    def read(parts: tuple[str, ...]) -> str:
        if len(parts) != 1:
            raise ValueError(f"expected [topic], got {list(parts)}")
        return parts[0]

    check = address_check(read)
    assert check(("a",), {}) == ""
    assert check(("a", "b"), {}) == "expected [topic], got ['a', 'b']"
