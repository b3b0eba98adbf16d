"""An exact validator over nodes: used to try single values, and to re-check every witness."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Mapping
from typing import Any, TypeAlias

from uoarm.schema._errors import OutOfScopeError
from uoarm.schema._nfa import UnsupportedPatternError
from uoarm.schema._node import Node
from uoarm.schema._trampoline import run
from uoarm.schema._values import exact, key_of, kind_of
from uoarm.schema._walker import found_in

__all__ = ["Judgements", "accepts", "item_rules", "member_rules", "named_rules"]

Mark: TypeAlias = "str | int"
Marks: TypeAlias = "set[Mark] | None"
"""Names or positions that were evaluated, gathered where something asks for them."""
Question: TypeAlias = "tuple[Node, Any, Marks]"
Answer: TypeAlias = Generator[Question, bool, bool]


def accepts(node: Node, value: object) -> bool:
    """Say whether a value is valid.

    Raises:
        OutOfScopeError: the schema says something that is not decided here.
    """
    question: Question = (node, value, None)
    return run(question, _valid)


class Judgements:
    """Answers of `accepts` for the parts of one message, each found out once."""

    def __init__(self) -> None:
        self._known: dict[tuple[int, int], bool] = {}

    def accepts(self, node: Node, value: object) -> bool:
        """Say whether a part is valid; the message must stay as it is and alive."""
        key = id(node), id(value)
        if key not in self._known:
            question: Question = (node, value, None)
            run(question, _valid, self._observe)
        return self._known[key]

    def _observe(self, question: Question, holds: bool) -> None:  # noqa: FBT001 - a callback
        self._known[id(question[0]), id(question[1])] = holds


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
    node, value, marks = question
    if node.never:
        return False
    if node.unsupported:
        raise OutOfScopeError(node.unsupported)
    if not _plain_rules(node, value):
        return False
    if isinstance(value, list | tuple):
        if marks is None and node.unevaluated_items is not None:
            marks = set()
        if not (yield from _array(node, value, marks)) or not (
            yield from _logic(node, value, marks)
        ):
            return False
        return (yield from _unevaluated(node.unevaluated_items, enumerate(value), marks))
    if isinstance(value, Mapping):
        if marks is None and node.unevaluated_properties is not None:
            marks = set()
        if not (yield from _object(node, value, marks)) or not (
            yield from _logic(node, value, marks)
        ):
            return False
        return (yield from _unevaluated(node.unevaluated_properties, value.items(), marks))
    return (yield from _logic(node, value, None))


def _unevaluated(rule: Node | None, parts: Iterable[tuple[Mark, Any]], marks: Marks) -> Answer:
    """Hold the parts that nothing evaluated to a rule, which evaluates them."""
    if rule is None:
        return True
    assert marks is not None
    for mark, part in parts:
        if mark not in marks:
            if not (yield rule, part, None):
                return False
            marks.add(mark)
    return True


def _apply(node: Node, value: Any, marks: Marks) -> Answer:
    """Apply a schema to the same value; what it evaluates counts only when it holds."""
    if marks is None:
        return (yield node, value, None)
    own: set[Mark] = set()
    holds = yield node, value, own
    if holds:
        marks |= own
    return holds


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


def _array(node: Node, value: Any, marks: Marks) -> Answer:
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
                    known[key] = yield rule, item, None
                if not known[key]:
                    return False
        if marks is not None:
            marks.update(range(len(value) if node.items is not None else len(node.prefix)))
    if node.contains is not None:
        hits = []
        for position, item in enumerate(value):
            if (yield node.contains, item, None):
                hits.append(position)
        if marks is not None:
            marks.update(hits)
        most = node.max_contains
        return node.min_contains <= len(hits) and (most is None or len(hits) <= most)
    return True


def _object(node: Node, value: Mapping[str, Any], marks: Marks) -> Answer:
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
        if node.names is not None and not (yield node.names, name, None):
            return False
        rules = member_rules(node, name)
        for rule in rules:
            if not (yield rule, item, None):
                return False
        if rules and marks is not None:
            marks.add(name)
    for name, rule in node.dependent_schemas:
        if name in value and not (yield from _apply(rule, value, marks)):
            return False
    return True


def _logic(node: Node, value: Any, marks: Marks) -> Answer:
    if node.reference is not None and not (yield from _apply(node.target(), value, marks)):
        return False
    for one in node.all_of:
        if not (yield from _apply(one, value, marks)):
            return False
    if node.any_of is not None and not (yield from _any_of(node.any_of, value, marks)):
        return False
    if node.one_of is not None:
        hits = 0
        for one in node.one_of:
            hits += yield from _apply(one, value, marks)
        if hits != 1:
            return False
    if node.negated is not None and (yield node.negated, value, None):
        return False
    if node.condition is not None:
        holds = yield from _apply(node.condition, value, marks)
        branch = node.then if holds else node.otherwise
        if branch is not None and not (yield from _apply(branch, value, marks)):
            return False
    return True


def _any_of(nodes: Iterable[Node], value: Any, marks: Marks) -> Answer:
    """Apply several schemas; one that is not decided does not matter beside one that holds."""
    hits = 0
    undecided: OutOfScopeError | None = None
    for one in nodes:
        try:
            hits += yield from _apply(one, value, marks)
        except OutOfScopeError as error:
            undecided = error
        if hits and marks is None:
            return True
    if undecided is not None:
        raise undecided
    return hits > 0


def _found(pattern: str, text: str) -> bool:
    try:
        return found_in(pattern, text)
    except UnsupportedPatternError as error:
        raise OutOfScopeError(f"the pattern {pattern!r}: {error}") from error
