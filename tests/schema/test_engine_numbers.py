"""A number that is found is exactly one that was asked for, or none is claimed."""

from __future__ import annotations

from fractions import Fraction

import pytest

from uoarm.schema import check
from uoarm.schema._values import exact
from uoarm.schema.solve import Witness
from uoarm.schema.solve._numbers import find_number


def test_numbers_one_after_another_never_come_again() -> None:
    found: set[Fraction] = set()
    bounds = [("low", Fraction(0), True), ("high", Fraction(1), True)]
    for _ in range(120):
        result = find_number(bounds, frozenset(found))
        if not isinstance(result, Witness):
            break
        number = exact(result.value)
        assert 0 < number < 1
        assert number not in found
        found.add(number)
    assert len(found) > 60


@pytest.mark.parametrize(
    ("low", "high", "step"),
    [
        (0.1, 0.30000000000000004, 0.1),
        (1e17, 1e17 + 64, 0.5),
        (1e-320, 1e-318, 1e-321),
        (1e300, 1e301, 1e299),
        (-0.3, -0.1, 0.1),
    ],
)
def test_a_multiple_is_exactly_one(low: float, high: float, step: float) -> None:
    schema = {"type": "number", "minimum": low, "maximum": high, "multipleOf": step}
    verdict = check(schema, False)
    assert not verdict.compatible
    if verdict.incompatible:
        number = exact(verdict.counterexample)
        assert exact(low) <= number <= exact(high)
        assert (number / exact(step)).denominator == 1


def test_a_bound_beyond_floats_is_no_crash() -> None:
    huge = 10**400
    between = {"type": "number", "exclusiveMinimum": huge, "exclusiveMaximum": huge + 1}
    assert check(between, False).undecided is not None
    assert check({**between, "exclusiveMaximum": huge + 2}, False).counterexample == huge + 1
