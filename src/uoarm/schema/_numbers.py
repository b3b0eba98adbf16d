"""Finding a number: in an interval, a multiple of some, not of others, not one of a set."""

from __future__ import annotations

import math
from collections.abc import Iterable
from fractions import Fraction
from typing import Any

from uoarm.schema._results import EMPTY, Found, Result, Unknown
from uoarm.schema._values import exact

__all__ = ["find_number"]

_MAX_TRIES = 20_000


def find_number(atoms: Iterable[tuple[Any, ...]], excluded: frozenset[Fraction]) -> Result:
    """Return a number that meets every atom of `_expand` and is not excluded."""
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
        elif tag == "notmultiple":
            never.append(Fraction(rest[0]))
    if (
        low is not None
        and high is not None
        and (low[0] > high[0] or (low[0] == high[0] and (low[1] or high[1])))
    ):
        return EMPTY
    if step is not None:
        return _on_lattice(step, low, high, never, excluded)
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
    periods = [(step / one).denominator for one in never]
    if 1 in periods:
        return EMPTY
    for tries, factor in enumerate(_outwards(least, most)):
        if all(factor % period for period in periods) and factor * step not in excluded:
            return Found(_as_json(factor * step))
        if tries > _MAX_TRIES:
            return Unknown("too many multiples had to be tried")
    return EMPTY


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
        if number in excluded or any((number / one).denominator == 1 for one in never):
            return False
        if low is not None and (number < low[0] or (number == low[0] and low[1])):
            return False
        return high is None or number < high[0] or (number == high[0] and not high[1])

    if low is not None and high is not None and low[0] == high[0]:
        return Found(_as_json(low[0])) if fits(low[0]) else EMPTY
    whole = [Fraction(0), Fraction(1)]
    whole += [low[0], low[0] + 1] if low is not None else []
    whole += [high[0], high[0] - 1] if high is not None else []
    for number in whole:
        if fits(number):
            return Found(_as_json(number))
    start = low[0] if low is not None else (high[0] - 1 if high is not None else Fraction(0))
    width = high[0] - start if high is not None and low is not None else Fraction(1)
    for power in range(1, 60):
        for count in (1, 3, 7):
            number = start + width * Fraction(count, 2**power)
            if count < 2**power and fits(number) and exact(float(number)) == number:
                return Found(_as_json(number))
            if count < 2**power and fits(exact(float(number))):
                return Found(float(number))
    for power in range(1, 40):
        number = start + width / 2**power
        if fits(number):
            return Found(_as_json(number))
    return Unknown("no number that JSON can write was found between the bounds")


def _as_json(number: Fraction) -> int | float:
    if number.denominator == 1:
        return int(number)
    return float(number)
