"""Finding distinct values for several places: enough candidates for each, then a matching."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from typing import Any

from uoarm.schema._values import Keys, key_of, kind_of
from uoarm.schema.solve._branch import Literal
from uoarm.schema.solve._results import EMPTY, Found, Result, Unknown
from uoarm.schema.solve._solver import Goal, Solver

__all__ = ["Matching", "distinct", "several"]

_GROWTH = {
    "number": "exclusiveMinimum",
    "string": "minLength",
    "array": "minItems",
    "object": "minProperties",
}


class Matching:
    """Places, each with candidates, and a value for each that no other place has.

    `keys` lives as long as the candidates.
    """

    def __init__(self, keys: Keys) -> None:
        self._keys = keys
        self._candidates: list[Sequence[Any]] = []
        self._holder: dict[object, int] = {}
        self._values: dict[object, Any] = {}

    def copy(self) -> Matching:
        """Return a matching that can be changed on its own."""
        other = Matching(self._keys)
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
                key = self._keys.of(value)
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
    matching = Matching(Keys(solver.spend))
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
    found: dict[object, Any] = {}
    grown: set[str] = set()
    beyond: Literal | None = None
    while len(found) < count:
        result: Result = EMPTY
        if beyond is not None:
            result = yield (*goal, beyond)
        if not isinstance(result, Found):
            beyond = None
            values = list(found.values())
            others = solver.make(f"one of {list(found)}", {"enum": values})
            result = yield (*goal, (others, False))
        if isinstance(result, Unknown):
            return result
        if not isinstance(result, Found):
            break
        key = key_of(result.value)
        if key in found:
            return Unknown("internal: a value that was excluded came again")
        if beyond is not None or kind_of(result.value) not in grown:
            beyond = _beyond(solver, result.value)
            grown.add(kind_of(result.value))
        found[key] = result.value
    return list(found.values())


def _beyond(solver: Solver, value: Any) -> Literal | None:
    """Return what only larger values of the same kind meet.

    It spares telling a new value apart from each of those before.
    """
    kind = kind_of(value)
    if kind not in _GROWTH:
        return None
    size = value if kind == "number" else len(value) + 1
    schema = {"type": kind, _GROWTH[kind]: size}
    return solver.make(f"beyond {schema}", schema), True
