"""JSON values compared as JSON Schema compares them: exact numbers, no booleans among them."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import TypeAlias

__all__ = ["Key", "exact", "key_of", "kind_of"]

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
        number = exact(value)
        return ("number", int(number) if number.denominator == 1 else number)
    if isinstance(value, str):
        return ("string", value)
    return _composite_key(value)


def _composite_key(value: object) -> Key:
    """Build the key of an array or object bottom up, with an explicit stack."""
    done: dict[int, Key] = {}
    stack: list[tuple[object, bool]] = [(value, False)]
    while stack:
        node, expanded = stack.pop()
        parts = _parts(node)
        if parts is None:
            done[id(node)] = key_of(node)
        elif not expanded:
            stack.append((node, True))
            stack.extend((part, False) for part in parts)
        elif isinstance(node, Mapping):
            done[id(node)] = ("object", frozenset((k, done[id(v)]) for k, v in node.items()))
        else:
            done[id(node)] = ("array", tuple(done[id(part)] for part in parts))
    return done[id(value)]


def _parts(node: object) -> list[object] | None:
    if isinstance(node, Mapping):
        return list(node.values())
    if isinstance(node, list | tuple):
        return list(node)
    return None
