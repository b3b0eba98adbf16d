"""Finding an array of distinct items of which given numbers meet given schemas."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from typing import Any, TypeAlias

from attrs import frozen

from uoarm.schema._distinct import Matching, several
from uoarm.schema._layout import Layout
from uoarm.schema._results import EMPTY, Found, Result, Unknown
from uoarm.schema._solve import Asking, Goal, Solver
from uoarm.schema._values import Keys

__all__ = ["build_distinct_counted"]

_MAX_ITEMS = 130
_MAX_TRIES = 20_000


@frozen
class _Option:
    """One class of items that a position may hold: which counted schemas they meet."""

    signs: tuple[bool, ...]
    candidates: Sequence[Any]


Options: TypeAlias = "list[list[_Option]]"


def build_distinct_counted(solver: Solver, layout: Layout, longest: int) -> Asking:
    """Build an array of at most `longest` items, trying what each position may hold in turn."""
    if longest > _MAX_ITEMS:
        return Unknown(f"up to {longest:,} distinct items would have to be counted through")
    options: Options = []
    unknown: Unknown | None = None
    for position in range(longest):
        if position > layout.generic:
            options.append(options[-1])
            continue
        found = yield from _options(solver, layout, position, longest)
        unknown = found if isinstance(found, Unknown) else unknown
        options.append([] if isinstance(found, Unknown) else found)
    result = _choose(solver, layout, options)
    return result if isinstance(result, Found) else unknown or result


def _options(
    solver: Solver, layout: Layout, position: int, longest: int
) -> Generator[Goal, Result, list[_Option] | Unknown]:
    options: list[_Option] = []
    for signs, goal in layout.classes(position):
        found = yield from several(solver, goal, longest)
        if isinstance(found, Unknown):
            return found
        if found:
            options.append(_Option(signs, found))
    return options


def _choose(solver: Solver, layout: Layout, options: Options) -> Result:
    """Go through the choices; positions that are alike take their options in order."""
    start = tuple(0 for _ in layout.counts)
    waiting: list[tuple[int, tuple[int, ...], int, Matching]] = [
        (0, start, 0, Matching(Keys(solver.spend)))
    ]
    tries = 0
    while waiting:
        position, counts, last, matching = waiting.pop()
        if position >= layout.least and layout.enough(counts):
            return Found(matching.values())
        if position == len(options):
            continue
        first = last if position > layout.generic else 0
        for number in range(len(options[position]) - 1, first - 1, -1):
            tries += 1
            solver.spend()
            if tries > _MAX_TRIES:
                return Unknown("distinct items together with contains")
            option = options[position][number]
            after = layout.count_on(counts, option.signs)
            longer = matching.copy()
            if after is not None and longer.add(option.candidates):
                waiting.append((position + 1, after, number, longer))
    return EMPTY
