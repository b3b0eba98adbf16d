"""Finding distinct values for several goals: enough candidates, then a matching."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from typing import Any

from uoarm.schema._results import EMPTY, Found, Result, Unknown
from uoarm.schema._solve import Goal, Solver
from uoarm.schema._values import key_of

__all__ = ["distinct"]


def distinct(solver: Solver, goals: Sequence[Goal]) -> Generator[Goal, Result, Result]:
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
