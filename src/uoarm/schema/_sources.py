"""Which adjacent schemas may evaluate the parts of a value, and when they do.

`unevaluatedProperties` and `unevaluatedItems` see what the schemas beside them, applied to the same
value, have evaluated. Each of these schemas is a source with a guard: what must hold, given that
the whole holds but for the unevaluated rule itself, for the source to count.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeAlias

from attrs import frozen

from uoarm.schema._errors import OutOfScopeError
from uoarm.schema._node import Node

__all__ = ["Condition", "Guard", "Source", "sources"]

Condition: TypeAlias = "tuple[Node, bool] | str"
"""A schema that holds or fails, or the name of a member that is there."""
Guard: TypeAlias = "tuple[Condition, ...]"

_MAX_SOURCES = 1_000


@frozen
class Source:
    """One schema that evaluates parts where its guard holds; `all_parts` when it leaves none."""

    node: Node
    guard: Guard
    all_parts: bool


def sources(node: Node, kind: str) -> list[Source]:
    """Return what may evaluate members (of an "object") or items (of an "array") for a node.

    Raises:
        OutOfScopeError: there are too many.
    """
    found: list[Source] = []
    waiting: list[tuple[Node, Guard]] = [(node, ())]
    for one, guard in waiting:
        if len(waiting) > _MAX_SOURCES:
            raise OutOfScopeError("too many schemas stand beside an unevaluated keyword")
        if one.unsupported:
            raise OutOfScopeError(one.unsupported)
        if one.never or (one.kinds is not None and kind not in one.kinds):
            continue
        everything = _evaluates_all(one, kind, rooted=one is node)
        if everything or _evaluates_some(one, kind):
            found.append(Source(one, guard, everything))
        if not everything or one is node:
            waiting.extend((inner, guard + more) for inner, more in _beside(one, kind))
    return found


def _evaluates_all(node: Node, kind: str, *, rooted: bool) -> bool:
    if kind == "array":
        return node.items is not None or (node.unevaluated_items is not None and not rooted)
    return node.additional is not None or (node.unevaluated_properties is not None and not rooted)


def _evaluates_some(node: Node, kind: str) -> bool:
    if kind == "array":
        return bool(node.prefix) or node.contains is not None
    return bool(node.properties or node.patterns)


def _beside(node: Node, kind: str) -> Iterator[tuple[Node, Guard]]:
    """Yield the schemas that a node applies to the same value, each with its own condition."""
    for one in node.all_of:
        yield one, ()
    if node.reference is not None:
        yield node.target(), ()
    for one in (*(node.any_of or ()), *(node.one_of or ())):
        yield one, ((one, True),)
    if node.condition is not None:
        yield node.condition, ((node.condition, True),)
        if node.then is not None:
            yield node.then, ((node.condition, True),)
        if node.otherwise is not None:
            yield node.otherwise, ((node.condition, False),)
    if kind == "object":
        for name, rule in node.dependent_schemas:
            yield rule, (name,)
