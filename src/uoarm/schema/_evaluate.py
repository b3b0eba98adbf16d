"""An exact validator over nodes: used to try single values, and to re-check every witness."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from typing import Any, TypeAlias

from uoarm.schema._errors import OutOfScopeError
from uoarm.schema._node import Node
from uoarm.schema._regex import UnsupportedPatternError
from uoarm.schema._trampoline import run
from uoarm.schema._values import exact, key_of, kind_of
from uoarm.schema._words import found_in

__all__ = ["OutOfScopeError", "accepts", "failures"]

Question: TypeAlias = "tuple[Node, Any]"
Answer: TypeAlias = Generator[Question, bool, bool]


def accepts(node: Node, value: object) -> bool:
    """Say whether a value is valid.

    Raises:
        OutOfScopeError: the schema says something that is not decided here.
    """
    return run((node, value), _valid)


def failures(node: Node, value: object) -> list[tuple[Node, Any, tuple[str | int, ...], str]]:
    """Return the innermost failing schemas: node, value there, path, keyword."""
    found: list[tuple[Node, Any, tuple[str | int, ...], str]] = []
    waiting: list[tuple[Node, Any, tuple[str | int, ...]]] = [(node, value, ())]
    visits = 0
    while waiting and visits < 10_000:  # noqa: PLR2004 - an explanation, not a verdict
        visits += 1
        one, part, path = waiting.pop()
        deeper = [
            (child, item, (*path, *step))
            for child, item, step in _direct_parts(one, part)
            if not child.never and not accepts(child, item)
        ]
        keyword = _failing_keyword(one, part)
        if keyword == "rules" and deeper:
            waiting.extend(deeper[:3])
        else:
            found.append((one, part, path, keyword))
    return found


def _direct_parts(node: Node, value: Any) -> list[tuple[Node, Any, tuple[str | int, ...]]]:
    parts: list[tuple[Node, Any, tuple[str | int, ...]]] = [(one, value, ()) for one in node.all_of]
    if node.reference is not None:
        parts.append((node.target(), value, ()))
    if isinstance(value, list):
        parts += [(rule, value[n], (n,)) for n in range(len(value)) for rule in item_rules(node, n)]
    elif isinstance(value, Mapping):
        parts += [(rule, value[k], (k,)) for k in value for rule in member_rules(node, k)]
    return parts


def _failing_keyword(node: Node, value: Any) -> str:
    kind = kind_of(value)
    if node.kinds is not None and kind not in node.kinds:
        return "type"
    if node.integer_only and kind == "number" and exact(value).denominator != 1:
        return "type"
    if node.values is not None and key_of(value) not in node.values:
        return "enum"
    if isinstance(value, Mapping):
        if any(name not in value for name in node.required):
            return "required"
        if node.additional is not None and node.additional.never:
            extra = [k for k in value if not named_rules(node, k)]
            if extra:
                return "additionalProperties"
    return "rules"


def item_rules(node: Node, position: int) -> list[Node]:
    """Return the schemas that an array's item must meet."""
    if position < len(node.prefix):
        return [node.prefix[position]]
    return [node.items] if node.items is not None else []


def named_rules(node: Node, name: str) -> list[Node]:
    """Return the schemas that name a member, by itself or by a pattern."""
    rules = [node.properties[name]] if name in node.properties else []
    return rules + [rule for pattern, rule in node.patterns if _found(pattern, name)]


def member_rules(node: Node, name: str) -> list[Node]:
    """Return the schemas that a member's value must meet."""
    rules = named_rules(node, name)
    if not rules and node.additional is not None:
        rules = [node.additional]
    return rules


def _valid(question: Question) -> Answer:
    node, value = question
    if node.never:
        return False
    if node.unsupported:
        raise OutOfScopeError(node.unsupported)
    if not _plain_rules(node, value):
        return False
    gap = node.gaps.get(kind_of(value))
    if gap:
        raise OutOfScopeError(gap)
    if isinstance(value, list | tuple):
        if not (yield from _array(node, value)):
            return False
    elif isinstance(value, Mapping) and not (yield from _object(node, value)):
        return False
    return (yield from _logic(node, value))


def _plain_rules(node: Node, value: Any) -> bool:
    kind = kind_of(value)
    if node.kinds is not None and kind not in node.kinds:
        return False
    if node.values is not None and key_of(value) not in node.values:
        return False
    if kind == "number":
        return _number(node, value)
    if kind == "string":
        return (
            node.min_length <= len(value)
            and (node.max_length is None or len(value) <= node.max_length)
            and (node.pattern is None or _found(node.pattern, value))
        )
    return True


def _number(node: Node, value: float) -> bool:
    number = exact(value)
    return not (
        (node.integer_only and number.denominator != 1)
        or (node.minimum is not None and number < node.minimum)
        or (node.maximum is not None and number > node.maximum)
        or (node.above is not None and number <= node.above)
        or (node.below is not None and number >= node.below)
        or (node.multiple is not None and (number / node.multiple).denominator != 1)
    )


def _array(node: Node, value: Any) -> Answer:
    if len(value) < node.min_items or (node.max_items is not None and len(value) > node.max_items):
        return False
    if node.unique and len({key_of(one) for one in value}) < len(value):
        return False
    if node.prefix or node.items is not None:
        known: dict[tuple[int, object], bool] = {}
        for position, item in enumerate(value):
            for rule in item_rules(node, position):
                composite = isinstance(item, list | tuple | Mapping)
                key = (rule.number, id(item) if composite else key_of(item))
                if key not in known:
                    known[key] = yield rule, item
                if not known[key]:
                    return False
    if node.contains is not None:
        hits = 0
        for item in value:
            hits += yield node.contains, item
        if hits < node.min_contains or (node.max_contains is not None and hits > node.max_contains):
            return False
    return True


def _object(node: Node, value: Mapping[str, Any]) -> Answer:
    count = len(value)
    if count < node.min_properties:
        return False
    if node.max_properties is not None and count > node.max_properties:
        return False
    if any(name not in value for name in node.required):
        return False
    for name, needed in node.dependent_required:
        if name in value and any(one not in value for one in needed):
            return False
    for name, item in value.items():
        if node.names is not None and not (yield node.names, name):
            return False
        for rule in member_rules(node, name):
            if not (yield rule, item):
                return False
    for name, rule in node.dependent_schemas:
        if name in value and not (yield rule, value):
            return False
    return True


def _logic(node: Node, value: Any) -> Answer:
    if node.reference is not None and not (yield node.target(), value):
        return False
    for one in node.all_of:
        if not (yield one, value):
            return False
    if node.any_of is not None:
        for one in node.any_of:
            if (yield one, value):
                break
        else:
            return False
    if node.one_of is not None:
        hits = 0
        for one in node.one_of:
            hits += yield one, value
        if hits != 1:
            return False
    if node.negated is not None and (yield node.negated, value):
        return False
    if node.condition is not None:
        branch = node.then if (yield node.condition, value) else node.otherwise
        if branch is not None and not (yield branch, value):
            return False
    return True


def _found(pattern: str, text: str) -> bool:
    try:
        return found_in(pattern, text)
    except UnsupportedPatternError as error:
        raise OutOfScopeError(f"the pattern {pattern!r}: {error}") from error
