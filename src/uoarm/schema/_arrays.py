"""Finding an array: a length, what each position must meet, counts, and distinct items."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Sequence
from typing import Any

from uoarm.schema._branch import Atom, Literal
from uoarm.schema._evaluate import accepts
from uoarm.schema._node import Node
from uoarm.schema._results import EMPTY, Found, Result, Unknown
from uoarm.schema._solve import Asking, Goal, Solver, State
from uoarm.schema._values import key_of

__all__ = ["array_leaf"]

_MAX_ITEMS = 4_000_000
_MAX_COUNTED = 3_000
_MAX_DISTINCT = 130


class _Layout:
    """The demands on an array, arranged by position."""

    def __init__(self, atoms: Iterable[Atom]) -> None:
        self.least = 0
        self.most: int | None = None
        self.at: dict[int, list[Literal]] = {}
        self.tails: list[tuple[int, Literal]] = []
        self.some: list[tuple[int, Literal]] = []
        self.counts: list[tuple[Node, int, int | None]] = []
        self.unique = self.twice = False
        for atom in atoms:
            self._take(atom)

    def _take(self, atom: Atom) -> None:
        tag = atom[0]
        rest: Any = atom[1:]
        if tag == "least":
            self.least = max(self.least, rest[0])
        elif tag == "most":
            self.most = rest[0] if self.most is None else min(self.most, rest[0])
        elif tag == "at":
            self.at.setdefault(rest[0], []).append(rest[1])
        elif tag == "someat":
            self.at.setdefault(rest[0], []).append(rest[1])
            self.least = max(self.least, rest[0] + 1)
        elif tag == "tail":
            self.tails.append((rest[0], rest[1]))
        elif tag == "some":
            self.some.append((rest[0], rest[1]))
        elif tag == "contains":
            self.counts.append(rest)
        elif tag == "unique":
            self.unique = True
        else:
            self.twice = True

    @property
    def generic(self) -> int:
        """The first position from which on all are alike."""
        return max([*(n + 1 for n in self.at), *(start for start, _ in self.tails), 0])

    def literals(self, position: int) -> Goal:
        """Return what the item at a position must meet."""
        tail = (literal for start, literal in self.tails if position >= start)
        return (*self.at.get(position, ()), *tail)


def array_leaf(solver: Solver, state: State) -> Asking:
    """Answer a goal of which only atoms about an array are left."""
    layout = _Layout(state.atoms)
    if layout.most is not None and layout.least > layout.most:
        return EMPTY
    return (yield from _place(solver, layout, layout.some))


def _place(solver: Solver, layout: _Layout, demands: Sequence[tuple[int, Literal]]) -> Asking:
    """Choose a position for each demand that some item must meet."""
    if not demands:
        if layout.twice:
            return (yield from _repeat(solver, layout))
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
            result = yield from _place(solver, layout, rest)
            layout.at[position], layout.least = before, least
            if not before:
                del layout.at[position]
        if isinstance(result, Found):
            return result
        unknown = result if isinstance(result, Unknown) else unknown
    return unknown or EMPTY


def _repeat(solver: Solver, layout: _Layout) -> Asking:
    """Build an array with two equal items."""
    if layout.unique:
        return EMPTY
    unknown: Unknown | None = None
    end = layout.generic + 2
    for second in range(1, end):
        if layout.most is not None and second >= layout.most:
            break
        for first in range(second):
            solver.spend()
            result = yield (*layout.literals(first), *layout.literals(second))
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


def _build(solver: Solver, layout: _Layout, fixed: dict[int, Any]) -> Asking:
    """Build the array, its demanded positions chosen and some items perhaps fixed."""
    if layout.counts:
        return (yield from _build_counted(solver, layout, fixed))
    if layout.least > _MAX_ITEMS:
        return Unknown(f"the shortest array has {layout.least:,} items")
    if layout.unique and layout.least > 1:
        goals = [layout.literals(n) for n in range(min(layout.least, _MAX_DISTINCT))]
        distinct = yield from _distinct(solver, goals)
        if isinstance(distinct, Found) and layout.least > _MAX_DISTINCT:
            return Unknown(f"{layout.least:,} distinct items would be needed")
        return distinct
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
    if len(items) < layout.least:
        result = yield layout.literals(layout.generic)
        if not isinstance(result, Found):
            return result
        items.extend([result.value] * (layout.least - len(items)))
    return Found(items)


def _build_counted(solver: Solver, layout: _Layout, fixed: dict[int, Any]) -> Asking:
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
        for signs in _sign_vectors(len(layout.counts)):
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


def _sign_vectors(count: int) -> list[tuple[bool, ...]]:
    vectors: list[tuple[bool, ...]] = [()]
    for _ in range(count):
        vectors = [(*one, sign) for one in vectors for sign in (True, False)]
    return vectors


def _count_on(
    layout: _Layout, counts: tuple[int, ...], signs: tuple[bool, ...]
) -> tuple[int, ...] | None:
    """Return the counts after one more item; counts that no longer matter stay where they are."""
    after = []
    for (_, least, most), count, sign in zip(layout.counts, counts, signs, strict=True):
        more = count + sign
        if most is not None and more > most:
            return None
        after.append(min(more, least) if most is None else more)
    return tuple(after)


def _enough(layout: _Layout, counts: tuple[int, ...]) -> bool:
    return all(count >= least for (_, least, _), count in zip(layout.counts, counts, strict=True))


def _assemble(
    solver: Solver,
    layout: _Layout,
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
        result = yield from _distinct(solver, goals)
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


def _distinct(solver: Solver, goals: Sequence[Goal]) -> Generator[Goal, Result, Result]:
    """Return one value for each goal, all different: enough candidates, then a matching."""
    domains: dict[Goal, list[Any]] = {}
    for goal in goals:
        if goal not in domains:
            found = yield from _several(solver, goal, len(goals))
            if isinstance(found, Unknown):
                return found
            domains[goal] = found
    holder: dict[object, int] = {}
    values: dict[object, Any] = {}
    for position in range(len(goals)):
        if not _assign(position, goals, domains, holder, values):
            return EMPTY
    chosen = {position: values[key] for key, position in holder.items()}
    return Found([chosen[position] for position in range(len(goals))])


def _several(
    solver: Solver, goal: Goal, count: int
) -> Generator[Goal, Result, list[Any] | Unknown]:
    """Return up to `count` different values that meet a goal."""
    found: list[Any] = []
    wanted = goal
    while len(found) < count:
        result = yield wanted
        if isinstance(result, Unknown):
            return result
        if not isinstance(result, Found):
            break
        found.append(result.value)
        node = solver.make(f"one of {[key_of(one) for one in found]}", {"enum": list(found)})
        wanted = (*goal, (node, False))
    return found


def _assign(
    position: int,
    goals: Sequence[Goal],
    domains: dict[Goal, list[Any]],
    holder: dict[object, int],
    values: dict[object, Any],
) -> bool:
    """Give a position a value of its own, moving others along an augmenting path."""
    came: dict[object, tuple[int, object]] = {}
    waiting: list[tuple[int, object]] = [(position, None)]
    seen: set[object] = set()
    for place, via in waiting:
        for value in domains[goals[place]]:
            key = key_of(value)
            if key in seen:
                continue
            seen.add(key)
            values[key] = value
            came[key] = (place, via)
            if key not in holder:
                at: object = key
                while at is not None:
                    owner, before = came[at]
                    holder[at] = owner
                    at = before
                return True
            waiting.append((holder[key], key))
    return False
