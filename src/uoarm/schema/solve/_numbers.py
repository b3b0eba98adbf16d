"""Finding a number: in an interval, a multiple of some, not of others, not one of a set."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction
from typing import Any, TypeAlias

from attrs import frozen

from uoarm.schema._values import exact
from uoarm.schema.solve._branch import EMPTY, Found, Result, Unknown

__all__ = [
    "EVERY_NUMBER",
    "NO_NUMBER",
    "Bound",
    "Numbers",
    "above",
    "below",
    "counted",
    "find_number",
    "points",
]

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

    `spend` is told how much work is done.
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
        return EMPTY
    if step is not None:
        return _on_lattice(step, low, high, never, excluded, spend)
    return _anywhere(low, high, never, excluded)


def _common(one: Fraction | None, other: Fraction) -> Fraction:
    """Return the least number that both divide."""
    if one is None:
        return other
    return Fraction(
        math.lcm(one.numerator, other.numerator), math.gcd(one.denominator, other.denominator)
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
        return EMPTY
    periods = [(step / fraction).denominator for fraction in never]
    if 1 in periods:
        return EMPTY
    skipped = False
    taken = {int(fraction / step) for fraction in excluded if (fraction / step).denominator == 1}
    for tries, factor in enumerate(_outwards(least, most)):
        if not tries % 32:
            spend(1)
        if factor not in taken and all(factor % period for period in periods):
            written = _as_json(factor * step)
            if written is not None:
                return Found(written)
            skipped = True
        if tries > _MAX_TRIES + len(taken):
            return Unknown("too many multiples had to be tried")
    return Unknown(_UNWRITTEN) if skipped else EMPTY


def _outwards(least: int | None, most: int | None) -> Iterable[int]:
    """Yield every whole number of an interval, near zero or near a bound first."""
    if least is None and most is None:
        at = 0
        while True:
            yield at
            at = -at if at > 0 else 1 - at
    elif least is None:
        assert most is not None
        at = min(most, 0)
        yield from range(max(at, 0), most + 1)
        while True:
            yield at
            at -= 1
    elif most is None:
        at = max(least, 0)
        while True:
            yield at
            at += 1
    else:
        start = min(max(least, 0), most)
        yield from range(start, most + 1)
        yield from range(start - 1, least - 1, -1)


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
            return EMPTY
        written = _as_json(low[0])
        return Unknown(_UNWRITTEN) if written is None else Found(written)
    for number in _candidates(low, high):
        written = _as_json(number)
        if written is None and _is_small(number):
            number = exact(float(number))  # noqa: PLW2901 - the nearest that can be written
            written = _as_json(number)
        if written is not None and fits(number):
            return Found(written)
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
    """Return the set of some single numbers."""
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
