"""What the quick look accepts, the whole validator accepts; ordinary messages need no more."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Mapping

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.strategies import DataObject, data
from tests.schema._strategies import Body, schemas
from tests.structures import closed
from tests.sweeps import for_all

from uoarm.bridge._compiled_check import Accepts, compile_check
from uoarm.bridge._full_validator import validator_of
from uoarm.model import Message, Schema
from uoarm.testing._instances import Builder, DrawnChoices, mutate

FLOAT32 = {"type": "number", "minimum": -3.4028234663852886e38, "maximum": 3.4028234663852886e38}
NONFINITE = FLOAT32 | {"x-nonfinite": True}
OCTETS = {"type": "array", "items": {"type": "integer", "minimum": 0, "maximum": 255}}


SCAN = closed(
    header=closed(stamp={"type": "number"}, frame_id={"type": "string"}),
    ranges={"type": "array", "items": NONFINITE, "maxItems": 2000},
    data=OCTETS | {"x-octets": True},
    mode={"enum": ["idle", "busy", None]},
    pose={"anyOf": [closed(x={"type": "number", "minimum": 0}), {"type": "null"}]},
    grid={"type": "array", "items": {"type": "array", "items": {"type": "number"}, "minItems": 3}},
    names={"type": ["array", "null"], "items": {"type": "string", "maxLength": 9}},
    count={"type": "integer", "minimum": 0},
    on={"type": "boolean"},
)
SCANS: dict[str, Message] = {
    "plain": {
        "header": {"stamp": 1.5, "frame_id": "laser"},
        "ranges": [1.0, math.inf, math.nan, 2],
        "data": b"\x00\xff",
        "mode": "idle",
        "pose": {"x": 1},
        "grid": [[1.0, 2.0, 3.0]],
        "names": ["a", "b"],
        "count": 3,
        "on": True,
    }
}
SCANS["others"] = SCANS["plain"] | {"pose": None, "names": None, "mode": None, "data": [1, 2]}
SCANS["numpy"] = SCANS["plain"] | {
    "ranges": np.array([1.0, math.inf, math.nan], np.float32),
    "data": np.zeros(10, np.uint8),
    "grid": np.ones((4, 3)),
}
SCANS["buffers"] = SCANS["plain"] | {
    "ranges": array("f", [1.0, math.inf, math.nan]),
    "data": memoryview(b"ab"),
}


@pytest.mark.parametrize("name", SCANS)
def test_an_ordinary_message_is_known_without_the_whole_validator(name: str) -> None:
    assert compile_check(SCAN, _never_asked)(SCANS[name])
    assert validator_of(SCAN).is_valid(SCANS[name])


TREE = {
    "$ref": "#/$defs/node",
    "$defs": {
        "node": closed(
            name={"type": "string"}, children={"type": "array", "items": {"$ref": "#/$defs/node"}}
        )
    },
}


def test_a_structure_may_refer_to_itself() -> None:
    leaf = {"name": "b", "children": []}
    accepts = compile_check(TREE, _never_asked)
    assert accepts({"name": "a", "children": [leaf, leaf]})
    assert not accepts({"name": "a", "children": [{"name": 1, "children": []}]})


@given(schemas, data())
def test_whatever_is_accepted_at_once_is_valid(schema: Body, more: DataObject) -> None:
    choices = DrawnChoices(more.draw)
    built = Builder(schema, choices).candidate()
    value: Message = more.draw(
        _as_messages_are(more.draw(st.sampled_from([built, mutate(choices, built)])))
    )
    whole = validator_of(schema)
    if compile_check(schema, lambda part: whole.evolve(schema=part).is_valid)(value):
        assert whole.is_valid(value)


numbers = st.one_of(
    st.integers(-5, 300),
    st.floats(width=32),
    st.sampled_from([math.inf, -math.inf, math.nan, True, 2**2000, 1e300, np.int8(3), np.True_]),
    st.lists(st.floats(width=32), max_size=4).map(lambda made: np.array(made, np.float32)),
    st.lists(st.floats(), max_size=4).map(lambda made: array("d", made)),
    st.lists(st.integers(0, 255), max_size=4).map(bytes),
    st.lists(st.integers(-9, 99), max_size=4).map(lambda made: np.array(made, np.int16)),
    st.lists(st.booleans(), max_size=2).map(np.array),
    st.just(np.ones((2, 2))),
)
ranges = st.fixed_dictionaries(
    {"type": st.sampled_from(["integer", "number", "boolean"])},
    optional={
        "minimum": st.integers(-5, 5) | st.just(-3.4028234663852886e38),
        "maximum": st.sampled_from([3, 4.5, 255, 65535, 3.4028234663852886e38]),
        "exclusiveMaximum": st.integers(-5, 5),
        "x-nonfinite": st.booleans(),
    },
)


@given(numbers | st.lists(numbers, max_size=4), ranges, st.integers(0, 2))
def test_numbers_and_arrays_of_them_accepted_at_once_are_valid(
    value: Message, schema: dict[str, object], depth: int
) -> None:
    for _ in range(depth):
        schema = {"type": "array", "items": schema, "maxItems": 3}
    if compile_check(schema, _knows_nothing)(value):
        assert validator_of(schema).is_valid(value)


FORMS: dict[str, Callable[[float], Message]] = {
    "number": lambda item: item,
    "list": lambda item: [1.0, item],
    "numpy": lambda item: np.array([1.0, item, 2.0]),
    "array": lambda item: array("f", [1.0, item, 2.0]),
}


@for_all("bounds", [{}, {"maximum": 5}, {"exclusiveMaximum": 5}, FLOAT32])
@for_all("nonfinite", [True, False])
@for_all("value", [math.nan, math.inf, -math.inf, np.float32(math.inf)])
@for_all("form", FORMS)
def test_what_is_not_finite_is_within_a_range_only_where_the_structure_says_so(
    bounds: Mapping[str, object], nonfinite: bool, value: float, form: str
) -> None:
    message = FORMS[form](value)
    schema: dict[str, object] = {"type": "number", **bounds, "x-nonfinite": nonfinite}
    if form != "number":
        schema = {"type": "array", "items": schema}
    below = value == -math.inf and bounds is not FLOAT32  # these have no least number
    expected = bool(nonfinite or not bounds or below)
    assert validator_of(schema).is_valid(message) is expected
    accepts = compile_check(schema, lambda part: validator_of(part).is_valid)
    assert accepts(message) is expected


def _never_asked(_: Schema) -> Accepts:
    def judge(value: object) -> bool:
        raise AssertionError(f"the whole validator was asked about {value!r}")

    return judge


def _knows_nothing(_: Schema) -> Accepts:
    return lambda _: False


def _as_messages_are(value: object) -> st.SearchStrategy[object]:
    """Values with some lists of numbers as buffers and tuples."""
    if isinstance(value, dict):
        return st.fixed_dictionaries({name: _as_messages_are(item) for name, item in value.items()})
    if not isinstance(value, list):
        return st.just(value)
    forms: list[st.SearchStrategy[object]] = [
        st.tuples(*map(_as_messages_are, value)).map(list),
        st.just(tuple(value)),
    ]
    kinds = set(map(type, value))
    if kinds == {float}:
        forms += [st.just(np.array(value)), st.just(array("d", value))]
    elif kinds == {int} and all(0 <= item < 256 for item in value):
        forms += [st.just(bytes(value)), st.just(np.array(value, np.uint8))]
    return st.one_of(forms)
