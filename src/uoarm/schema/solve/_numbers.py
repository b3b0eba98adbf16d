"""Finding a number: in an interval, a multiple of some, not of others, not one of a set."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from fractions import Fraction
from itertools import count, product
from typing import Any, TypeAlias

from attrs import frozen

from uoarm.schema._errors import OutOfScopeError
from uoarm.schema._values import exact, kind_of
from uoarm.schema.read import SchemaNode
from uoarm.schema.solve._branch import UNSATISFIABLE, Literal, Result, Unknown, Witness, run

_MAX_TRIES = 20_000
_LARGEST = 2**1000
_MAX_BITS = 100_000
_CLOSEST = 20
_UNWRITTEN = "no number that JSON can write was found between the bounds"


def find_number(
    atoms: Iterable[tuple[Any, ...]],
    excluded: frozenset[Fraction],
    spend: Callable[[int], None] = lambda _: None,
) -> Result:
    """Return a number that meets every atom of `_expand` and is not excluded.

    `spend` is called with the work that is done.
    """
    low: tuple[Fraction, bool] | None = None
    high: tuple[Fraction, bool] | None = None
    step: Fraction | None = None
    never: list[Fraction] = []
    for tag, *rest in atoms:
        if tag == "low" and (low is None or (rest[0], rest[1]) > low):
            low = rest[0], rest[1]
        elif tag == "high" and (high is None or (rest[0], not rest[1]) < (high[0], not high[1])):
            high = rest[0], rest[1]
        elif tag == "multiple":
            step = _common(step, Fraction(rest[0]))
            if step.numerator.bit_length() > _MAX_BITS:
                return Unknown(f"a common multiple of more than {_MAX_BITS:,} bits")
        elif tag == "notmultiple":
            never.append(Fraction(rest[0]))
    if (
        low is not None
        and high is not None
        and (low[0] > high[0] or (low[0] == high[0] and (low[1] or high[1])))
    ):
        return UNSATISFIABLE
    if step is not None:
        return _on_lattice(step, low, high, never, excluded, spend)
    return _anywhere(low, high, never, excluded)


def _common(first: Fraction | None, second: Fraction) -> Fraction:
    """Return the least number that both divide."""
    if first is None:
        return second
    return Fraction(
        math.lcm(first.numerator, second.numerator), math.gcd(first.denominator, second.denominator)
    )


def _on_lattice(
    step: Fraction,
    low: tuple[Fraction, bool] | None,
    high: tuple[Fraction, bool] | None,
    never: list[Fraction],
    excluded: frozenset[Fraction],
    spend: Callable[[int], None],
) -> Result:
    least = most = None
    if low is not None:
        least = math.ceil(low[0] / step)
        least += low[1] and least * step == low[0]
    if high is not None:
        most = math.floor(high[0] / step)
        most -= high[1] and most * step == high[0]
    if least is not None and most is not None and least > most:
        return UNSATISFIABLE
    periods = [(step / fraction).denominator for fraction in never]
    if 1 in periods:
        return UNSATISFIABLE
    skipped = False
    taken = {int(fraction / step) for fraction in excluded if (fraction / step).denominator == 1}
    for tries, factor in enumerate(_outwards(least, most)):
        if not tries % 32:
            spend(1)
        if factor not in taken and all(factor % period for period in periods):
            written = _as_json(factor * step)
            if written is not None:
                return Witness(written)
            skipped = True
        if tries > _MAX_TRIES + len(taken):
            return Unknown("too many multiples had to be tried")
    return Unknown(_UNWRITTEN) if skipped else UNSATISFIABLE


def _outwards(least: int | None, most: int | None) -> Iterable[int]:
    """Yield every whole number of an interval, near zero or near a bound first."""
    if least is None and most is None:
        yield 0
        for at in count(1):
            yield from (at, -at)
    start = 0 if least is None else max(least, 0)
    start = start if most is None else min(start, most)
    yield from count(start) if most is None else range(start, most + 1)
    yield from count(start - 1, -1) if least is None else range(start - 1, least - 1, -1)


def _anywhere(
    low: tuple[Fraction, bool] | None,
    high: tuple[Fraction, bool] | None,
    never: list[Fraction],
    excluded: frozenset[Fraction],
) -> Result:
    def fits(number: Fraction) -> bool:
        if number in excluded or any((number / fraction).denominator == 1 for fraction in never):
            return False
        if low is not None and (number < low[0] or (number == low[0] and low[1])):
            return False
        return high is None or number < high[0] or (number == high[0] and not high[1])

    if low is not None and high is not None and low[0] == high[0]:
        if not fits(low[0]):
            return UNSATISFIABLE
        written = _as_json(low[0])
        return Unknown(_UNWRITTEN) if written is None else Witness(written)
    for number in _candidates(low, high):
        written = _as_json(number)
        if written is None and _is_small(number):
            number = exact(float(number))  # noqa: PLW2901 - the nearest that can be written
            written = _as_json(number)
        if written is not None and fits(number):
            return Witness(written)
    return Unknown(_UNWRITTEN)


def _candidates(
    low: tuple[Fraction, bool] | None, high: tuple[Fraction, bool] | None
) -> Iterator[Fraction]:
    """Yield numbers that probably lie between two bounds, plain ones first."""
    yield from (Fraction(0), Fraction(1))
    if low is not None:
        yield from (low[0], low[0] + 1)
    if high is not None:
        yield from (high[0], high[0] - 1)
    whole = [Fraction(0)] + [
        Fraction(math.floor(pair[0])) for pair in (low, high) if pair is not None
    ]
    for power in range(1, _CLOSEST):
        for part in (Fraction(1, 2**power), Fraction(1, 10**power), Fraction(1, 3**power)):
            yield from (fraction + sign * part for fraction in whole for sign in (1, -1))
    start = low[0] if low is not None else (high[0] - 1 if high is not None else Fraction(0))
    width = high[0] - start if high is not None and low is not None else Fraction(1)
    for power in range(1, 60):
        yield from (start + width * Fraction(n, 2**power) for n in (1, 3, 7) if n < 2**power)
    if low is None or high is None:
        away = 1 if high is None else -1
        edge = low[0] if low is not None else high[0] if high is not None else Fraction(0)
        yield from (edge + away * n for n in range(1, _MAX_TRIES))


def _as_json(number: Fraction) -> int | float | None:
    """Return a number that is written exactly so; None when there is none."""
    if number.denominator == 1:
        return int(number)
    if not _is_small(number):
        return None
    written = float(number)
    return written if exact(written) == number else None


def _is_small(number: Fraction) -> bool:
    """Say whether a number is within what floats reach."""
    return abs(number) < _LARGEST


Number: TypeAlias = "Fraction | int"
"""Whole numbers are integers here, which compare much faster."""
Cut: TypeAlias = "tuple[Number, int]"
Bound: TypeAlias = "tuple[Number, bool] | None"
"""A bound and whether it is itself left out; None where there is none."""


@frozen
class Numbers:
    """A set of numbers: whether it starts at minus infinity, and where membership changes."""

    begins: bool
    cuts: tuple[Cut, ...] = ()

    def intervals(self) -> Iterator[tuple[Bound, Bound]]:
        """Yield the lower and upper bound of each interval."""
        edges: list[Cut | None] = [None, *self.cuts] if self.begins else [*self.cuts]
        if len(edges) % 2:
            edges.append(None)
        for low, high in zip(edges[::2], edges[1::2], strict=True):
            yield (
                None if low is None else (low[0], low[1] == 1),
                None if high is None else (high[0], high[1] == 0),
            )


EVERY_NUMBER = Numbers(begins=True)
NO_NUMBER = Numbers(begins=False)


def above(bound: Fraction, *, strict: bool) -> Numbers:
    """Return the numbers above a bound, itself among them unless strict."""
    return Numbers(False, ((_plain(bound), int(strict)),))


def below(bound: Fraction, *, strict: bool) -> Numbers:
    """Return the numbers below a bound, itself among them unless strict."""
    return Numbers(True, ((_plain(bound), int(not strict)),))


def points(values: Iterable[Fraction]) -> Numbers:
    plain = sorted({_plain(value) for value in values})
    return Numbers(False, tuple((item, side) for item in plain for side in (0, 1)))


def counted(sets: Iterable[Numbers], keep: Callable[[int], bool]) -> Numbers:
    """Return the numbers that are in a number of the sets for which `keep` holds."""
    count = 0
    changes: dict[Cut, int] = {}
    for set_ in sets:
        count += set_.begins
        step = -1 if set_.begins else 1
        for cut in set_.cuts:
            changes[cut] = changes.get(cut, 0) + step
            step = -step
    begins = inside = keep(count)
    cuts: list[Cut] = []
    for cut in sorted(changes):
        count += changes[cut]
        if keep(count) != inside:
            inside = not inside
            cuts.append(cut)
    return Numbers(begins, tuple(cuts))


def _plain(number: Fraction) -> Number:
    return number.numerator if number.denominator == 1 else number


_MAX_STEPS = 4

Asking: TypeAlias = Generator[SchemaNode, Numbers, Numbers]


# Goals decided whole: unions of hundreds of ranges without trying them in turn. Once it is fixed
# which of the steps in play (`multipleOf`, `integer`) divide the number, every schema is a set of
# intervals; each such case is computed exactly.
def find_number_whole(goal: Sequence[Literal], spend: Callable[[int], None]) -> Result:
    """Return a number that meets every literal of a goal.

    Args:
        goal: schemas with their signs.
        spend: is called with the work that is done.

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
            if isinstance(result, Witness):
                return result
            unknown = result if isinstance(result, Unknown) else unknown
    return unknown or UNSATISFIABLE


def _steps(nodes: Sequence[SchemaNode], spend: Callable[[int], None]) -> set[Fraction]:
    found: set[Fraction] = set()
    waiting = list(nodes)
    seen: set[int] = set()
    while waiting:
        node = waiting.pop()
        if node.number in seen:
            continue
        seen.add(node.number)
        if not len(seen) % 32:
            spend(1)
        if node.unsupported:
            raise OutOfScopeError(node.unsupported)
        if node.integer_only:
            found.add(Fraction(1))
        if node.multiple is not None:
            found.add(node.multiple)
        waiting.extend(node.applied())
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
