"""Where a value fails a schema: the innermost schemas that refuse a part of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from uoarm.schema._repeated import runs_of
from uoarm.schema._values import exact, kind_of
from uoarm.schema.read import Node
from uoarm.schema.solve import (
    Judgements,
    item_rules,
    kinds_of_position,
    member_rules,
    named_rules,
)

__all__ = ["failures"]

_MAX_VISITS = 10_000


def failures(
    node: Node, value: object, judgements: Judgements, most: int
) -> list[tuple[Node, Any, tuple[str | int, ...], str]]:
    """Return some of the innermost failing schemas: node, value there, path, keyword."""
    found: list[tuple[Node, Any, tuple[str | int, ...], str]] = []
    waiting: list[tuple[Node, Any, tuple[str | int, ...]]] = [(node, value, ())]
    visits = 0
    while waiting and visits < _MAX_VISITS and len(found) < most:
        visits += 1
        one, part, path = waiting.pop()
        keyword = _failing_keyword(one, part, judgements)
        deeper = []
        if keyword == "rules":
            deeper = [
                (child, item, (*path, *step))
                for child, item, step in _direct_parts(one, part, judgements)
                if not child.never and not judgements.accepts(child, item)
            ]
        if deeper:
            waiting.extend(deeper[:3])
        else:
            found.append((one, part, path, keyword))
    return found


def _direct_parts(
    node: Node, value: Any, judgements: Judgements
) -> list[tuple[Node, Any, tuple[str | int, ...]]]:
    parts: list[tuple[Node, Any, tuple[str | int, ...]]] = [
        (subschema, value, ()) for subschema in node.all_of
    ]
    if node.reference is not None:
        parts.append((node.target(), value, ()))
    if kind_of(value) == "array":
        for start, item, count in runs_of(value):
            judgements.spend(1)
            for n in kinds_of_position(node, start, count):
                parts += [(rule, item, (n,)) for rule in item_rules(node, n)]
    elif isinstance(value, Mapping):
        for name, item in value.items():
            judgements.spend(1 + len(node.patterns))
            parts += [(rule, item, (name,)) for rule in member_rules(node, name)]
    return parts


def _failing_keyword(node: Node, value: Any, judgements: Judgements) -> str:
    kind = kind_of(value)
    if node.kinds is not None and kind not in node.kinds:
        return "type"
    if node.integer_only and kind == "number" and exact(value).denominator != 1:
        return "type"
    if node.values is not None and judgements.key_of(value) not in node.values:
        return "enum"
    if kind == "array" and not _within(len(value), node.min_items, node.max_items):
        return "size"
    if isinstance(value, Mapping):
        if not _within(len(value), node.min_properties, node.max_properties):
            return "size"
        if any(name not in value for name in node.required):
            return "required"
        if node.additional is not None and node.additional.never:
            extra = [k for k in value if not named_rules(node, k)]
            if extra:
                return "additionalProperties"
    return "rules"


def _within(size: int, least: int, most: int | None) -> bool:
    return least <= size and (most is None or size <= most)
