"""Sets of numbers as sorted cuts of the number line.

A cut stands just before a number (side 0) or just after it (side 1); membership changes at each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction
from typing import TypeAlias

from attrs import frozen

__all__ = ["EVERY_NUMBER", "NO_NUMBER", "Bound", "Numbers", "above", "below", "counted", "points"]

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
