"""Random schemas with finitely many instances, all of them known: an oracle that is exact."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

from tests.schema._hand_schemas import hand_schema
from tests.schema._reference import Reference, frozen
from tests.schema._universe import SCALARS

from uoarm.testing._instances import chance

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from uoarm.testing._instances import Choices

Schema = dict[str, object]
Finite = tuple[Schema, list[object]]

_MOST = 300
_NAMES = ("a", "b", "c")
_ABSENT = object()


def finite_schema(choices: Choices, depth: int = 2) -> Finite:
    """A schema and every value that is valid for it."""
    makers: list[Callable[[Choices, int], Finite]] = [_members, _range, _words]
    if depth > 0:
        makers += [_array, _object, _object, _union, _restricted, _restricted]
    schema, values = choices.item(makers)(choices, depth)
    return (schema, values) if len(values) <= _MOST else _members(choices, depth)


def _members(choices: Choices, _: int) -> Finite:
    kind = choices.item(("boolean", "null", "const", "enum"))
    if kind == "boolean":
        return {"type": "boolean"}, [True, False]
    if kind == "null":
        return {"type": "null"}, [None]
    values = [choices.item(SCALARS) for _ in range(choices.integer(1, 4))]
    if kind == "const":
        return {"const": values[0]}, values[:1]
    return {"enum": values}, _distinct(values)


def _range(choices: Choices, _: int) -> Finite:
    low = choices.integer(-2, 3)
    high = low + choices.integer(0, 5)
    step = choices.item((1, 1, 2, 3))
    schema: Schema = {"type": "integer", "minimum": low, "exclusiveMaximum": high + 1}
    if step != 1:
        schema["multipleOf"] = step
    return schema, [n for n in range(low, high + 1) if n % step == 0]


def _words(choices: Choices, _: int) -> Finite:
    words = ("", "a", "b", "aa", "ab", "ba", "bb")
    longest = choices.integer(0, 2)
    schema: Schema = {"type": "string", "pattern": "^[ab]*$", "maxLength": longest}
    return schema, [word for word in words if len(word) <= longest]


def _array(choices: Choices, depth: int) -> Finite:
    items, values = finite_schema(choices, depth - 1)
    low = choices.integer(0, 2)
    high = choices.integer(low, 2 if len(values) > 4 else 3)
    schema: Schema = {"type": "array", "items": items, "minItems": low, "maxItems": high}
    found = [list(row) for n in range(low, high + 1) for row in product(values, repeat=n)]
    if chance(choices, 30):
        schema["uniqueItems"] = True
        found = [row for row in found if len(_distinct(row)) == len(row)]
    return schema, list[object](found)


def _object(choices: Choices, depth: int) -> Finite:
    properties: Schema = {}
    required: list[str] = []
    columns: list[list[object]] = []
    for name in _NAMES[: choices.integer(0, 3)]:
        properties[name], values = finite_schema(choices, depth - 1)
        if chance(choices, 60):
            required.append(name)
            columns.append(values)
        else:
            columns.append([_ABSENT, *values])
        if _size(columns) > _MOST:
            return _members(choices, depth)
    schema: Schema = {
        "type": "object",
        "properties": properties,
        "required": required,
        "additionalProperties": False,
    }
    rows = product(*columns)
    return schema, [
        {name: value for name, value in zip(properties, row, strict=True) if value is not _ABSENT}
        for row in rows
    ]


def _union(choices: Choices, depth: int) -> Finite:
    one, its = finite_schema(choices, depth - 1)
    other, others = finite_schema(choices, depth - 1)
    return {"anyOf": [one, other]}, _distinct([*its, *others])


def _restricted(choices: Choices, depth: int) -> Finite:
    schema, values = finite_schema(choices, depth - 1)
    rule = hand_schema(choices, 1)
    if chance(choices, 40):
        rule = {"not": rule}
    restricted: Schema = {"allOf": [schema, rule]}
    accepts = Reference(restricted).accepts
    return restricted, [value for value in values if accepts(value)]


def _size(columns: Iterable[list[object]]) -> int:
    size = 1
    for column in columns:
        size *= len(column)
    return size


def _distinct(values: Iterable[object]) -> list[object]:
    return list({frozen(value): value for value in values}.values())
