"""Long arrays kept short: runs of one item, and what is built or told of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import islice
from typing import Any

__all__ = ["Repeated", "build", "describe", "is_small", "runs_of"]

_TOLD = 200
_TOLD_TEXT = 60
_TOLD_ITEMS = 3
_MAX_LEVELS = 250
_SHORT = frozenset({int, float, bool, type(None)})
_PLAIN = _SHORT | {str}


class Repeated:
    """An array of which neighbours that are the same item are kept once, with their number."""

    __slots__ = ("_length", "runs")

    def __init__(self, runs: Iterable[tuple[Any, int]]) -> None:
        self.runs = tuple(runs)
        self._length = sum(count for _, count in self.runs)

    def __len__(self) -> int:
        return self._length


def runs_of(array: Any) -> Iterator[tuple[int, Any, int]]:
    """Yield the first position, the item and the length of each run of an array.

    Neighbours that are the very same object are a run in other arrays, too.
    """
    position = 0
    if not isinstance(array, Repeated):
        before: Any = None
        for now, item in enumerate(array):
            if item is not before and now > 0:
                yield position, before, now - position
                position = now
            before = item
        if len(array):
            yield position, before, len(array) - position
        return
    for item, count in array.runs:
        yield position, item, count
        position += count


def is_small(value: object, most: int) -> bool:
    """Say whether a value has at most so many parts and characters, written out, and few levels.

    What is deeper cannot be written as JSON, printed or compared by Python.
    """
    waiting: list[tuple[Any, int]] = [(value, 0)]
    size = 1
    while waiting:
        one, depth = waiting.pop()
        parts: Any = ()
        if isinstance(one, (dict, list, str, tuple, Repeated, Mapping)):
            size += len(one)
        if size > most or depth > _MAX_LEVELS:
            return False
        if isinstance(one, str):
            continue
        if isinstance(one, (list, tuple)):
            parts = one
        elif isinstance(one, Repeated):
            parts = (item for item, count in one.runs for _ in range(count))
        elif isinstance(one, (dict, Mapping)):
            parts = one.values()
        for part in parts:
            size += 1
            if part.__class__ not in _SHORT:
                waiting.append((part, depth + 1))
    return True


def build(value: Any) -> Any:
    """Return a value with every array written out; equal parts stay shared."""
    built: dict[int, Any] = {}

    def made(part: Any) -> Any:
        return part if part.__class__ in _PLAIN else built[id(part)]

    waiting = [value]
    while waiting:
        one = waiting[-1]
        missing = [
            part for part in _parts(one) if part.__class__ not in _PLAIN and id(part) not in built
        ]
        if missing and id(one) not in built:
            waiting.extend(missing)
            continue
        waiting.pop()
        if isinstance(one, (dict, Mapping)):
            built[id(one)] = {name: made(part) for name, part in one.items()}
        elif isinstance(one, Repeated | list | tuple):
            items: list[Any] = []
            for _, item, count in runs_of(one):
                items.extend([made(item)] * count)
            built[id(one)] = items
        else:
            built[id(one)] = one
    return made(value)


def describe(value: Any) -> Any:
    """Return a short JSON value that tells what a long one is like."""
    return _Telling().tell(value)


class _Telling:
    """One description, of at most `_TOLD` parts."""

    def __init__(self) -> None:
        self._left = _TOLD

    def tell(self, value: Any) -> Any:
        root: list[Any] = [None]
        waiting: list[tuple[Any, Any, Any]] = [(value, root, 0)]
        for element, holder, place in waiting:
            holder[place] = reports = self._shallow(element)
            if isinstance(reports, dict):
                names = list(islice(element, self._take(len(element))))
                reports.update(dict.fromkeys(names))
                waiting.extend((element[name], reports, name) for name in names)
                if len(names) < len(element):
                    reports["..."] = f"{len(element) - len(names):,} more members"
            elif isinstance(reports, list):
                shown = 0
                for _, item, count in islice(runs_of(element), self._take(_TOLD_ITEMS)):
                    waiting.append((item, reports, len(reports)))
                    reports.append(None)
                    reports += [f"... {count - 1:,} more of the same"] if count > 1 else []
                    shown += count
                reports += [f"... {len(element) - shown:,} more"] if shown < len(element) else []
        return root[0]

    def _take(self, parts: int) -> int:
        taken = min(parts, self._left)
        self._left -= taken
        return taken

    def _shallow(self, value: Any) -> Any:
        if isinstance(value, Mapping):
            return {}
        if isinstance(value, Repeated | list | tuple):
            return []
        if isinstance(value, str) and len(value) > _TOLD_TEXT:
            return f"{value[:_TOLD_TEXT]}... ({len(value):,} characters)"
        return value


def _parts(value: Any) -> list[Any]:
    if isinstance(value, (dict, Mapping)):
        return list(value.values())
    if isinstance(value, Repeated):
        return [item for item, _ in value.runs]
    return list(value) if isinstance(value, (list, tuple)) else []
