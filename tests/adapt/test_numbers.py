"""Scale and clamp give the same numbers whatever holds them, and stay within their schema."""

from __future__ import annotations

import array
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from tests.structures import closed

from uoarm._adapt import UnfitError, adapt, check_edge, parse
from uoarm._dataplane import make_check
from uoarm._encodable import shown
from uoarm._support.yaml import clip
from uoarm.cdr import _values as cdr_values
from uoarm.errors import MessageError
from uoarm.model import MessageStructure, ValidationMode

ANY: dict[str, Any] = {}
WHOLE = ("int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")
REAL = ("float32", "float64")
RULES = st.fixed_dictionaries(
    {"from": st.just("a")},
    optional={
        "scale": st.sampled_from([0, 1, 2, -3, 300, 2**40, 10**30, 0.1, -1.5]),
        "offset": st.sampled_from([0, -10, 2**62, 0.5]),
        "clamp": st.tuples(st.integers(-300, 300), st.integers(0, 600))
        .map(lambda ends: [ends[0], ends[0] + ends[1]])
        .filter(any),
    },
)


@st.composite
def columns(draw: st.DrawFn) -> tuple[dict[str, Any], Any]:
    """An array of numpy, with the schema of its items."""
    kind = draw(st.sampled_from([*WHOLE, *REAL]))
    numbers: st.SearchStrategy[float]
    if kind in WHOLE:
        limits = np.iinfo(kind)
        ends = int(limits.min), int(limits.max)
        edges = st.sampled_from([*ends, 0, 1, 100])
        items = {"type": "integer", "minimum": ends[0], "maximum": ends[1]}
        numbers = edges | st.integers(*ends)
    else:
        items = {"type": "number", "minimum": -0.7, "maximum": 0.7}
        numbers = st.floats(-0.625, 0.625, width=32) | st.sampled_from([0.3, 0.7])
    return items, np.array(draw(st.lists(numbers, max_size=4)), dtype=kind)


@given(columns(), RULES)
def test_an_array_of_numpy_gives_what_a_list_gives(
    column: tuple[dict[str, Any], Any], rule: dict[str, Any]
) -> None:
    items, values = column
    producer = closed(a={"type": "array", "items": items})
    if items["type"] == "number":
        rule = {**rule, **({"clamp": [-0.3, 0.3]} if "clamp" in rule else {})}
    elif any(isinstance(rule.get(key), float) for key in ("scale", "offset")):
        rule = {key: value for key, value in rule.items() if key != "clamp"}
    make = adapt(parse({"a": rule}), producer, ANY).make
    listed = make({"a": values.tolist()})["a"]
    made = make({"a": values})["a"]
    shown = made.tolist() if isinstance(made, np.ndarray) else made
    assert (shown, [*map(type, shown)]) == (listed, [*map(type, listed)])
    assert make({"a": list(values)})["a"] == listed  # numbers of numpy in a list
    emitted = adapt(parse({"a": rule}), producer, ANY).schema["properties"]["a"]["items"]
    low, high = emitted.get("minimum", -np.inf), emitted.get("maximum", np.inf)
    assert all(low <= number <= high for number in listed)


@pytest.mark.parametrize("kind", ["i1", "i2", "i4", "i8"])
def test_positive_numbers_do_not_wrap_where_they_leave_the_width_of_their_array(kind: str) -> None:
    items = {"type": "array", "items": {"type": "integer"}}
    make = adapt(parse({"a": {"from": "a", "scale": 3}}), closed(a=items), ANY).make
    greatest = int(np.iinfo(kind).max)
    assert list(make({"a": np.array([greatest], kind)})["a"]) == [3 * greatest]


@pytest.mark.parametrize(
    ("numbers", "rule", "expected"),
    [
        ({"minimum": -1, "maximum": 5}, {"scale": -2, "offset": 1}, {"minimum": -9, "maximum": 3}),
        ({"minimum": 3}, {"scale": 2}, {"minimum": 6}),
        ({"exclusiveMaximum": 3}, {"offset": 1}, {"maximum": 4}),
        ({"maximum": 5.5}, {"clamp": [0, 9]}, {"minimum": 0, "maximum": 5}),
        ({"minimum": 0.5}, {"clamp": [0, 9]}, {"minimum": 1, "maximum": 9}),
        ({"minimum": 20}, {"clamp": [0, 9]}, {"minimum": 9, "maximum": 9}),
        ({}, {"clamp": [0, 9]}, {"minimum": 0, "maximum": 9}),
    ],
)
def test_bounds_are_changed_with_the_numbers(
    numbers: dict[str, Any], rule: dict[str, Any], expected: dict[str, Any]
) -> None:
    few = {"type": "array", "items": {"type": "integer", **numbers}, "minItems": 1, "maxItems": 3}
    made = adapt(parse({"a": {"from": "a", **rule}}), closed(a=few), ANY).schema
    assert made["properties"]["a"] == {**few, "items": {"type": "integer", **expected}}


LARGE = st.builds(
    lambda base, more, kind: kind(base + more),
    st.sampled_from([-(10**18), -(2**53), 0, 2**53, 2**60, 2**63]),
    st.integers(-9, 9),
    st.sampled_from([int, float]),
)
EXACT = st.fixed_dictionaries(
    {"from": st.just("a")},
    optional={
        "scale": st.sampled_from([3, 7, -3, 1000, 0.1, -0.3]),
        "offset": st.sampled_from([1, -7, 2**53 + 1, 0.5]),
        "clamp": st.tuples(LARGE, LARGE).map(sorted),
    },
)


@given(st.sampled_from(["integer", "number"]), LARGE, LARGE, LARGE, EXACT)
@example("integer", -1e18, 1e18, 10**18, {"from": "a", "offset": 2**53 + 1})
@example("number", -(2**53) - 6, 0, float(-(2**53) - 6), {"from": "a", "offset": 2**53 + 1})
@example("number", float(-(2**53) + 4), 0.0, -(2**53) + 4, {"from": "a", "scale": 7})
def test_bounds_hold_for_whole_numbers_and_floats_beyond_2_53(
    kind: str, one: float, other: float, number: float, rule: dict[str, Any]
) -> None:
    low, high = sorted([one, other])
    field = {"type": kind, "minimum": low, "maximum": high}
    try:
        adapted = adapt(parse({"a": rule}), closed(a=field), ANY)
    except UnfitError:
        return
    emitted = adapted.schema["properties"]["a"]
    for value in (low, high, number):  # equal ones may be of both types
        if low <= value <= high:
            made = adapted.make({"a": value})["a"]
            assert emitted["minimum"] <= made <= emitted["maximum"]


def test_a_clamp_with_ends_that_are_not_whole_keeps_whole_numbers() -> None:
    rule = {"a": {"from": "a", "clamp": [0.5, 1e300]}}
    numbers = np.array([0, 2**53 + 1], dtype="int64")
    make = adapt(parse(rule), closed(a={"type": "array", "items": {"type": "number"}}), ANY).make
    assert make({"a": numbers})["a"] == make({"a": numbers.tolist()})["a"] == [0.5, 2**53 + 1]


OCTETS = {"type": "array", "items": {"type": "integer", "minimum": 0, "maximum": 255}}


def test_rows_of_numbers_are_scaled_and_clamped_as_rows() -> None:
    producer = closed(a={"type": "array", "items": OCTETS})
    rule = {"from": "a", "scale": 2, "clamp": [0, 300]}
    make = adapt(parse({"a": rule}), producer, ANY).make
    rows = [[1, 200], [3, 255]]
    wanted = [[2, 300], [6, 300]]
    assert make({"a": rows})["a"] == wanted
    assert make({"a": np.array(rows, dtype=np.uint8)})["a"].tolist() == wanted
    assert make({"a": [bytes(row) for row in rows]})["a"] == wanted
    assert make({"a": [array.array("B", row) for row in rows]})["a"] == wanted


def test_what_no_float_can_be_is_refused_as_a_message() -> None:
    producer = closed(a={"type": "number", "maximum": 10**400})
    make = adapt(parse({"a": {"from": "a", "scale": 0.5}}), producer, ANY).make
    assert make({"a": 3})["a"] == 1.5
    with pytest.raises(MessageError, match="a: a scaled number is beyond"):
        make({"a": 10**350})


@pytest.mark.parametrize("key", ["scale", "offset", "clamp"])
@pytest.mark.parametrize("number", [float("nan"), float("inf"), 10**400, True, "1"])
def test_a_factor_is_a_number_that_a_float_can_be(key: str, number: Any) -> None:
    rule = {"from": "a", key: [0, number] if key == "clamp" else number}
    verdict = check_edge(*(MessageStructure(closed(a={"type": "number"})),) * 2, {"a": rule})
    assert f"map.a: {key} must be" in verdict.reasons[0].sentence


def test_what_may_be_nan_may_be_so_once_it_is_scaled() -> None:
    producer = MessageStructure(closed(a={"type": "number", "x-nonfinite": True}))
    consumer = MessageStructure(closed(a={"type": "number"}))
    for mapping in (None, {"a": {"from": "a", "scale": 2}}, {"a": {"from": "a", "clamp": [0, 1]}}):
        (warning,) = check_edge(producer, consumer, mapping).warnings
        assert "may emit NaN" in warning


@pytest.mark.parametrize(
    "said",
    [
        {"uniqueItems": True},
        {"contains": {"minimum": 5}, "minItems": 1},
        {"enum": [[1], [2]]},
        {"const": [1]},
    ],
)
@pytest.mark.parametrize("change", [{"scale": -3}, {"clamp": [0, 1]}])
def test_what_was_said_of_an_array_is_not_true_of_the_changed_one(
    said: dict[str, Any], change: dict[str, Any]
) -> None:
    producer = MessageStructure(closed(a={**OCTETS, **said}))
    consumer = MessageStructure(closed(a={"type": "array", **said}))
    assert check_edge(producer, consumer, {"a": "a"}).compatible
    assert not check_edge(producer, consumer, {"a": {"from": "a", **change}}).compatible


@pytest.mark.parametrize(
    ("values", "names"),
    [
        ([None, "x"], {"null": 1, "x": 2}),
        ([1.0, 2.5], {"1": 1, "2.5": 2}),
        ([1.0, 2.5], {"1.0": 1, "2.5": 2}),
        ([False, "false"], {"false": 1}),
    ],
)
def test_an_enum_map_names_values_as_json_does(values: list[Any], names: dict[str, int]) -> None:
    made = adapt(parse({"a": {"from": "a", "enum": names}}), closed(a={"enum": values}), ANY)
    wanted = [*names.values()] if len(names) > 1 else [1, 1]
    assert [made.make({"a": value})["a"] for value in values] == wanted
    with pytest.raises(MessageError, match="says nothing of"):
        made.make({"a": [1]})


@pytest.mark.parametrize(
    ("schema", "rule", "expected"),
    [
        ({"enum": [1, True]}, {"enum": {"1": "a", "true": "b"}}, "cannot distinguish True"),
        ({"enum": [0, False]}, {"enum": {"0": 1, "false": True}}, "cannot distinguish False"),
        ({"enum": [[1]]}, {"enum": {"[1]": "a"}}, "is for texts, numbers"),
        ({"enum": [2.5]}, {"enum": {"2": "a"}}, "says nothing of the value 2.5"),
        ({"type": ["integer", "null"]}, {"scale": 2}, "need a number"),
        ({"type": "string"}, {"scale": 2}, "need a number"),
    ],
)
def test_what_cannot_be_changed_is_refused(
    schema: dict[str, Any], rule: dict[str, Any], expected: str
) -> None:
    structures = MessageStructure(closed(a=schema)), MessageStructure(ANY)
    verdict = check_edge(*structures, {"a": {"from": "a", **rule}})
    assert expected in verdict.reasons[0].sentence


def test_only_an_object_has_fields_to_take() -> None:
    """A producer whose structure does not say so may emit something else."""
    field, consumer = {"type": "number"}, MessageStructure(closed(a={"type": "number"}))
    members = {"properties": {"a": field}, "required": ["a"]}
    for producer, path in [
        (members, "a"),
        ({**members, "type": ["object", "null"]}, "a"),
        (closed(b=members), "b.a"),
    ]:
        verdict = check_edge(MessageStructure(producer), consumer, {"a": path})
        assert "has not `type: object`" in verdict.reasons[0].sentence
    assert check_edge(
        MessageStructure({**members, "type": ["object"]}), consumer, {"a": "a"}
    ).compatible


def test_what_stands_beside_a_reference_is_of_the_field_that_is_scaled() -> None:
    producer = {
        **closed(a={"$ref": "#/$defs/n", "x-unit": "m"}),
        "$defs": {"n": {"type": "number"}},
    }
    consumer = MessageStructure(closed(a={"type": "number", "x-unit": "s"}))
    rule = {"a": {"from": "a", "scale": 2}}
    verdict = check_edge(MessageStructure(producer), consumer, rule)
    assert "the map makes s of m by a factor" in verdict.warnings[0]


def test_every_loss_must_be_allowed_however_many_there_are() -> None:
    names = [f"f{number}" for number in range(300)]
    producer = MessageStructure(closed(**{name: {"type": "number"} for name in names}))
    consumer = MessageStructure(closed(a={"type": "number"}))
    refused = check_edge(producer, consumer, {"a": "f0"}, tuple(names[1:201]))
    assert "'f201'" in refused.reasons[0].sentence
    allowed = check_edge(producer, consumer, {"a": "f0"}, tuple(names[1:]))
    assert allowed.compatible
    assert len(allowed.losses) == 299


LONG = 10**5000


@pytest.mark.parametrize(
    "keywords",
    [
        {"const": LONG},
        {"enum": [LONG, "a"]},
        {"minimum": LONG},
        {"multipleOf": LONG},
        {"type": LONG},
        {"required": [LONG]},
        {"$ref": LONG},
        {"format": LONG},
        {"x-max-json": LONG},
        {"x-max-utf8": LONG},
    ],
)
@pytest.mark.parametrize("rule", [None, {"from": "a", "scale": 2}, {"const": LONG}])
def test_numbers_that_python_does_not_write_get_a_verdict(keywords: Any, rule: Any) -> None:
    mapping = None if rule is None else {"a": rule}
    whole = MessageStructure({"type": "object", "properties": {"a": keywords}, "required": ["a"]})
    for schema in (True, {"type": "string"}, {"const": LONG + 1}, {"type": "integer"}):
        inside = {"type": "object", "properties": {"a": schema}, "required": ["a"]}
        other = MessageStructure(inside)
        assert other == MessageStructure(dict(inside))
        assert other != whole
        for producer, consumer in ((whole, other), (other, whole)):
            verdict = check_edge(producer, consumer, mapping)
            assert verdict.compatible or all(reason.sentence for reason in verdict.reasons)


@pytest.mark.parametrize("key", ["scale", "clamp"])
def test_a_map_with_a_number_that_python_does_not_write_is_refused_in_words(key: str) -> None:
    structure = MessageStructure({"type": "object", "properties": {"a": {"type": "integer"}}})
    verdict = check_edge(structure, structure, {"a": {"from": "a", key: [LONG]}})
    assert "[a whole number of 16,610 bits]" in verdict.reasons[0].sentence


def test_a_message_with_a_number_that_python_does_not_write_is_refused_in_words() -> None:
    for value in (LONG, [LONG], {"a": LONG}):
        check = make_check(MessageStructure({"type": "string"}), ValidationMode.ALWAYS, "here")
        assert check is not None
        with pytest.raises(MessageError, match="a whole number of 16,610 bits"):
            check(value)


def test_values_of_any_kind_are_written_in_words() -> None:
    for write in (clip, shown, cdr_values.shown):
        for value in (LONG, [LONG], {"a": (LONG,)}):
            assert "a whole number of 16,610 bits" in write(value)


@pytest.mark.parametrize("number", [1e10, -1e10])
def test_a_number_that_scaling_makes_infinite_is_refused(number: float) -> None:
    rows = {"type": "array", "items": {"type": "number"}}
    field = adapt(parse({"a": {"from": "a", "scale": 1e300}}), closed(a={"type": "number"}), ANY)
    row = adapt(parse({"a": {"from": "a", "scale": 1e300}}), closed(a=rows), ANY)
    for make, value in (
        (field.make, number),
        (field.make, np.float64(number)),
        (row.make, [1.0, number]),
        (row.make, np.array([1.0, number])),
        (row.make, np.array([1, int(number)])),
    ):
        with pytest.raises(MessageError, match="a: a scaled number is beyond those of a float"):
            make({"a": value})
    for value in (np.inf, -np.inf):  # as it came: what its producer may emit is another question
        assert field.make({"a": value})["a"] == value
        assert row.make({"a": np.array([value, np.nan, 1.0])})["a"][0] == value


def test_what_would_be_infinite_may_be_clamped() -> None:
    rule = {"from": "a", "scale": 1e300, "clamp": [0, 9]}
    make = adapt(
        parse({"a": rule}), closed(a={"type": "array", "items": {"type": "number"}}), ANY
    ).make
    assert make({"a": [1e10, 0.0]})["a"] == [9, 0]
    assert make({"a": np.array([1e10, 0.0])})["a"].tolist() == [9, 0]
