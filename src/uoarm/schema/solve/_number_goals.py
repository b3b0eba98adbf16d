"""Goals about numbers decided whole: unions of hundreds of ranges without trying them in turn.

Once it is fixed which of the steps in play (`multipleOf`, `integer`) divide the number, every
schema is a set of intervals. Each such case is computed exactly.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Sequence
from fractions import Fraction
from itertools import product
from typing import TypeAlias

from uoarm.schema._errors import OutOfScopeError
from uoarm.schema._values import exact, kind_of
from uoarm.schema.read import SchemaNode
from uoarm.schema.solve._branch import EMPTY, Found, Literal, Result, Unknown, run
from uoarm.schema.solve._numbers import (
    EVERY_NUMBER,
    NO_NUMBER,
    Bound,
    Numbers,
    above,
    below,
    counted,
    find_number,
    points,
)

__all__ = ["find_number_whole"]

_MAX_STEPS = 4

Asking: TypeAlias = Generator[SchemaNode, Numbers, Numbers]


def find_number_whole(goal: Sequence[Literal], spend: Callable[[int], None]) -> Result:
    """Return a number that meets every literal of a goal.

    Args:
        goal: schemas with their signs.
        spend: is told how much work is done.

    Raises:
        OutOfScopeError: a schema is out of scope, or too many steps are in play.
    """
    steps = sorted(_steps([node for node, _ in goal], spend))
    if len(steps) > _MAX_STEPS:
        raise OutOfScopeError(f"more than {_MAX_STEPS} different steps of numbers meet")
    unknown: Unknown | None = None
    for divides in product((True, False), repeat=len(steps)):
        sets = _Sets(dict(zip(steps, divides, strict=True)), spend)
        wanted = counted([sets.of(literal) for literal in goal], lambda n: n == len(goal))
        held = [
            ("multiple" if holds else "notmultiple", step)
            for step, holds in zip(steps, divides, strict=True)
        ]
        whole = Fraction(1) in steps and divides[steps.index(Fraction(1))]
        for number, (low, high) in enumerate(wanted.intervals()):
            if not number % 8:
                spend(1)
            if whole and _holds_no_integer(low, high):
                continue
            bounds = [("low", *low)] if low is not None else []
            bounds += [("high", *high)] if high is not None else []
            result = find_number([*held, *bounds], frozenset(), spend)
            if isinstance(result, Found):
                return result
            unknown = result if isinstance(result, Unknown) else unknown
    return unknown or EMPTY


def _steps(nodes: Sequence[SchemaNode], spend: Callable[[int], None]) -> set[Fraction]:
    found: set[Fraction] = set()
    waiting = list(nodes)
    seen: set[int] = set()
    while waiting:
        one = waiting.pop()
        if one.number in seen:
            continue
        seen.add(one.number)
        if not len(seen) % 32:
            spend(1)
        if one.unsupported:
            raise OutOfScopeError(one.unsupported)
        if one.integer_only:
            found.add(Fraction(1))
        if one.multiple is not None:
            found.add(one.multiple)
        waiting.extend(one.applied())
    return found


class _Sets:
    """The sets of schemas, given which steps divide the number."""

    def __init__(self, divides: dict[Fraction, bool], spend: Callable[[int], None]) -> None:
        self._divides = divides
        self._spend = spend
        self._known: dict[int, Numbers] = {}

    def of(self, literal: Literal) -> Numbers:
        node, sign = literal
        found = run(node, self._set)
        return found if sign else _outside(found)

    def _set(self, node: SchemaNode) -> Asking:
        if node.number not in self._known:
            found = yield from self._compute(node)
            self._spend(1 + len(found.cuts) // 8)
            self._known[node.number] = found
        return self._known[node.number]

    def _compute(self, node: SchemaNode) -> Asking:
        if node.never or (node.kinds is not None and "number" not in node.kinds):
            return NO_NUMBER
        if node.integer_only and not self._divides[Fraction(1)]:
            return NO_NUMBER
        if node.multiple is not None and not self._divides[node.multiple]:
            return NO_NUMBER
        parts = _own(node)
        for subschema in node.all_of:
            parts += [(yield subschema)]
        if node.reference is not None:
            parts.append((yield node.target()))
        for branches, keep in ((node.any_of, _some), (node.one_of, _one)):
            if branches is not None:
                ways: list[Numbers] = []
                for branch in branches:
                    ways += [(yield branch)]
                parts.append(counted(ways, keep))
        if node.negated is not None:
            parts.append(_outside((yield node.negated)))
        if node.condition is not None:
            parts.append((yield from self._conditional(node, node.condition)))
        return counted(parts, lambda n: n == len(parts))

    def _conditional(self, node: SchemaNode, condition: SchemaNode) -> Asking:
        holds = yield condition
        then = (yield node.then) if node.then is not None else EVERY_NUMBER
        otherwise = (yield node.otherwise) if node.otherwise is not None else EVERY_NUMBER
        ways = [counted([holds, then], _both), counted([_outside(holds), otherwise], _both)]
        return counted(ways, _some)


def _holds_no_integer(low: Bound, high: Bound) -> bool:
    if low is None or high is None:
        return False
    return math.floor(low[0]) + (low[1] or low[0] != math.floor(low[0])) > math.ceil(high[0]) - (
        high[1] or high[0] != math.ceil(high[0])
    )


def _own(node: SchemaNode) -> list[Numbers]:
    parts: list[Numbers] = []
    if node.values is not None:
        numbers = (value for value in node.values.values() if kind_of(value) == "number")
        parts.append(points(exact(number) for number in numbers))  # type: ignore[arg-type] # numbers
    if node.minimum is not None:
        parts.append(above(node.minimum, strict=False))
    if node.above is not None:
        parts.append(above(node.above, strict=True))
    if node.maximum is not None:
        parts.append(below(node.maximum, strict=False))
    if node.below is not None:
        parts.append(below(node.below, strict=True))
    return parts


def _outside(numbers: Numbers) -> Numbers:
    return Numbers(not numbers.begins, numbers.cuts)


def _some(count: int) -> bool:
    return count > 0


def _one(count: int) -> bool:
    return count == 1


def _both(count: int) -> bool:
    return count == 2  # noqa: PLR2004 - both of two
