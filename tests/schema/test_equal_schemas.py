"""Equal schemas are read once; only those that mean the same are equal."""

from __future__ import annotations

import copy
import gc
import math
from types import MappingProxyType
from typing import Any

import pytest

from uoarm.schema import CheckBudget, SchemaError, check

ALIKE_IN_PYTHON: list[tuple[Any, Any]] = [
    ({"const": 1}, {"const": True}),
    ({"enum": [0]}, {"enum": [False]}),
    ({"const": [1]}, {"const": [True]}),
    ({"const": {"a": 1}}, {"const": {"a": True}}),
    ({"const": (1,)}, {"const": (True,)}),
    (MappingProxyType({"const": 1}), MappingProxyType({"const": True})),
    ({"const": MappingProxyType({"a": 1})}, {"const": MappingProxyType({"a": True})}),
]


@pytest.mark.parametrize(("producer", "consumer"), ALIKE_IN_PYTHON)
def test_what_is_equal_to_python_alone_is_not_equal(producer: Any, consumer: Any) -> None:
    assert producer == consumer
    assert check(producer, consumer).incompatible


@pytest.mark.parametrize("keyword", ["$ref", "$dynamicRef"])
def test_equal_texts_with_references_that_lead_out_stay_two(keyword: str) -> None:
    verdicts = [check({keyword: "other.json"}, {keyword: "other.json"}) for _ in range(2)]
    assert all(verdict.undecided is not None for verdict in verdicts)


def test_equal_schemas_are_read_once() -> None:
    one, other = ({"type": "object", "required": [f"f{n}" for n in range(9)],
                   "properties": {f"f{n}": {"type": "number"} for n in range(9)}}
                  for _ in range(2))  # fmt: skip
    budget = CheckBudget(steps=_steps(one, {}) + 20)
    assert check(one, other, budget=budget).compatible


def _steps(producer: Any, consumer: Any) -> int:
    """The fewest steps that the check of a pair needs."""
    most = 1
    while check(producer, consumer, budget=CheckBudget(steps=most)).undecided is not None:
        most += 1
    return most


@pytest.mark.parametrize(
    ("malformed", "expected"),
    [
        ({"const": {1: 2}}, "a JSON value"),
        ({"enum": [math.inf]}, "a JSON value"),
        ({"const": [math.nan]}, "a JSON value"),
        ({"items": {"const": object}}, "a JSON value"),
        ({"items": {"minimum": "1"}}, "#/items/minimum: expected a finite number"),
        ({"properties": {"a": {"type": "x"}}}, "#/properties/a/type: expected a type"),
    ],
)
def test_a_malformed_schema_is_refused_beside_its_equal(malformed: Any, expected: str) -> None:
    with pytest.raises(SchemaError, match=expected):
        check(malformed, dict(malformed))


@pytest.mark.parametrize(
    ("producer", "consumer"),
    [
        ({"const": 1}, {"const": True}),
        ({"const": True}, {"const": 1}),
        ({"const": 0.0}, {"const": False}),
        ({"maximum": 1e23}, {"maximum": int(1e23)}),
    ],
)
def test_fields_that_are_equal_to_python_alone_are_read_apart(producer: Any, consumer: Any) -> None:
    """Small schemas that were met before in the same check are not read again."""
    verdict = check(*({"properties": {"a": item}} for item in (producer, consumer)))
    assert verdict.incompatible
    both = {"properties": {"a": producer, "b": consumer}}
    swapped = {"properties": {"a": consumer, "b": producer}}
    assert check(both, swapped).incompatible
    assert check(both, dict(reversed(both.items()))).compatible


def test_what_is_declared_beside_the_shape_is_reported_of_each_field() -> None:
    date, time = ({"type": "string", "format": kind} for kind in ("date", "time"))
    producer = {"type": "object", "properties": {"a": date, "b": dict(date)}}
    consumer = {"type": "object", "properties": {"a": dict(date), "b": time}}
    assert [loss.path for loss in check(producer, consumer).losses] == ["b"]
    assert not check(producer, {**producer}).losses


@pytest.mark.parametrize(
    ("producer", "consumer"),
    [
        ({"items": {"type": "number"}}, {"items": {"type": "integer"}}),
        ({"$defs": {"n": {"items": {"$ref": "#/$defs/n"}}}, "$ref": "#/$defs/n"}, {"maxItems": 2}),
        ({"pattern": "^(a|b)*$"}, {"not": {"pattern": "a"}}),
        ({"const": 10**40_000}, {"type": "string"}),
    ],
)
def test_a_check_leaves_nothing_to_the_collector_of_garbage(producer: Any, consumer: Any) -> None:
    check(producer, consumer)
    gc.collect()
    gc.disable()
    try:
        check(producer, consumer)
        assert gc.collect() == 0
    finally:
        gc.enable()


def test_parts_that_are_equal_in_both_are_read_once() -> None:
    fields = {f"f{n}": {"type": "array", "items": {"maximum": n}} for n in range(50)}
    one: dict[str, Any] = {"properties": {"a": {"properties": fields}, "b": {"type": "null"}}}
    other = {"properties": {"a": copy.deepcopy(one["properties"]["a"]), "b": {"type": "string"}}}
    alone = {"properties": {"b": {"type": "string"}}}
    assert _steps(one, other) <= _steps(one, alone) + 20


def test_names_of_keywords_as_names_of_members_change_nothing() -> None:
    """A schema that such a name keeps from being compared by its text is read all the same."""
    one = {"properties": {"$ref": {"type": "integer"}, "id": {"type": "integer"}}}
    assert check(one, copy.deepcopy(one)).compatible
    assert check({"properties": {"$ref": {}}}, one).incompatible
