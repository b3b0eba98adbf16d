"""Pairs made to cost much: each is made when it is asked for, by name."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

Pair = tuple[Any, Any]

_MANY = 4_000_000


def chain(depth: int) -> Pair:
    """Definitions that each hold the next one twice, ending in a number that may be too small."""
    return _chained(depth, {"type": "integer"}), _chained(depth, {"minimum": 0})


def _chained(depth: int, leaf: dict[str, object]) -> dict[str, object]:
    defs: dict[str, object] = {f"d{depth}": leaf}
    for n in range(depth):
        two = {name: {"$ref": f"#/$defs/d{n + 1}"} for name in "ab"}
        defs[f"d{n}"] = {"type": "object", "properties": two, "required": ["a", "b"]}
    return {"$defs": defs, "$ref": "#/$defs/d0"}


def in_place(depth: int) -> Pair:
    """Definitions that apply the next one twice to the same object, watched for members."""
    defs: dict[str, object] = {f"d{depth}": {"properties": {"a": True}}}
    for n in range(depth):
        defs[f"d{n}"] = {"allOf": [{"$ref": f"#/$defs/d{n + 1}"}, {"$ref": f"#/$defs/d{n + 1}"}]}
    whole = {"$defs": defs, "$ref": "#/$defs/d0", "unevaluatedProperties": False}
    return {"type": "object"}, whole


def rows(count: int, inner: dict[str, object]) -> dict[str, object]:
    return {"type": "array", "minItems": count, "items": inner}


def choices(count: int) -> Pair:
    """Choices of which none is settled before another is tried."""
    names = [f"f{n}" for n in range(count)]
    either = [
        {"anyOf": [{"required": [text]}, {"required": [other]}, {"minProperties": 2 * count}]}
        for text, other in zip(names, [*names[1:], names[0]], strict=True)
    ]
    return {"type": "object", "allOf": either}, {"maxProperties": count // 2 - 1}


def nested_any_of(depth: int) -> Pair:
    inner: dict[str, object] = {"required": ["x"]}
    for n in range(depth):
        inner = {"anyOf": [{"required": [f"f{n}"]}, inner, {"minProperties": n + 2}]}
    return {"type": "object", **inner}, {"required": ["y"]}


def shared_value(depth: int) -> dict[str, object]:
    """A constant that is written in few lines and is long when unfolded."""
    value: list[object] = [0]
    for _ in range(depth):
        value = [value, value]
    return {"const": value}


def deep(levels: int) -> dict[str, object]:
    inner: dict[str, object] = {"type": "integer"}
    for _ in range(levels):
        inner = {"type": "object", "properties": {"a": inner}, "required": ["a"]}
    return inner


def ranges(count: int) -> Pair:
    low = [{"minimum": 1000 * n, "maximum": 1000 * n + 600} for n in range(count)]
    enums = [{"enum": list(range(1000 * n, 1000 * n + 600))} for n in range(count)]
    return {"type": "integer", "anyOf": low}, {"anyOf": enums}


def _object_names(count: int) -> list[str]:
    return [f"f{n}" for n in range(count)]


HOSTILE: dict[str, Callable[[], Pair]] = {
    **{f"chain of {n} doublings": partial(chain, n) for n in (16, 21, 40, 400)},
    "200 doublings in place": lambda: in_place(200),
    "4e6 texts of 4e6": lambda: (rows(_MANY, {"type": "string", "minLength": _MANY}), False),
    "4e6 nested three deep": lambda: (
        rows(_MANY, rows(_MANY, rows(_MANY, {"type": "integer"}))),
        False,
    ),
    "3.9e6 strings": lambda: (
        rows(3_900_000, {"type": "string"}),
        {"type": "array", "items": {"type": "string"}, "maxItems": 10},
    ),
    "3.9e6 strings that must not be equal": lambda: (
        rows(3_900_000, {"type": "string"}),
        {"uniqueItems": True},
    ),
    "3.9e6 items, one contained": lambda: (
        rows(3_900_000, {"type": "integer"}),
        {"contains": {"type": "string"}},
    ),
    "299 unique arrays": lambda: (
        {**rows(299, {"type": "array"}), "uniqueItems": True},
        {"type": "string"},
    ),
    "50 ranges against enums": lambda: ranges(50),
    "anyOf of 20,000": lambda: (
        {"anyOf": [{"type": "object", "required": [f"f{n}"]} for n in range(20_000)]},
        {"type": "object", "minProperties": 1},
    ),
    "anyOf of 20,000 records": lambda: (
        {"anyOf": [{"required": [f"f{n}"]} for n in range(20_000)]},
        {"anyOf": [{"required": [f"f{n}"]} for n in reversed(range(20_000))]},
    ),
    "500 open choices": lambda: choices(500),
    "500 nested anyOf": lambda: nested_any_of(500),
    "constant of 2**40 items, shared": lambda: (shared_value(40), {"type": "string"}),
    "constant of 2**40 items into itself": lambda: (shared_value(40), shared_value(40)),
    "5,000 levels": lambda: (deep(5_000), {"required": ["b"]}),
    "3,000 members without a name": lambda: (
        {"type": "object", "minProperties": 2_999},
        {"maxProperties": 5},
    ),
    "one excluded text of 200,000": lambda: (
        {"type": "string", "pattern": "^a*$", "minLength": 200_000},
        {"const": "a" * 200_000},
    ),
    "repeated groups": lambda: (
        {"type": "string", "pattern": "^((a|b){1,30}c){1,30}$"},
        {"type": "string", "pattern": "^((a|b|d){1,30}c){1,29}$"},
    ),
    "a pattern that doubles": lambda: (
        {"type": "string", "pattern": "a.{900}b.{20}c"},
        {"type": "string", "pattern": "a.{900}b.{19}c"},
    ),
    "200 large patterns": lambda: (
        {"type": "string", "allOf": [{"pattern": f"^(a{{900}}b){{10}}c{n}"} for n in range(200)]},
        {"type": "string", "pattern": "z"},
    ),
    "huge numbers": lambda: (
        {"type": "integer", "allOf": [{"multipleOf": 10**20_000 + n} for n in range(40)]},
        {"minimum": 1},
    ),
    "200,000 constants of an enum": lambda: (
        {"enum": [[n, str(n)] for n in range(200_000)]},
        {"enum": [[n, str(n)] for n in reversed(range(200_000))]},
    ),
    "1e6 constants of an enum": lambda: (
        {"enum": [f"w{n}" for n in range(1_000_000)]},
        {"maxLength": 7},
    ),
    "40,000 fields": lambda: (
        {"properties": {name: {"type": "integer"} for name in _object_names(40_000)}},
        {"properties": {name: {"type": "number"} for name in _object_names(40_000)}},
    ),
    "20,000 required fields and patterns": lambda: (
        {"type": "object", "required": _object_names(20_000), "patternProperties": {"^f": True}},
        {"patternProperties": {"9$": {"type": "string"}, "8$": {"type": "string"}}},
    ),
    "600 overlapping oneOf": lambda: (
        {"type": "object"},
        {"oneOf": [{"required": [f"f{n}"]} for n in range(600)]},
    ),
    "counted items": lambda: (
        {
            "type": "array",
            "allOf": [{"contains": {"multipleOf": n}, "minContains": 90} for n in (2, 3, 5, 7)],
        },
        {"maxItems": 89},
    ),
    "distinct and counted": lambda: (
        {"type": "array", "uniqueItems": True, "contains": {"type": "integer"}, "minContains": 120},
        {"maxItems": 50},
    ),
    "a pointer of 19,000 characters": lambda: (
        {"$defs": {"a": {}}, "$ref": "#/$defs/a", "title": "x" * 10**6},
        deep(1_500),
    ),
}
