"""The judgement of meaning: what agrees, what is converted, what is refused, what is not stated."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from random import Random
from types import MappingProxyType
from typing import Any, TypeAlias

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from tests.structures import closed

from uoarm._adapt import check_edge, transfer
from uoarm._meaning import judge
from uoarm.model import Edge, Meaning, MeaningLevel, MessageStructure

NUMBER: dict[str, Any] = {"type": "number"}
OCTETS: dict[str, Any] = {
    "type": "array", "items": {"type": "integer", "minimum": 0, "maximum": 255}, "x-octets": True
}  # fmt: skip
STRICT, OFF = Meaning(MeaningLevel.STRICT), Meaning(MeaningLevel.OFF)


def unit(name: str) -> dict[str, Any]:
    return {**NUMBER, "x-unit": name}


def named(name: Any, **fields: Any) -> dict[str, Any]:
    return {**closed(**fields), "x-type": name}


def edge(one: Any, other: Any, mapping: Any = None, **more: Any) -> Any:
    return check_edge(MessageStructure(one), MessageStructure(other), mapping, **more)


def test_degrees_are_not_radians_and_the_line_converts_them() -> None:
    verdict = edge(closed(yaw=unit("deg")), closed(yaw=unit("rad")))
    assert not verdict.compatible
    (reason,) = verdict.reasons
    assert (reason.path, reason.producer, reason.consumer) == ("yaw", "x-unit deg", "x-unit rad")
    assert reason.suggestion == "map: {yaw: {from: yaw, scale: 0.017453292519943295}}"


def pasted(one: Any, other: Any) -> Any:
    """Return the function that the suggested lines make of an edge."""
    (first, *_) = edge(one, other).reasons
    mapping = yaml.safe_load(first.suggestion)["map"]
    assert edge(one, other, mapping).compatible
    made = transfer(
        Edge("a", "b", "c", "d", MessageStructure(one), MessageStructure(other), mapping)
    )
    assert made is not None
    return made


def test_lines_to_paste_reach_into_objects_and_arrays_and_keep_what_stands_beside() -> None:
    def scan(angle: str, length: str) -> dict[str, Any]:
        return closed(
            name={"type": "string"},
            pose=closed(x=unit(length), yaw=unit(angle), at=closed(z=unit(length), k=NUMBER)),
            ranges={"type": "array", "items": unit(length)},
            rows={"type": "array", "items": {"type": "array", "items": unit(length)}},
            points={"type": "array", "items": closed(x=unit(length), id=NUMBER)},
            plain=unit("s"),
        )

    convert = pasted(scan("deg", "mm"), scan("deg", "m"))
    message = {
        "name": "n", "pose": {"x": 1000, "yaw": 90, "at": {"z": 5000, "k": 7}},
        "ranges": [500, 250], "rows": [[500], []], "points": [{"x": 2000, "id": 3}], "plain": 4,
    }  # fmt: skip
    assert convert(message) == {
        "name": "n", "pose": {"x": 1.0, "yaw": 90, "at": {"z": 5.0, "k": 7}},
        "ranges": [0.5, 0.25], "rows": [[0.5], []], "points": [{"x": 2.0, "id": 3}], "plain": 4,
    }  # fmt: skip


def test_a_whole_message_that_is_one_number_is_converted() -> None:
    assert pasted(unit("Cel"), unit("[degF]"))(100) == 212


@pytest.mark.parametrize(
    ("one", "other", "said"),
    [
        (unit("m"), unit("s"), "m measures something else than s"),
        (unit("rad"), unit("1"), "rad measures something else than 1"),
        (unit("m"), unit("smoots"), "'smoots' is not known"),
        (
            {**unit("N.m"), "x-quantity": "torque"},
            {**unit("J"), "x-quantity": "energy"},
            "the quantities differ: torque is not energy",
        ),
        ({**NUMBER, "x-frame": "map"}, {**NUMBER, "x-frame": "odom"}, "map is not odom"),
        ({**NUMBER, "x-time": "epoch"}, {**NUMBER, "x-time": "duration"}, "epoch is not duration"),
        ({**OCTETS, "x-encoding": "jpeg"}, {**OCTETS, "x-encoding": "rgb8"}, "jpeg is not rgb8"),
        (named("a/B", x=NUMBER), named("a/C", x=NUMBER), "the types differ: a/B is not a/C"),
    ],
)
def test_what_means_something_else_is_refused_with_its_path(
    one: Any, other: Any, said: str
) -> None:
    verdict = edge(closed(v=one), closed(v=other))
    assert not verdict.compatible
    assert verdict.reasons[0].path == "v"
    assert said in verdict.reasons[0].sentence
    assert not verdict.reasons[0].suggestion
    assert edge(closed(v=one), closed(v=other), meaning=OFF).compatible


@pytest.mark.parametrize("key", ["x-frame", "x-encoding"])
def test_what_each_message_says_itself_is_not_guessed(key: str) -> None:
    by_field = {**OCTETS, key: {"field": "header.frame_id"}}
    assert edge(by_field, {**OCTETS, key: "map"}).compatible


def test_what_an_object_says_holds_for_what_is_in_it() -> None:
    whole = {**closed(x=NUMBER, y=unit("rad")), "x-unit": "mm"}
    verdict = edge(whole, closed(x=unit("m"), y=unit("rad")))
    assert [reason.path for reason in verdict.reasons] == ["x"]
    assert edge(whole, closed(x=unit("mm"), y=unit("rad"))).unstated == ()
    framed = {**closed(at={**closed(x=NUMBER), "x-frame": "map"}), "x-unit": "mm"}
    assert edge(framed, framed).unstated == ()
    carried = edge(closed(at=whole), closed(x=unit("m")), {"x": "at.x"}, allow_loss=("at.y",))
    assert carried.reasons[0].sentence == "the units differ: mm becomes m with scale: 0.001"


OWN: list[dict[str, Any]] = [
    unit("rad"),
    {"$ref": "#/$defs/angle"},
    {"anyOf": [unit("rad"), {"type": "null"}]},
    {"allOf": [unit("rad")]},
]


@pytest.mark.parametrize("field", OWN)
def test_what_a_map_takes_means_what_it_says_itself_before_what_is_around(field: Any) -> None:
    whole = {**closed(a=field, b=NUMBER), "x-unit": "m", "$defs": {"angle": unit("rad")}}
    for name in ("m", "rad"):
        taken = closed(x={"anyOf": [unit(name), {"type": "null"}]})
        verdict = edge(whole, taken, {"x": "a"}, allow_loss=("b",))
        assert verdict.compatible == (name == "rad")


@pytest.mark.parametrize("field", OWN[:2])
def test_a_factor_is_of_the_unit_that_a_value_states_itself(field: Any) -> None:
    whole = {**closed(a=field), "x-unit": "m", "$defs": {"angle": unit("rad")}}
    for factor, fits in ((57.3, True), (1, False)):
        rule = {"x": {"from": "a", "scale": factor}}
        assert edge(whole, closed(x=unit("deg")), rule).compatible == fits


@pytest.mark.parametrize("rule", ["r", {"from": "r", "scale": 1000}])
def test_what_an_array_says_holds_for_what_a_map_makes_of_its_items(rule: Any) -> None:
    def rows(name: str, items: Any = NUMBER) -> dict[str, Any]:
        return closed(r={"type": "array", "items": items, "x-unit": name})

    made, taken = rows("mm"), rows("m")
    assert not edge(made, taken, {"r": rule}).compatible
    assert edge(made, taken, {"r": {"from": "r", "scale": 0.001}}).compatible
    assert pasted(made, taken)({"r": [1500]}) == {"r": [1.5]}
    assert pasted(*(rows(name, {"type": "array", "items": NUMBER}) for name in ("mm", "m")))(
        {"r": [[1500], []]}
    ) == {"r": [[1.5], []]}
    points = [rows(name, closed(x=NUMBER, y=NUMBER)) for name in ("mm", "m")]
    wrong = {"r": {"each": "r", "map": {"x": "x", "y": "y"}}}
    verdict = edge(points[0], points[1], wrong)
    assert [reason.path for reason in verdict.reasons] == ["r[].x", "r[].y"]
    assert pasted(*points)({"r": [{"x": 1500, "y": 0}]}) == {"r": [{"x": 1.5, "y": 0}]}


def test_what_only_an_adapter_says_is_nothing_that_a_structure_says() -> None:
    made = {**unit("mm"), "x-scaled": ["1/1000", 0], "x-around": [["x-quantity", "length"]]}
    for mapping in (None, {"a": "a"}, {"a": {"from": "a", "scale": 1}}):
        verdict = edge(closed(a=made), closed(a=unit("m")), mapping)
        assert "mm becomes m" in verdict.reasons[0].sentence


def test_a_unit_around_numbers_that_all_state_their_own_is_that_of_none() -> None:
    def around(name: str) -> dict[str, Any]:
        return {**closed(x=unit("m"), n={"type": "string"}), "x-unit": name}

    assert edge(around("mm"), around("s")).compatible
    none = {"type": "null"}
    assert edge(
        *({"anyOf": [around("m"), none], "x-unit": name} for name in ("mm", "s"))
    ).compatible
    one, other = ({**closed(a=around("mm"), y=NUMBER), "x-unit": name} for name in ("mm", "m"))
    assert pasted(one, other)({"a": {"x": 5, "n": "s"}, "y": 5}) == {
        "a": {"x": 5, "n": "s"}, "y": 0.005
    }  # fmt: skip


@pytest.mark.parametrize(
    ("around", "path"),
    [
        (lambda item: {"type": "object", "additionalProperties": item}, "v.*"),
        (lambda item: {"type": "array", "prefixItems": [NUMBER, item]}, "v[1]"),
        (lambda item: {"type": "array", "items": {**item, "type": ["null", "number"]}}, "v[]"),
        (lambda item: {"anyOf": [{"type": ["null", "string"]}, item]}, "v"),
        (MappingProxyType, "v"),
    ],
)
def test_a_unit_is_compared_wherever_a_number_may_be(
    around: Callable[[Any], Any], path: str
) -> None:
    made, taken = closed(v=around(unit("m"))), closed(v=around(unit("s")))
    assert [reason.path for reason in edge(made, taken).reasons] == [path]
    assert path in edge(made, closed(v=around(NUMBER))).unstated
    assert path in edge(closed(v=around(NUMBER)), taken).unstated


def test_what_may_be_anything_is_nothing_that_is_compared() -> None:
    assert judge(closed(v=True), closed(v={"title": "x"})) == judge(True, {})


def test_what_is_not_declared_rests_on_shape_and_is_named() -> None:
    flag, code = {"type": "boolean"}, {"enum": [1, 2]}
    one = closed(a=NUMBER, b=unit("m"), c=flag, d=code, e=OCTETS, f=unit("m"))
    verdict = edge(one, closed(a=NUMBER, b=NUMBER, c=flag, d=code, e=OCTETS, f=unit("m")))
    assert verdict.compatible
    assert verdict.unstated == ("a", "b", "e")
    strict = edge(one, one, meaning=STRICT)
    assert [reason.path for reason in strict.reasons] == ["a", "e"]
    assert "strict" in strict.reasons[0].sentence


def test_equal_types_say_what_is_within() -> None:
    one = named({"name": "x/Reading", "version": "1"}, value=NUMBER)
    assert edge(one, one, meaning=STRICT).compatible
    other = {**one, "x-type": {"name": "x/Reading", "version": "2"}}
    verdict = edge(one, other)
    assert verdict.compatible
    assert "has version 1, the consumer's 2" in verdict.warnings[0]
    hashed = [{**one, "x-type": {"name": "x/Reading", "hash": text}} for text in "ab"]
    assert "has hash a, the consumer's b" in edge(*hashed).warnings[0]


def test_constants_of_one_type_have_one_value_and_new_ones_are_noted() -> None:
    def marker(name: str = "Marker", **constants: int) -> dict[str, Any]:
        return {**named(name, kind={"type": "integer"}), "x-constants": constants}

    older, newer = marker(ARROW=0, CUBE=1), marker(ARROW=0, CUBE=1, STRIP=2)
    assert edge(older, newer).warnings == ()
    assert edge(newer, older).compatible
    (warning,) = edge(newer, older).warnings
    assert "constants that the consumer's has not: STRIP=2" in warning
    assert edge({**older, "x-constants": 7}, older).compatible
    assert edge(older, {**older, "x-constants": 7}).compatible
    verdict = edge(closed(marker=older), closed(marker=marker(ARROW=1, CUBE=0)))
    assert not verdict.compatible
    assert [reason.path for reason in verdict.reasons] == ["marker", "marker"]
    assert "ARROW of Marker is 0 for the producer and 1 for the" in verdict.reasons[0].sentence
    other = marker("visualization_msgs/msg/Marker", ARROW=1)
    alike = Meaning(alike=(frozenset({"Marker", other["x-type"]}),))
    assert edge(older, other, meaning=alike).compatible


def test_types_are_alike_by_declaration_or_by_the_built_in_table() -> None:
    one, other = named("my/Point", x=unit("m")), named("their::Point", x=unit("m"))
    declared = Meaning(alike=(frozenset({"my/Point", "their::Point"}),))
    assert not edge(one, other).compatible
    assert edge(one, other, meaning=declared).compatible
    assert edge(other, one, meaning=declared).compatible
    ros, foxglove = (
        named(name, x=NUMBER, y=NUMBER, z=NUMBER)
        for name in ("geometry_msgs/msg/Vector3", "foxglove.Vector3")
    )
    assert edge(ros, foxglove).compatible
    assert not edge(ros, {**foxglove, "x-type": "foxglove.Point3"}).compatible


def test_a_map_is_judged_at_what_it_carries_over() -> None:
    producer = named("ros/Scan", range=unit("mm"), stamp=NUMBER)
    consumer = named("rtc/Distance", metres=unit("m"))
    right = {"metres": {"from": "range", "scale": 0.001}}
    losses = ("stamp",)
    assert edge(producer, consumer, right, allow_loss=losses).compatible
    for wrong in (
        "range",
        {"from": "range", "scale": 1000},
        {"from": "range", "scale": 0.01, "clamp": [0, 9]},
    ):
        verdict = edge(producer, consumer, {"metres": wrong}, allow_loss=losses)
        assert not verdict.compatible
        assert verdict.reasons[0].path == "metres"
    assert edge(
        producer, consumer, {"metres": {"const": 3}}, allow_loss=("range", "stamp")
    ).compatible


def test_a_map_may_correct_a_value_and_cross_quantities_by_a_factor() -> None:
    calibrated = {"v": {"from": "v", "scale": 1.02, "offset": -0.3}}
    assert edge(closed(v=unit("m")), closed(v=unit("m")), calibrated).compatible
    wheel = edge(
        closed(v=unit("rad/s")), closed(v=unit("m/s")), {"v": {"from": "v", "scale": 0.05}}
    )
    assert wheel.compatible
    assert "makes m/s of rad/s" in wheel.warnings[0]
    celsius = {"v": {"from": "v", "scale": 1.8}}
    forgotten = edge(closed(v=unit("Cel")), closed(v=unit("[degF]")), celsius)
    assert "scale: 1.8, offset: 32" in forgotten.reasons[0].sentence


def test_a_choice_is_judged_branch_by_branch() -> None:
    none = {"type": "null"}
    one = {"anyOf": [unit("m"), none]}
    assert edge(one, {"anyOf": [unit("m"), none]}).compatible
    assert not edge(one, {"anyOf": [unit("s"), none]}).compatible
    assert edge(
        unit("m"), {"oneOf": [unit("s"), unit("m")], "x-any": 1}, meaning=OFF
    ).compatible is (
        False  # oneOf: both branches take every number
    )
    assert edge(unit("m"), {"anyOf": [unit("s"), unit("m")]}).compatible
    whole = {"anyOf": [{"type": "integer", "x-unit": "m"}, none]}
    assert not edge(whole, {"anyOf": [unit("s"), none]}).compatible


@pytest.mark.parametrize(
    "tag", [{"kind": {"const": "{}"}}, {"kind": {"$ref": "#/$defs/{}"}}, {"{}": NUMBER}]
)
def test_an_alternative_is_compared_with_those_that_its_messages_may_be(tag: Any) -> None:
    def choice(**units: str) -> dict[str, Any]:
        parts = [
            closed(**yaml.safe_load(yaml.safe_dump(tag).replace("{}", name)), x=unit(said))
            for name, said in units.items()
        ]
        return {"anyOf": parts, "$defs": {name: {"enum": [name]} for name in units}}

    assert edge(choice(a="m", b="s"), choice(b="s", a="m")).compatible
    found = judge(choice(a="m", b="s"), choice(a="s", b="m")).differences
    assert [difference.sentence[:21] for difference in found] == [
        "the units differ: m m",
        "the units differ: s m",
    ]


def test_tags_may_be_numbers_that_python_does_not_write() -> None:
    def choice(*units: str) -> dict[str, Any]:
        tags = (10**5000, "b")
        parts = [
            closed(kind={"const": tag}, x=unit(said)) for tag, said in zip(tags, units, strict=True)
        ]
        return {"anyOf": parts}

    assert not judge(choice("m", "s"), choice("m", "s")).differences
    assert len(judge(choice("m", "s"), choice("s", "m")).differences) == 2


def test_structures_that_refer_to_themselves_are_judged_once_around() -> None:
    def tree(name: str) -> dict[str, Any]:
        node = closed(value=unit(name), children={"type": "array", "items": {"$ref": "#/$defs/n"}})
        return {"$ref": "#/$defs/n", "$defs": {"n": node}}

    def fork(name: str) -> dict[str, Any]:
        way = {"anyOf": [{"$ref": "#/$defs/n"}, {"type": "null"}]}
        return {"$ref": "#/$defs/n", "$defs": {"n": closed(value=unit(name), left=way, right=way)}}

    assert judge(fork("m"), {**fork("m"), "title": "another"}).unstated == ()
    assert len(judge(fork("m"), fork("mm")).differences) < 9
    assert not judge(tree("m"), tree("m")).differences
    assert {difference.path for difference in judge(tree("m"), tree("mm")).differences} == {
        ("value",), ("children", "[]", "value")
    }  # fmt: skip


def test_choices_that_multiply_are_not_followed_and_cost_little() -> None:
    wide = {"allOf": [{"anyOf": [{"minimum": n}, {"maximum": n}]} for n in range(500)]}
    assert judge(wide, wide).unstated == ((),)
    level: Any = False
    for _ in range(30):
        level = {"anyOf": [level, level]}
    assert judge(level, level).unstated == ((),)


def test_a_suggestion_crosses_neither_types_nor_units() -> None:
    here, there = named("a/Pose", x=NUMBER), named("a/Twist", x=NUMBER)
    assert not edge(closed(pose=here), closed(posture=there)).reasons[0].suggestion
    assert not edge(closed(length=unit("m")), closed(lengths=unit("s"))).reasons[0].suggestion
    assert edge(closed(pose=here), closed(posture=here)).reasons[0].suggestion


# Properties ------------------------------------------------------------------------------------

Tree: TypeAlias = "tuple[str | None, dict[str, Tree]]"
"""A unit or none, and fields, or `[]` for the items of an array; a number has none."""


def _tree(draw: Random, depth: int = 0) -> Tree:
    said = draw.choice(["m", "mm", "s", None, None, None])
    kind = draw.choice(["number", "object", "object", "array"]) if depth < 3 else "number"
    names = {"number": "", "object": draw.choice(["a", "ab", "abc"])}.get(kind, ["[]"])
    return said, {name: _tree(draw, depth + 1) for name in names}


def _varied(draw: Random, tree: Tree) -> Tree:
    said, parts = tree
    said = draw.choice([said, said, said, "m", "s", None])
    return said, {name: _varied(draw, part) for name, part in parts.items()}


def _units(tree: Tree, path: tuple[str, ...] = (), around: str | None = None) -> dict[Any, Any]:
    said, parts = tree
    if not parts:
        return {path: said or around}
    found = [_units(part, (*path, name), said or around) for name, part in parts.items()]
    return {place: unit for units in found for place, unit in units.items()}


def _written(draw: Random, tree: Tree, definitions: dict[str, Any]) -> dict[str, Any]:
    """Write a structure of a tree in of the many ways that JSON Schema has for it."""
    said, parts = tree
    inner = {name: _written(draw, part, definitions) for name, part in parts.items()}
    schema: dict[str, Any] = NUMBER
    if "[]" in inner:
        schema = {"type": "array", "items": inner["[]"]}
    elif inner:
        schema = {"type": "object", "properties": inner}
    own = {} if said is None else {"x-unit": said}
    is_beside = draw.random() < 0.5
    if not is_beside:
        schema = {**schema, **own}
    ways: list[Any] = [schema, {"allOf": [schema]}, {"anyOf": [schema, {"type": "null"}]}]
    ways += [{"allOf": [{"title": "x"}, schema]}, {"$ref": f"#/$defs/{len(definitions)}"}]
    for name in inner:
        any_value = draw.choice([True, {"title": "x"}])
        more = {"items": any_value} if name == "[]" else {"properties": {name: any_value}}
        ways += [{"allOf": [schema, more]}, {"allOf": [schema], **more}]
        ways += [{**schema, "anyOf": [{"required": [name]}, {"maxProperties": 9}]}]
    way = draw.choice(ways)
    if "$ref" in way:
        definitions[str(len(definitions))] = schema
    return {**way, **own} if is_beside else way


@given(st.randoms(use_true_random=False))
def test_units_are_compared_however_a_structure_is_written(draw: Random) -> None:
    one = _tree(draw)
    other = _varied(draw, one)
    made: dict[str, Any] = {"$defs": {}}
    taken: dict[str, Any] = {"$defs": {}}
    for tree, schema in ((one, made), (other, taken)):
        schema.update(_written(draw, tree, schema["$defs"]))
    found = judge(made, taken)
    pairs = {path: (said, _units(other)[path]) for path, said in _units(one).items()}
    different = {
        path for path, (mine, theirs) in pairs.items() if mine and theirs and mine != theirs
    }
    assert {difference.path for difference in found.differences} == different
    assert set(found.unstated) == {path for path, units in pairs.items() if None in units}


statements = st.fixed_dictionaries(
    {},
    optional={
        "x-unit": st.sampled_from(["m", "mm", "[ft_i]", "rad", "deg", "Cel", "K", "1", "N.m", "J"]),
        "x-quantity": st.sampled_from(["torque", "energy"]),
        "x-frame": st.sampled_from(["map", "odom"]),
        "x-time": st.sampled_from(["epoch", "duration"]),
    },
)
numbers = statements.map(lambda said: {**NUMBER, **said})
types = st.sampled_from(["a/A", "b/B", "c/C", None])


def _typed(fields: dict[str, Any], name: str | None) -> dict[str, Any]:
    return closed(**fields) if name is None else named(name, **fields)


structures = st.recursive(
    numbers,
    lambda inner: st.one_of(
        st.builds(lambda item: {"type": "array", "items": item}, inner),
        st.builds(_typed, st.dictionaries(st.sampled_from("abc"), inner, max_size=3), types),
    ),
    max_leaves=8,
)


choices = st.builds(lambda one, other: closed(a={"anyOf": [one, other]}), structures, structures)


@given(structures | choices)
def test_judging_is_reflexive(one: Any) -> None:
    equal = judge(one, deepcopy(one))
    assert not equal.differences
    # What is not equal, though only for people, is compared side by side.
    assert equal == judge(one, {**one, "title": "another"})


def test_structures_nested_deeper_than_python_recurses_are_judged() -> None:
    def deep() -> Any:
        schema: Any = unit("m")
        for _ in range(100_000):
            schema = {"type": "array", "items": schema}
        return schema

    found = judge(deep(), deep())
    assert (found.differences, len(found.unstated)) == ((), 1)


@given(structures, structures, st.lists(st.frozensets(st.sampled_from(["a/A", "b/B", "c/C"]))))
def test_alike_is_symmetric(one: Any, other: Any, alike: list[frozenset[str]]) -> None:
    there = judge(one, other, tuple(alike)).differences
    back = judge(other, one, tuple(alike)).differences
    assert {difference.path for difference in there} == {difference.path for difference in back}
    for difference in there:
        mates = [
            found
            for found in back
            if (found.path, found.producer, found.consumer)
            == (difference.path, difference.consumer, difference.producer)
        ]
        assert mates
        assert (mates[0].conversion is None) == (difference.conversion is None)


@given(structures, structures)
def test_strict_implies_stated_and_stated_implies_off(one: Any, other: Any) -> None:
    strict, stated, off = (
        edge(one, other, meaning=Meaning(level)).compatible
        for level in (MeaningLevel.STRICT, MeaningLevel.STATED, MeaningLevel.OFF)
    )
    assert stated or not strict
    assert off or not stated


@pytest.mark.parametrize("is_choice", [False, True])
def test_references_within_a_document_of_a_document_are_to_that(*, is_choice: bool) -> None:
    length = {**closed(a={"$ref": "#/$defs/n"}), "$id": "http://here/b", "$defs": {"n": unit("m")}}
    place = {"anyOf": [length, {"type": "null"}]} if is_choice else length
    whole = {**closed(b=place), "$defs": {"n": NUMBER}}
    for other in (closed(b=closed(a=unit("m"))), whole):
        found = judge(whole, other)
        assert (found.differences, found.unstated) == ((), ())
    (difference,) = judge(whole, closed(b=closed(a=unit("ft")))).differences
    assert (difference.path, difference.producer) == (("b", "a"), "x-unit m")
