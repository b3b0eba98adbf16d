"""Finding distinct values for several places: enough candidates for each, then a matching."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from typing import Any

from uoarm.schema._branch import Literal
from uoarm.schema._results import EMPTY, Found, Result, Unknown
from uoarm.schema._solve import Goal, Solver
from uoarm.schema._values import key_of

__all__ = ["Matching", "distinct", "several"]


class Matching:
    """Places, each with candidates, and a value for each that no other place has."""

    def __init__(self) -> None:
        self._candidates: list[Sequence[Any]] = []
        self._holder: dict[object, int] = {}
        self._values: dict[object, Any] = {}

    def copy(self) -> Matching:
        """Return a matching that can be changed on its own."""
        other = Matching()
        other._candidates = list(self._candidates)
        other._holder = dict(self._holder)
        other._values = dict(self._values)
        return other

    def add(self, candidates: Sequence[Any]) -> bool:
        """Give one more place a value of its own, moving others along an augmenting path."""
        self._candidates.append(candidates)
        came: dict[object, tuple[int, object]] = {}
        waiting: list[tuple[int, object]] = [(len(self._candidates) - 1, None)]
        for place, via in waiting:
            for value in self._candidates[place]:
                key = key_of(value)
                if key in came:
                    continue
                self._values[key] = value
                came[key] = (place, via)
                if key not in self._holder:
                    at: object = key
                    while at is not None:
                        self._holder[at], at = came[at]
                    return True
                waiting.append((self._holder[key], key))
        self._candidates.pop()
        return False

    def values(self) -> list[Any]:
        """Return the value of each place."""
        chosen = {place: self._values[key] for key, place in self._holder.items()}
        return [chosen[place] for place in range(len(self._candidates))]


def distinct(solver: Solver, goals: Sequence[Goal]) -> Generator[Goal, Result, Result]:
    """Return one value for each goal, all different."""
    candidates: dict[Goal, list[Any]] = {}
    matching = Matching()
    for goal in goals:
        if goal not in candidates:
            found = yield from several(solver, goal, len(goals))
            if isinstance(found, Unknown):
                return found
            candidates[goal] = found
        if not matching.add(candidates[goal]):
            return EMPTY
    return Found(matching.values())


def several(solver: Solver, goal: Goal, count: int) -> Generator[Goal, Result, list[Any] | Unknown]:
    """Return up to `count` different values that meet a goal."""
    found: list[Any] = []
    keys: list[object] = []
    longer: Literal | None = None
    while len(found) < count:
        result: Result = EMPTY
        if longer is not None:
            result = yield (*goal, longer)
        if not isinstance(result, Found):
            others = solver.make(f"one of {keys}", {"enum": list(found)})
            result = yield (*goal, (others, False))
        if isinstance(result, Unknown):
            return result
        if not isinstance(result, Found):
            break
        found.append(result.value)
        keys.append(key_of(result.value))
        longer = _longer(solver, found)
    return found


def _longer(solver: Solver, found: Sequence[Any]) -> Literal | None:
    """Return what only an array or object meets that is longer than every value so far.

    It spares telling it apart from each of them, part by part.
    """
    if not isinstance(found[-1], list | dict):
        return None
    size = max(len(one) for one in found if isinstance(one, list | dict)) + 1
    schema = {"type": ["array", "object"], "minItems": size, "minProperties": size}
    return solver.make(f"longer than {size}", schema), True
