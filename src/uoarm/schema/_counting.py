"""Finding an array of which given numbers of items meet given schemas."""

from __future__ import annotations

from typing import Any

from uoarm.schema._distinct_counting import build_distinct_counted
from uoarm.schema._evaluate import accepts
from uoarm.schema._layout import Layout
from uoarm.schema._results import EMPTY, Found, Result, Unknown
from uoarm.schema._solve import Asking, Goal, Solver

__all__ = ["build_counted"]

_MAX_COUNTED = 3_000


def build_counted(solver: Solver, layout: Layout, fixed: dict[int, Any]) -> Asking:
    """Build an array of which given numbers of items meet given schemas."""
    needed = sum(least for _, least, _ in layout.counts)
    longest = max(layout.least, layout.generic) + needed
    if layout.most is not None:
        longest = min(longest, layout.most)
    if layout.unique:
        return (yield from build_distinct_counted(solver, layout, longest))
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
