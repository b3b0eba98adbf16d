"""Finding an array of which given numbers of items meet given schemas."""

from __future__ import annotations

from typing import Any

from uoarm.schema._distinct import distinct
from uoarm.schema._evaluate import accepts
from uoarm.schema._layout import Layout
from uoarm.schema._results import EMPTY, Found, Result, Unknown
from uoarm.schema._solve import Asking, Goal, Solver

__all__ = ["build_counted", "sign_vectors"]

_MAX_COUNTED = 3_000


def build_counted(solver: Solver, layout: Layout, fixed: dict[int, Any]) -> Asking:
    """Build an array of which given numbers of items meet given schemas."""
    needed = sum(least for _, least, _ in layout.counts)
    longest = max(layout.least, layout.generic) + needed
    if layout.most is not None:
        longest = min(longest, layout.most)
    if longest > _MAX_COUNTED:
        return Unknown(f"arrays of up to {longest:,} items would have to be counted through")
    unknown: Unknown | None = None
    layers: list[dict[tuple[int, ...], tuple[tuple[int, ...], Goal]]] = [{}]
    start = tuple(0 for _ in layout.counts)
    reached: dict[tuple[int, ...], tuple[tuple[int, ...], Goal]] = {start: (start, ())}
    for length in range(longest + 1):
        if length >= layout.least and length > max(fixed, default=-1):
            for counts in reached:
                if _enough(layout, counts):
                    return (yield from _assemble(solver, layout, layers, counts, length, fixed))
        if length == longest:
            break
        options: list[tuple[tuple[bool, ...], Goal]] = []
        for signs in sign_vectors(len(layout.counts)):
            goal = (
                *layout.literals(length),
                *((node, sign) for (node, _, _), sign in zip(layout.counts, signs, strict=True)),
            )
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
                after = _count_on(layout, counts, signs)
                if after is not None:
                    following.setdefault(after, (counts, goal))
        layers.append(following)
        reached = following
    return unknown or EMPTY


def sign_vectors(count: int) -> list[tuple[bool, ...]]:
    vectors: list[tuple[bool, ...]] = [()]
    for _ in range(count):
        vectors = [(*one, sign) for one in vectors for sign in (True, False)]
    return vectors


def _count_on(
    layout: Layout, counts: tuple[int, ...], signs: tuple[bool, ...]
) -> tuple[int, ...] | None:
    """Return the counts after one more item; counts that no longer matter stay where they are."""
    after = []
    for (_, least, most), count, sign in zip(layout.counts, counts, signs, strict=True):
        more = count + sign
        if most is not None and more > most:
            return None
        after.append(min(more, least) if most is None else more)
    return tuple(after)


def _enough(layout: Layout, counts: tuple[int, ...]) -> bool:
    return all(count >= least for (_, least, _), count in zip(layout.counts, counts, strict=True))


def _assemble(
    solver: Solver,
    layout: Layout,
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
    if layout.unique:
        result = yield from distinct(solver, goals)
        if isinstance(result, Found):
            return result
        return Unknown("distinct items together with contains")
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
