"""Numbers at the edges of what a schema allows, computed exactly."""

from __future__ import annotations

import math
import sys
from fractions import Fraction
from typing import TYPE_CHECKING

from uoarm.testing._choices import chance

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from uoarm.testing._choices import Choices

_LANDMARKS = (0, 1, -1, 127, 128, 255, 256, -128, 2**31, 2**53, 2**53 + 1, -(2**63), 2**63, 2**64)
_LOWER, _UPPER = ("minimum", "exclusiveMinimum"), ("maximum", "exclusiveMaximum")
_STEPS = (Fraction(0), Fraction(1), Fraction(-1), Fraction(1, 2), Fraction(-1, 2), Fraction(1, 10))


def exact(number: float) -> Fraction:
    """The number that the JSON text of ``number`` denotes, not the binary approximation of it."""
    return Fraction(number) if isinstance(number, int) else Fraction(repr(number))


def as_json(number: Fraction) -> int | float:
    """``number`` as Python reads it from JSON: the nearest double when it is no integer."""
    if number.denominator == 1 or abs(number) >= sys.float_info.max:
        return int(number)
    return float(number)


def draw_number(
    choices: Choices, schemas: Sequence[Mapping[str, object]], *, integer: bool
) -> int | float:
    """A number at, or a step beside, a bound, a multiple or a landmark of ``schemas``."""
    bounds = list(_bounds(schemas))
    anchors = (
        [*bounds, *(Fraction(mark) for mark in _LANDMARKS)]
        if bounds
        else list(map(Fraction, _LANDMARKS))
    )
    value = (
        anchors[choices.integer(0, len(anchors) - 1)]
        if not (bounds and chance(choices, 75))
        else choices.item(bounds)
    )
    value += choices.item(_STEPS)
    if chance(choices, 30):
        value += choices.integer(-12, 12)
    value = _inside(value, schemas)
    lattice = _lattice(schemas, integer=integer)
    if lattice is not None:
        rounding = choices.item((math.floor, math.ceil))
        value = rounding(value / lattice) * lattice
    number = as_json(value)
    if isinstance(number, int) and abs(number) < 2**53 and chance(choices, 10):
        return float(number)
    return number


def _inside(value: Fraction, schemas: Sequence[Mapping[str, object]]) -> Fraction:
    """The value mirrored at the bound that it passed: an object of 20 numbers needs all to fit."""
    low = max(_bounds(schemas, _LOWER), default=None)
    high = min(_bounds(schemas, _UPPER), default=None)
    if low is not None and value < low:
        value = 2 * low - value
        return value if high is None else min(value, high)
    if high is not None and value > high:
        value = 2 * high - value
        return value if low is None else max(value, low)
    return value


def _bounds(
    schemas: Sequence[Mapping[str, object]], keywords: Sequence[str] = (*_LOWER, *_UPPER)
) -> Iterator[Fraction]:
    for schema in schemas:
        for keyword in keywords:
            bound = schema.get(keyword)
            if isinstance(bound, (int, float)):
                yield exact(bound)


def _lattice(schemas: Sequence[Mapping[str, object]], *, integer: bool) -> Fraction | None:
    steps = [Fraction(1)] if integer else []
    for schema in schemas:
        step = schema.get("multipleOf")
        if isinstance(step, (int, float)) and step > 0:
            steps.append(exact(step))
    if not steps:
        return None
    common = steps[0]
    for step in steps[1:]:
        common = Fraction(
            math.lcm(common.numerator, step.numerator),
            math.gcd(common.denominator, step.denominator),
        )
    return common
