"""Pairs with a known verdict, derived from the official suite."""

from __future__ import annotations

from itertools import permutations
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from tests.schema._official import Group

Body = bool | dict[str, object]


class Derived(NamedTuple):
    """``contained`` is the truth, or None when only the two schemas are known."""

    keyword: str
    name: str
    producer: Body
    consumer: Body
    contained: bool | None
    instances: tuple[object, ...] = ()


def const_pairs(groups: Iterable[Group]) -> Iterator[Derived]:
    """An instance as ``const`` against the schema, and against its negation."""
    for group in groups:
        for value, valid in group.cases:
            name = f"{group.description}: {value!r:.60}"
            yield Derived(group.keyword, name, {"const": value}, group.schema, valid)
            if _wraps(group.schema):
                negated = _negated(group.schema)
                yield Derived(group.keyword, f"not {name}", {"const": value}, negated, not valid)


def schema_pairs(groups: Iterable[Group]) -> Iterator[Derived]:
    """Every schema of a file against every other of the same file; the truth is not given."""
    by_keyword: dict[str, list[Group]] = {}
    for group in groups:
        by_keyword.setdefault(group.keyword, []).append(group)
    for keyword, members in by_keyword.items():
        for item, other in permutations(members, 2):
            values = tuple(value for group in (item, other) for value, _ in group.cases)
            name = f"{item.description} / {other.description}"
            yield Derived(keyword, name, item.schema, other.schema, None, values)


def _negated(schema: Body) -> Body:
    if isinstance(schema, bool) or "$schema" not in schema:
        return {"not": schema}
    return {"$schema": schema["$schema"], "not": schema}


def _wraps(schema: object) -> bool:
    """Whether the schema keeps its meaning one level down: no references that start at the root."""
    text = str(schema)
    return not any(sign in text for sign in ("$ref", "$id", "dynamic", "$recursiveRef"))
