"""Finding an array, also one of distinct items, of which given numbers meet given schemas."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from typing import Any, TypeAlias

from attrs import frozen

from uoarm.schema._values import Keys
from uoarm.schema.solve._distinct import Matching, several
from uoarm.schema.solve._evaluate import accepts
from uoarm.schema.solve._layout import Layout
from uoarm.schema.solve._results import EMPTY, Found, Result, Unknown
from uoarm.schema.solve._solver import Asking, Goal, Solver

__all__ = ["build_counted"]

_MAX_ITEMS = 130
_MAX_TRIES = 20_000


@frozen
class _Option:
    """One class of items that a position may hold: which counted schemas they meet."""

    signs: tuple[bool, ...]
    candidates: Sequence[Any]


Options: TypeAlias = "list[list[_Option]]"


def _build_distinct(solver: Solver, layout: Layout, longest: int) -> Asking:
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


_MAX_COUNTED = 3_000


def build_counted(solver: Solver, layout: Layout, fixed: dict[int, Any]) -> Asking:
    """Build an array of which given numbers of items meet given schemas."""
    needed = sum(least for _, least, _ in layout.counts)
    longest = max(layout.least, layout.generic) + needed
    if layout.most is not None:
        longest = min(longest, layout.most)
    if layout.unique:
        return (yield from _build_distinct(solver, layout, longest))
    if longest > _MAX_COUNTED:
        return Unknown(f"arrays of up to {longest:,} items would have to be counted through")
    unknown: Unknown | None = None
    layers: list[dict[tuple[int, ...], tuple[tuple[int, ...], Goal]]] = [{}]
    start = tuple(0 for _ in layout.counts)
    reached: dict[tuple[int, ...], tuple[tuple[int, ...], Goal]] = {start: (start, ())}
    for length in range(longest + 1):
        if length >= layout.least and length > max(fixed, default=-1):
            for counts in reached:
                if layout.enough(counts):
                    return (yield from _assemble(layers, counts, length, fixed))
        if length == longest:
            break
        options: list[tuple[tuple[bool, ...], Goal]] = []
        for signs, goal in layout.classes(length):
            if length in fixed:
                holds = all(accepts(node, fixed[length]) == sign for node, sign in goal)
                result: Result = Found(None) if holds else EMPTY
            else:
                result = yield goal
            if isinstance(result, Found):
                options.append((signs, goal))
            unknown = result if isinstance(result, Unknown) else unknown
        following: dict[tuple[int, ...], tuple[tuple[int, ...], Goal]] = {}
        for counts in reached:
            for signs, goal in options:
                solver.spend()
                after = layout.count_on(counts, signs)
                if after is not None:
                    following.setdefault(after, (counts, goal))
        layers.append(following)
        reached = following
    return unknown or EMPTY


def _assemble(
    layers: list[dict[tuple[int, ...], tuple[tuple[int, ...], Goal]]],
    counts: tuple[int, ...],
    length: int,
    fixed: dict[int, Any],
) -> Asking:
    goals: list[Goal] = []
    for position in range(length, 0, -1):
        counts, goal = layers[position][counts]
        goals.append(goal)
    goals.reverse()
    items = []
    for position, goal in enumerate(goals):
        if position in fixed:
            items.append(fixed[position])
            continue
        result = yield goal
        if not isinstance(result, Found):
            return result
        items.append(result.value)
    return Found(items)
