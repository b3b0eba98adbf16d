"""Finding an array: a length, what each position must meet, and two equal items where needed."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

from uoarm.schema._values import Repeated
from uoarm.schema.solve._branch import EMPTY, Found, Literal, Unknown
from uoarm.schema.solve._counting import build_counted, distinct
from uoarm.schema.solve._layout import Layout
from uoarm.schema.solve._solver import Asking, SearchState, Solver

__all__ = ["array_leaf"]

_MAX_ITEMS = 4_000_000
_MAX_WRITTEN = 100
_MAX_DISTINCT = 300
_MAX_COUNTS = 8


def array_leaf(solver: Solver, state: SearchState) -> Asking:
    """Answer a goal of which only atoms about an array are left."""
    layout = Layout(state.atoms)
    if layout.most is not None and layout.least > layout.most:
        return EMPTY
    if len(layout.counts) > _MAX_COUNTS:
        return Unknown(f"more than {_MAX_COUNTS} contains meet")
    return (yield _place(solver, layout, layout.some))


def _place(solver: Solver, layout: Layout, demands: Sequence[tuple[int, Literal]]) -> Asking:
    """Choose a position for each demand that some item must meet."""
    if not demands:
        if layout.twice:
            return (yield _repeat(solver, layout))
        return (yield from _build(solver, layout, {}))
    (start, literal), rest = demands[0], demands[1:]
    unknown: Unknown | None = None
    last = max(layout.generic, start) + len(layout.some) - 1
    for position in range(start, last + 1):
        if layout.most is not None and position >= layout.most:
            break
        solver.spend()
        result = yield (*layout.literals(position), literal)
        if isinstance(result, Found):
            before, least = layout.at.get(position, []), layout.least
            layout.at[position] = [*before, literal]
            layout.least = max(least, position + 1)
            result = yield _place(solver, layout, rest)
            layout.at[position], layout.least = before, least
            if not before:
                del layout.at[position]
        if isinstance(result, Found):
            return result
        unknown = result if isinstance(result, Unknown) else unknown
    return unknown or EMPTY


def _repeat(solver: Solver, layout: Layout) -> Asking:
    """Build an array with two equal items."""
    if layout.unique:
        return EMPTY
    unknown: Unknown | None = None
    end = layout.generic + 2
    for second in range(1, end):
        if layout.most is not None and second >= layout.most:
            break
        for first, signs in product(range(second), layout.sign_vectors()):
            solver.spend()
            result = yield (
                *layout.literals(first),
                *layout.literals(second),
                *layout.signed(signs),
            )
            if isinstance(result, Found):
                least = layout.least
                layout.least = max(least, second + 1)
                fixed = {first: result.value, second: result.value}
                result = yield from _build(solver, layout, fixed)
                layout.least = least
            if isinstance(result, Found):
                return result
            unknown = result if isinstance(result, Unknown) else unknown
    return unknown or EMPTY


def _build(solver: Solver, layout: Layout, fixed: dict[int, Any]) -> Asking:
    """Build the array, its demanded positions chosen and some items perhaps fixed."""
    if layout.counts:
        return (yield from build_counted(solver, layout, fixed))
    if layout.least > _MAX_ITEMS:
        return Unknown(f"the shortest array has {layout.least:,} items")
    if layout.unique and layout.least > 1:
        goals = [layout.literals(n) for n in range(min(layout.least, _MAX_DISTINCT))]
        found = yield from distinct(solver, goals)
        if isinstance(found, Found) and layout.least > _MAX_DISTINCT:
            return Unknown(f"{layout.least:,} distinct items would be needed")
        return found
    items: list[Any] = []
    for position in range(min(layout.least, layout.generic + 1)):
        if position in fixed:
            items.append(fixed[position])
            continue
        result = yield layout.literals(position)
        if not isinstance(result, Found):
            return result
        items.append(result.value)
    for position in sorted(fixed):
        if position >= len(items):
            items.extend([items[-1] if items else fixed[position]] * (position - len(items)))
            items.append(fixed[position])
    more = layout.least - len(items)
    if more > 0:
        result = yield layout.literals(layout.generic)
        if not isinstance(result, Found):
            return result
        if more > _MAX_WRITTEN:
            return Found(Repeated([*((item, 1) for item in items), (result.value, more)]))
        items.extend([result.value] * more)
    return Found(items)
