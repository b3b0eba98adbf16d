"""An exact validator over nodes: used to try single values, and to re-check every witness.

Whether a part of a value meets a schema is found out once, however often the part is shared, and
a run of one item in a long array is one part.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Mapping
from typing import Any, TypeAlias

from attrs import define, field

from uoarm.schema._errors import OutOfScopeError
from uoarm.schema._values import Keys, Repeated, exact, is_composite, kind_of, runs_of
from uoarm.schema.read import SchemaNode
from uoarm.schema.regex import CodeUnits, UnsupportedPatternError, found_in
from uoarm.schema.solve._branch import run


@define
class Marks:
    """Parts that were evaluated, gathered where something asks for them.

    Names of members; of items the first `upto`, and the runs that begin at `hits`.
    """

    names: set[str] = field(factory=set)
    upto: int = 0
    everything: bool = False
    hits: set[int] = field(factory=set)

    def update(self, other: Marks) -> None:
        """Mark what another has marked."""
        self.names |= other.names
        self.upto = max(self.upto, other.upto)
        self.everything = self.everything or other.everything
        self.hits |= other.hits


Question: TypeAlias = "tuple[SchemaNode, Any, Marks | None]"
Answer: TypeAlias = Generator[Question, bool, bool]
_MAX_KNOWN = 200_000
"""Judgements that are remembered, of some 250 octets each; more are found out again."""


def accepts(node: SchemaNode, value: object) -> bool:
    """Say whether a value is valid.

    Raises:
        OutOfScopeError: the schema says something that is not decided here.
        BudgetError: the budget of the check ran out.
    """
    return Judgements(node.document.meter.spend).accepts(node, value)


class Judgements:
    """Answers of `accepts` for values that stay as they are, and alive, as long as this."""

    def __init__(self, spend: Callable[[int], None]) -> None:
        self.spend = spend
        self.key_of = Keys(spend).of
        self._known: dict[tuple[int, int, bool], tuple[bool | OutOfScopeError, Marks | None]] = {}

    def accepts(self, node: SchemaNode, value: object) -> bool:
        """Say whether a value, or a part of one, is valid."""
        question: Question = (node, value, None)
        known = self.find(question)
        return run(question, self._valid, self) if known is None else known

    def find(self, question: Question) -> bool | None:
        """Return a judgement that is known; raise the error that it ended in."""
        node, value, marks = question
        known = self._known.get((node.number, id(value), marks is not None))
        if known is None:
            if is_composite(value) or not _is_plain(node):
                return None
            self.spend(1)
            return self._plain_rules(node, value)
        answer, marked = known
        if isinstance(answer, OutOfScopeError):
            raise answer
        if marks is not None and marked is not None:
            marks.update(marked)
        return answer

    def keep(self, question: Question, answer: bool | OutOfScopeError) -> None:  # noqa: FBT001
        """Remember a judgement; that of a scalar is as soon found again."""
        node, value, marks = question
        if is_composite(value) and len(self._known) < _MAX_KNOWN:
            self._known[node.number, id(value), marks is not None] = (answer, marks)

    def _valid(self, question: Question) -> Answer:
        node, value, marks = question
        self.spend(1)
        if node.never:
            return False
        if node.unsupported:
            raise OutOfScopeError(node.unsupported)
        if not self._plain_rules(node, value):
            return False
        if isinstance(value, (list, tuple, Repeated)):
            if marks is None and node.unevaluated_items is not None:
                marks = Marks()
            if not (yield from self._array(node, value, marks)) or not (
                yield from _logic(node, value, marks)
            ):
                return False
            return (yield from _unevaluated_items(node.unevaluated_items, value, marks))
        if isinstance(value, (dict, Mapping)):
            if marks is None and node.unevaluated_properties is not None:
                marks = Marks()
            if not (yield from self._object(node, value, marks)) or not (
                yield from _logic(node, value, marks)
            ):
                return False
            return (yield from _unevaluated_members(node.unevaluated_properties, value, marks))
        return (yield from _logic(node, value, None))

    def _plain_rules(self, node: SchemaNode, value: Any) -> bool:
        kind = kind_of(value)
        if node.kinds is not None and kind not in node.kinds:
            return False
        if node.values is not None and self.key_of(value) not in node.values:
            return False
        if kind == "number":
            return _number(node, value)
        if kind == "string":
            return (
                node.min_length <= len(value)
                and (node.max_length is None or len(value) <= node.max_length)
                and not (node.no_nul and "\0" in value)
                and all(_found(pattern, value, self.spend) for pattern in node.texts)
            )
        return True

    def _array(self, node: SchemaNode, value: Any, marks: Marks | None) -> Answer:
        size = len(value)
        if size < node.min_items or (node.max_items is not None and size > node.max_items):
            return False
        if node.unique and len({self.key_of(element) for _, element, _ in runs_of(value)}) < size:
            return False
        if node.prefix or node.items is not None:
            for start, item, count in runs_of(value):
                self.spend(1)
                for position in kinds_of_position(node, start, count):
                    for rule in item_rules(node, position):
                        if not (yield rule, item, None):
                            return False
            if marks is not None:
                marks.upto = max(marks.upto, len(node.prefix))
                marks.everything = marks.everything or node.items is not None
        if node.contains is not None:
            hits = 0
            for start, item, count in runs_of(value):
                self.spend(1)
                if (yield node.contains, item, None):
                    hits += count
                    if marks is not None:
                        marks.hits.add(start)
            most = node.max_contains
            return node.min_contains <= hits and (most is None or hits <= most)
        return True

    def _object(self, node: SchemaNode, value: Mapping[str, Any], marks: Marks | None) -> Answer:
        count = len(value)
        if count < node.min_properties:
            return False
        if node.max_properties is not None and count > node.max_properties:
            return False
        if any(name not in value for name in node.required):
            return False
        for name, needed in node.dependent_required:
            if name in value and any(text not in value for text in needed):
                return False
        self.spend((count + len(node.required)) // 16)
        for name, item in value.items():
            if node.names is not None and not (yield node.names, name, None):
                return False
            rules = member_rules(node, name)
            for rule in rules:
                if not (yield rule, item, None):
                    return False
            if rules and marks is not None:
                marks.names.add(name)
        for name, rule in node.dependent_schemas:
            if name in value and not (yield from _apply(rule, value, marks)):
                return False
        return True


def _is_plain(node: SchemaNode) -> bool:
    """Say whether a schema judges scalars by its own keywords alone."""
    return not (
        node.unsupported
        or node.never
        or node.all_of
        or node.any_of
        or node.one_of
        or node.negated
        or node.condition
        or node.reference
    )


def item_rules(node: SchemaNode, position: int) -> list[SchemaNode]:
    """Return the schemas that an array's item must meet."""
    if position < len(node.prefix):
        return [node.prefix[position]]
    return [node.items] if node.items is not None else []


def named_rules(node: SchemaNode, name: str) -> list[SchemaNode]:
    """Return the schemas that name a member, by itself or by a pattern."""
    rules = [node.properties[name]] if name in node.properties else []
    spend = node.document.meter.spend
    return rules + [rule for pattern, rule in node.patterns if _found(pattern, name, spend)]


def member_rules(node: SchemaNode, name: str) -> list[SchemaNode]:
    """Return the schemas that a member's value must meet."""
    rules = named_rules(node, name)
    if not rules and node.additional is not None:
        rules = [node.additional]
    return rules


def kinds_of_position(node: SchemaNode, start: int, count: int) -> range:
    """Return the positions of a run that stand for all of it: those after the prefix are alike."""
    return range(start, min(start + count, max(len(node.prefix), start) + 1))


def _unevaluated_members(
    rule: SchemaNode | None, value: Mapping[str, Any], marks: Marks | None
) -> Answer:
    """Hold the members that nothing evaluated to a rule, which evaluates them."""
    if rule is None:
        return True
    assert marks is not None
    for name, part in value.items():
        if name not in marks.names:
            if not (yield rule, part, None):
                return False
            marks.names.add(name)
    return True


def _unevaluated_items(rule: SchemaNode | None, value: Any, marks: Marks | None) -> Answer:
    """Hold the items that nothing evaluated to a rule, which evaluates them."""
    if rule is None:
        return True
    assert marks is not None
    if marks.everything:
        return True
    for start, item, count in runs_of(value):
        covered = start in marks.hits or start + count <= marks.upto
        if not covered and not (yield rule, item, None):
            return False
    marks.everything = True
    return True


def _apply(node: SchemaNode, value: Any, marks: Marks | None) -> Answer:
    """Apply a schema to the same value; what it evaluates counts only when it holds."""
    if marks is None:
        return (yield node, value, None)
    own = Marks()
    holds = yield node, value, own
    if holds:
        marks.update(own)
    return holds


def _number(node: SchemaNode, value: float) -> bool:
    number = exact(value)
    return not (
        (node.integer_only and number.denominator != 1)
        or (node.minimum is not None and number < node.minimum)
        or (node.maximum is not None and number > node.maximum)
        or (node.above is not None and number <= node.above)
        or (node.below is not None and number >= node.below)
        or (node.multiple is not None and (number / node.multiple).denominator != 1)
    )


def _logic(node: SchemaNode, value: Any, marks: Marks | None) -> Answer:
    if node.reference is not None and not (yield from _apply(node.target(), value, marks)):
        return False
    for subschema in node.all_of:
        if not (yield from _apply(subschema, value, marks)):
            return False
    if node.any_of is not None and not (yield from _any_of(node.any_of, value, marks)):
        return False
    if node.one_of is not None:
        hits = 0
        for subschema in node.one_of:
            hits += yield from _apply(subschema, value, marks)
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


def _any_of(nodes: Iterable[SchemaNode], value: Any, marks: Marks | None) -> Answer:
    """Apply several schemas; one that is not decided does not matter beside one that holds."""
    hits = 0
    undecided: OutOfScopeError | None = None
    for node in nodes:
        try:
            hits += yield from _apply(node, value, marks)
        except OutOfScopeError as error:
            undecided = error
        if hits and marks is None:
            return True
    if undecided is not None:
        raise undecided
    return hits > 0


def _found(pattern: str | CodeUnits, text: str, spend: Callable[[int], None]) -> bool:
    if isinstance(pattern, CodeUnits):
        return pattern.holds(text)
    try:
        return found_in(pattern, text, spend)
    except UnsupportedPatternError as error:
        raise OutOfScopeError(f"the pattern {pattern!r}: {error}") from error
