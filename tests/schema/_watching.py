"""Random schemas in which one keyword depends on what others saw, over a world of known size.

The world is every object over four names and every array of up to three items, of few values each,
so that the truth about a pair is found by trying all of it.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

from tests.schema._reference import Reference
from tests.schema._rewrites import negated

from uoarm.testing._instances import chance

if TYPE_CHECKING:
    from uoarm.testing._instances import Choices

Schema = dict[str, object]
Body = bool | Schema

_NAMES = ("a", "b", "c", "x-a")
_VALUES = (0, 1, "s")
_ABSENT = object()
_VALUE = {"enum": list(_VALUES)}
_WORLD: Schema = {
    "anyOf": [
        {
            "type": "object",
            "properties": dict.fromkeys(_NAMES, _VALUE),
            "additionalProperties": False,
        },
        {"type": "array", "items": _VALUE, "maxItems": 3},
    ]
}
_RULES: tuple[Body, ...] = (
    True, False, {"type": "integer"}, {"const": 0}, {"type": "string"}, {"not": {"const": 1}},
)  # fmt: skip


def world() -> list[object]:
    arrays = [list(row) for n in range(4) for row in product(_VALUES, repeat=n)]
    rows = product((_ABSENT, *_VALUES), repeat=len(_NAMES))
    objects = [
        {name: value for name, value in zip(_NAMES, row, strict=True) if value is not _ABSENT}
        for row in rows
    ]
    return [*arrays, *objects]


_EVERYTHING = world()


def watching_pair(choices: Choices) -> tuple[Body, Body, str]:
    """A producer within the world, a consumer, and the true answer."""
    inner, consumer = _document(choices), _document(choices)
    consumer = negated(consumer) if chance(choices, 25) else consumer
    assert isinstance(inner, dict)
    defs = {"$defs": inner.pop("$defs")}
    producer: Body = {**defs, "allOf": [_WORLD, inner]}
    if chance(choices, 25):
        producer = {**defs, "allOf": [_WORLD, {"not": inner}]}
    takes, wants = Reference(producer).accepts, Reference(consumer).accepts
    fits = all(wants(value) for value in _EVERYTHING if takes(value))
    return producer, consumer, "yes" if fits else "no"


def _document(choices: Choices) -> Body:
    shared = [_part(choices, 1), _plain(choices)]
    return {
        **_watcher(choices, choices.item((1, 1, 2))),
        "$defs": {"d0": shared[0], "d1": shared[1]},
    }


def _watcher(choices: Choices, depth: int) -> Schema:
    """A schema with an unevaluated keyword beside what it watches."""
    schema = _part(choices, depth)
    for keyword in ("unevaluatedProperties", "unevaluatedItems"):
        if chance(choices, 60):
            schema[keyword] = choices.item((False, *_RULES))
    return schema


def _part(choices: Choices, depth: int) -> Schema:
    schema = _plain(choices) if chance(choices, 40) else {}
    if depth == 0:
        return schema or _plain(choices)
    for _ in range(choices.integer(1, 2)):
        schema.update(_applied(choices, depth - 1))
    return schema


def _inner(choices: Choices, depth: int) -> Body:
    if chance(choices, 6):
        return choices.item((True, False))
    if chance(choices, 12):
        return _watcher(choices, depth)
    return _part(choices, depth)


def _applied(choices: Choices, depth: int) -> Schema:
    keyword = choices.item(
        ("allOf", "anyOf", "anyOf", "oneOf", "if", "not", "dependentSchemas", "$ref")
    )
    if keyword == "if":
        made: Schema = {"if": _inner(choices, depth)}
        for branch in ("then", "else"):
            if chance(choices, 75):
                made[branch] = _inner(choices, depth)
        return made
    if keyword == "not":
        return {"not": _inner(choices, depth)}
    if keyword == "dependentSchemas":
        return {keyword: {choices.item(_NAMES): _inner(choices, depth)}}
    if keyword == "$ref":
        return {"$ref": f"#/$defs/d{choices.integer(0, 1)}"} if depth > 0 else _plain(choices)
    return {keyword: [_inner(choices, depth) for _ in range(choices.integer(1, 3))]}


def _plain(choices: Choices) -> Schema:
    schema: Schema = {}
    if chance(choices, 60):
        names = [name for name in _NAMES if chance(choices, 40)]
        schema["properties"] = {name: choices.item(_RULES) for name in names}
    if chance(choices, 35):
        schema["required"] = [name for name in _NAMES if chance(choices, 30)]
    if chance(choices, 20):
        schema["patternProperties"] = {choices.item(("^x-", "[ab]", "a$")): choices.item(_RULES)}
    if chance(choices, 10):
        schema["additionalProperties"] = choices.item(_RULES)
    if chance(choices, 10):
        schema["propertyNames"] = {"pattern": choices.item(("^[abc]$", "a"))}
    if chance(choices, 8):
        schema["maxProperties"] = choices.integer(0, 2)
    if chance(choices, 40):
        schema["prefixItems"] = [choices.item(_RULES) for _ in range(choices.integer(1, 2))]
    if chance(choices, 10):
        schema["items"] = choices.item(_RULES)
    if chance(choices, 30):
        schema["contains"] = choices.item(_RULES)
        if chance(choices, 40):
            schema["minContains"] = choices.integer(0, 2)
        if chance(choices, 25):
            schema["maxContains"] = choices.integer(1, 2)
    if chance(choices, 15):
        schema[choices.item(("minItems", "minProperties"))] = choices.integer(1, 2)
    if chance(choices, 8):
        schema["uniqueItems"] = True
    return schema
