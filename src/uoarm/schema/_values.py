"""JSON values compared as JSON Schema compares them: exact numbers, no booleans among them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from fractions import Fraction
from typing import TypeAlias

from uoarm.schema._errors import OutOfScopeError, SchemaError

__all__ = ["Key", "exact", "key_of", "kind_of"]

_MAX_NESTED = 100

Key: TypeAlias = "tuple[object, ...]"


def exact(number: float) -> Fraction:
    """Return the number that its shortest decimal text means."""
    return Fraction(number) if isinstance(number, int) else Fraction(repr(number))


def kind_of(value: object) -> str:
    """Return the JSON kind of a value; every number is a `number`."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "boolean"
    if isinstance(value, int | float):
        return "number"
    if isinstance(value, str):
        return "string"
    return "array" if isinstance(value, list | tuple) else "object"


def key_of(value: object) -> Key:
    """Return a hashable form that is equal exactly when the JSON values are."""
    if value is None or isinstance(value, bool):
        return ("literal", value is None, bool(value))
    if isinstance(value, int):
        return ("number", value)
    if isinstance(value, float):
        if not math.isfinite(value):
            raise SchemaError("", "a JSON value", value)
        number = exact(value)
        return ("number", int(number) if number.denominator == 1 else number)
    if isinstance(value, str):
        return ("string", value)
    return _composite_key(value, 0, {})


def _composite_key(value: object, depth: int, done: dict[int, Key]) -> Key:
    """Return the key of an array or object; a part that is shared is keyed once."""
    if id(value) in done:
        return done[id(value)]
    if depth > _MAX_NESTED:
        raise OutOfScopeError(f"a constant value of more than {_MAX_NESTED} levels")

    def part(one: object) -> Key:
        composite = isinstance(one, Mapping | list | tuple)
        return _composite_key(one, depth + 1, done) if composite else key_of(one)

    if isinstance(value, Mapping):
        key: Key = ("object", frozenset((name, part(one)) for name, one in value.items()))
    elif isinstance(value, list | tuple):
        key = ("array", tuple(part(one) for one in value))
    else:
        raise SchemaError("", "a JSON value", value)
    done[id(value)] = key
    return key
