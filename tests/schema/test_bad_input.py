"""Schemas are untrusted: a malformed one gives one clear error, a hostile one gives an answer."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, cast

import pytest
from hypothesis import given
from hypothesis.strategies import DataObject, data
from tests.schema._judge import answer
from tests.schema._random_choices import RandomChoices
from tests.schema._strategies import Body, any_schema, schemas

from uoarm.schema import SchemaError, check
from uoarm.testing._instances import Choices, DrawnChoices, chance

if TYPE_CHECKING:
    from collections.abc import Sequence

JUNK: Sequence[object] = (
    None, True, False, 0, -1, 1.5, 10**400, math.inf, math.nan, "", "a", "(", "#", [], [[]], [1],
    ["a", "a"], {}, {"a": 1}, {"$ref": "#"}, {"type": "nothing"}, [{}, 3], [{"$ref": "#/x"}],
)  # fmt: skip

MALFORMED: dict[str, object] = {
    "an unknown type": {"type": "float"},
    "a type that is a number": {"type": 12},
    "types that are numbers": {"type": ["string", 1]},
    "a bound that is text": {"minimum": "0"},
    "a bound that is a boolean": {"minimum": True},
    "a bound that is no number": {"minimum": math.nan},
    "multiples of zero": {"multipleOf": 0},
    "multiples of a negative": {"multipleOf": -1},
    "a negative length": {"maxLength": -1},
    "half a length": {"maxLength": 0.5},
    "a pattern that is a number": {"pattern": 3},
    "a pattern that does not parse": {"pattern": "("},
    "a name pattern that does not parse": {"patternProperties": {"[": {}}},
    "an enum that is no list": {"enum": "a"},
    "required that is no list": {"required": "a"},
    "required that is not text": {"required": [1]},
    "properties that are a list": {"properties": ["a"]},
    "a property that is no schema": {"properties": {"a": 3}},
    "items that are a list of numbers": {"items": [5]},
    "items that are no schema": {"items": "integer"},
    "prefixItems that are a mapping": {"prefixItems": {}},
    "an empty union": {"anyOf": []},
    "a union that is a mapping": {"anyOf": {}},
    "a branch that is no schema": {"oneOf": [{}, 3]},
    "not a schema": {"not": 3},
    "a reference that is a number": {"$ref": 3},
    "a reference into nothing": {"$ref": "#/$defs/none"},
    "an anchor that is not there": {"$ref": "#none"},
    "a reference to what is no schema": {"$defs": {"a": 3}, "$ref": "#/$defs/a"},
    "a reference to a place of 5,000 digits": {"allOf": [{"$ref": f"#/allOf/{'9' * 5000}"}]},
    "a reference that is no URI": {"$id": "http://a/", "allOf": [{"$ref": "//["}]},
    "an identifier that is no URI": {"$id": "http://a/", "allOf": [{"$id": "//["}]},
    "a schema that is a list": [],
    "a schema that is null": None,
    "a schema that is text": "integer",
    "a constant that is no JSON": {"const": object()},
    "a keyword that is not text": {1: {}},
    "names that are not text": {"properties": {1: {}}},
    "uniqueItems that is a number": {"uniqueItems": 1},
    "dependentRequired that is no list": {"dependentRequired": {"a": "b"}},
}


@pytest.mark.parametrize("schema", MALFORMED.values(), ids=MALFORMED.keys())
@pytest.mark.parametrize("side", ["producer", "consumer"])
def test_a_malformed_schema_is_one_clear_error(schema: Body, side: str) -> None:
    pair: tuple[Body, Body] = (schema, {"type": "integer"})
    producer, consumer = pair if side == "producer" else pair[::-1]
    with pytest.raises(SchemaError) as caught:
        check(producer, consumer)
    assert str(caught.value).strip()


@pytest.mark.parametrize(
    "schema",
    [
        {"$ref": "#"},
        {"allOf": [{"$ref": "#"}]},
        {"not": {"$ref": "#"}},
        {"anyOf": [{"$ref": "#"}, {"type": "integer"}]},
        {"$defs": {"a": {"$ref": "#/$defs/b"}, "b": {"$ref": "#/$defs/a"}}, "$ref": "#/$defs/a"},
        {"$ref": "other.json#/x"},
        {"$ref": "tag:nowhere,2026:x"},
        {"$dynamicRef": "#node"},
        {"$schema": "tag:nowhere,2026:unknown-dialect", "type": "integer"},
    ],
    ids=str,
)
def test_what_cannot_be_known_is_undecided_or_an_error(schema: Body) -> None:
    text: Body = {"type": "string"}
    assert answer_or_error(schema, text) in {"undecided", "error"}
    assert answer_or_error(text, schema) in {"undecided", "error"}


def test_a_count_of_5000_digits_in_a_pattern_is_undecided() -> None:
    counted: Body = {"type": "string", "pattern": f"^a{{{'9' * 5000}}}$"}
    assert answer_or_error(counted, {"type": "string", "maxLength": 3}) == "undecided"


def test_an_alias_bomb_ends() -> None:
    producer: Body = {"type": "integer"}
    consumer: Body = {"type": "number"}
    for _ in range(60):
        producer = {"type": "object", "properties": {"l": producer, "r": producer}}
        consumer = {"type": "object", "properties": {"l": consumer, "r": consumer}}
    assert answer(check(producer, consumer)) in {"yes", "undecided"}


def test_a_schema_that_holds_itself_ends() -> None:
    schema: dict[str, object] = {"type": "object"}
    schema["properties"] = {"a": schema}
    answer_or_error(schema, {"type": "object"})


@pytest.mark.parametrize("keyword", ["properties", "items", "allOf", "not", "enum", "$defs"])
def test_a_hundred_thousand_levels_end(keyword: str) -> None:
    schema: dict[str, object] = {}
    for _ in range(100_000):
        nests: dict[str, object] = {
            "properties": {"a": schema},
            "allOf": [schema],
            "enum": [schema],
            "$defs": {"a": schema},
        }
        schema = {keyword: nests.get(keyword, schema)}
    answer_or_error(schema, {"type": "string"})


@given(schemas, data())
def test_damaged_schemas_raise_nothing_else(schema: Body, more: DataObject) -> None:
    _try_damaged(DrawnChoices(more.draw), schema)


@pytest.mark.parametrize("block", range(4))
def test_damaged_schemas_by_seed(block: int) -> None:
    for seed in range(500 * block, 500 * block + 500):
        choices = RandomChoices(seed)
        _try_damaged(choices, any_schema(choices))


def _try_damaged(choices: Choices, schema: Body) -> None:
    damaged = cast("Body", _damaged(choices, schema))
    answer_or_error(damaged, schema)
    answer_or_error(schema, damaged)


def answer_or_error(producer: Body, consumer: Body) -> str:
    try:
        return answer(check(producer, consumer))
    except SchemaError as error:
        return "error" if str(error).strip() else "an error without a word"


def _damaged(choices: Choices, node: object) -> object:
    """The schema with one value replaced by something that has no business there."""
    if isinstance(node, dict) and node and not chance(choices, 15):
        key = choices.item(list(node))
        return {**node, key: _damaged(choices, node[key])}
    if isinstance(node, list) and node:
        place = choices.integer(0, len(node) - 1)
        return [*node[:place], _damaged(choices, node[place]), *node[place + 1 :]]
    return choices.item(JUNK)
