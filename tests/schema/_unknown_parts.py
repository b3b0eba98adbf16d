"""Schemas of which one part is replaced by another one, or by an unknown one."""

from __future__ import annotations

from copy import deepcopy
from typing import TYPE_CHECKING, Any

from tests.schema._mixed_schemas import mixed_pair, mixed_schema
from tests.schema._scoped_schemas import dynamic_pair, recursive_pair
from tests.schema._strategies import related_pair

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tests.schema._judge import Body

    from uoarm.testing._instances import Choices

UNKNOWN: dict[str, object] = {"$ref": "http://unknown.example/schema"}
_SINGLES = (
    "items", "contains", "additionalProperties", "propertyNames", "not", "if", "then", "else",
    "unevaluatedItems", "unevaluatedProperties",
)  # fmt: skip
_LISTS = ("prefixItems", "allOf", "anyOf", "oneOf")
_MAPS = ("properties", "patternProperties", "dependentSchemas", "$defs")

Path = tuple[str | int, ...]


def places(schema: object, path: Path = ()) -> Iterator[Path]:
    """Where a document of schemas has a schema below its root; no document is one place."""
    if not isinstance(schema, dict):
        return
    for keyword, value in schema.items():
        inner: list[tuple[Path, Any]] = []
        if keyword in _SINGLES:
            inner = [((*path, keyword), value)]
        elif keyword in _LISTS:
            inner = [((*path, keyword, n), item) for n, item in enumerate(value)]
        elif keyword in _MAPS:
            inner = [((*path, keyword, name), item) for name, item in value.items()]
        for at, item in inner:
            if not (isinstance(item, dict) and {"$id", "$dynamicAnchor"} & item.keys()):
                yield at
            yield from places(item, at)


def replaced(schema: Body, path: Path, part: Body) -> Body:
    """A copy of a document with another schema at a place."""
    whole: Any = deepcopy(schema)
    at = whole
    for step in path[:-1]:
        at = at[step]
    at[path[-1]] = deepcopy(part)
    return whole  # type: ignore[no-any-return] # a schema, as it was


def same_pair(choices: Choices) -> tuple[Body, Body]:
    """A schema with itself: whatever differs is the part that is replaced."""
    schema = mixed_schema(choices, 3)
    return schema, deepcopy(schema)


PAIRS = (same_pair, related_pair, mixed_pair, dynamic_pair, recursive_pair)


def fillings(choices: Choices) -> list[Body]:
    """What may stand for the unknown schema."""
    return [True, False, *(mixed_schema(choices, 1) for _ in range(3))]
