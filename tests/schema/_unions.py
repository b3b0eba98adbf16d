"""Random logic over ranges, tagged records and rows, each in a world small enough to try whole."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

from tests.schema._reference import Reference

from uoarm.testing._instances import chance

if TYPE_CHECKING:
    from collections.abc import Callable

    from uoarm.testing._instances import Choices

Schema = dict[str, object]
Body = bool | Schema

_HALVES: Schema = {"multipleOf": 0.5, "minimum": -2, "maximum": 8, "type": "number"}
_NUMBERS: list[object] = [n / 2 if n % 2 else n // 2 for n in range(-4, 17)]
_ABSENT = object()
_FIELDS: dict[str, tuple[object, ...]] = {"kind": (0, 1, 2, "t"), "mode": (0, 1), "b": (0, "s")}
_RECORDS: Schema = {
    "type": "object",
    "properties": {name: {"enum": list(values)} for name, values in _FIELDS.items()},
    "additionalProperties": False,
}
_ROWS: list[object] = [
    {name: value for name, value in zip(_FIELDS, row, strict=True) if value is not _ABSENT}
    for row in product(*((_ABSENT, *values) for values in _FIELDS.values()))
]
_ITEMS = (0, 1, 2, "s")
_SHORT: Schema = {"type": "array", "items": {"enum": list(_ITEMS)}, "maxItems": 4}
_ARRAYS: list[object] = [list(row) for n in range(5) for row in product(_ITEMS, repeat=n)]
_RULES: tuple[Body, ...] = (
    True, {"type": "integer"}, {"const": 0}, {"const": "s"}, {"not": {"const": 1}},
    {"maximum": 1}, {"enum": [1, 2, "s"]},
)  # fmt: skip


def range_pair(choices: Choices) -> tuple[Body, Body, str]:
    return _pair(choices, _HALVES, _NUMBERS, _ranges)


def tagged_pair(choices: Choices) -> tuple[Body, Body, str]:
    return _pair(choices, _RECORDS, _ROWS, _record)


def row_pair(choices: Choices) -> tuple[Body, Body, str]:
    return _pair(choices, _SHORT, _ARRAYS, _row)


def _pair(
    choices: Choices, world: Schema, everything: list[object], leaf: Callable[[Choices], Schema]
) -> tuple[Body, Body, str]:
    producer: Schema = {"allOf": [world, _logic(choices, leaf, 2)]}
    consumer = _logic(choices, leaf, 3)
    takes, wants = Reference(producer).accepts, Reference(consumer).accepts
    fits = all(wants(value) for value in everything if takes(value))
    return producer, consumer, "yes" if fits else "no"


def _logic(choices: Choices, leaf: Callable[[Choices], Schema], depth: int) -> Schema:
    if depth == 0 or chance(choices, 15):
        return leaf(choices)
    keyword = choices.item(("anyOf", "anyOf", "oneOf", "oneOf", "allOf", "not", "if"))
    if keyword == "not":
        return {"not": _logic(choices, leaf, depth - 1)}
    if keyword == "if":
        return {part: _logic(choices, leaf, depth - 1) for part in ("if", "then", "else")}
    count = choices.integer(1, 5 if depth == 1 else 3)
    made: Schema = {keyword: [_logic(choices, leaf, depth - 1) for _ in range(count)]}
    return {**leaf(choices), **made} if chance(choices, 20) else made


def _ranges(choices: Choices) -> Schema:
    schema: Schema = {}
    if chance(choices, 80):
        low = choices.integer(-4, 14) / 2
        schema[choices.item(("minimum", "exclusiveMinimum"))] = low
        if chance(choices, 80):
            high = low + choices.integer(0, 8) / 2
            schema[choices.item(("maximum", "exclusiveMaximum"))] = high
    if chance(choices, 20):
        schema["type"] = choices.item(("integer", "number", "string"))
    if chance(choices, 20):
        schema["multipleOf"] = choices.item((1, 2, 0.5, 1.5))
    if chance(choices, 10):
        schema["enum"] = [choices.item(_NUMBERS) for _ in range(3)]
    return schema


def _record(choices: Choices) -> Schema:
    properties: dict[str, object] = {}
    for name, values in _FIELDS.items():
        if chance(choices, 90 if name == "kind" else 40):
            few = [value for value in values if chance(choices, 40)]
            properties[name] = {"enum": few} if chance(choices, 40) else {"const": values[0]}
            if few and chance(choices, 70):
                properties[name] = {"const": few[0]}
    schema: Schema = {"properties": properties}
    schema["required"] = [name for name in properties if chance(choices, 75)]
    if chance(choices, 50):
        schema["additionalProperties"] = False
    if chance(choices, 50):
        schema["type"] = "object"
    return {"allOf": [schema]} if chance(choices, 10) else schema


def _row(choices: Choices) -> Schema:
    schema: Schema = {}
    if chance(choices, 50):
        schema["uniqueItems"] = True
    if chance(choices, 50):
        schema["contains"] = choices.item(_RULES)
        if chance(choices, 50):
            schema["minContains"] = choices.integer(0, 3)
        if chance(choices, 40):
            schema["maxContains"] = choices.integer(0, 3)
    if chance(choices, 30):
        schema["prefixItems"] = [choices.item(_RULES) for _ in range(choices.integer(1, 2))]
    if chance(choices, 30):
        schema["items"] = choices.item(_RULES)
    if chance(choices, 30):
        schema["minItems"] = choices.integer(1, 4)
    if chance(choices, 20):
        schema["maxItems"] = choices.integer(1, 3)
    return schema or {"uniqueItems": True}
