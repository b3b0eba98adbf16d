"""JSON values compared as JSON Schema compares them: exact numbers, no booleans among them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from decimal import Decimal
from fractions import Fraction
from hashlib import blake2b
from itertools import groupby, islice
from typing import Any, TypeAlias

from uoarm.schema._errors import OutOfScopeError, SchemaError

_SHOWN_PARTS = 200
_MOST_SHOWN = 60
_SHOWN_ITEMS = 3
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
        current, depth = waiting.pop()
        parts: Any = ()
        if isinstance(current, (dict, list, str, tuple, Repeated, Mapping)):
            size += len(current)
        if size > most or depth > _MAX_LEVELS:
            return False
        if isinstance(current, str):
            continue
        if isinstance(current, (list, tuple)):
            parts = current
        elif isinstance(current, Repeated):
            parts = (item for item, count in current.runs for _ in range(count))
        elif isinstance(current, (dict, Mapping)):
            parts = current.values()
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
        current = waiting[-1]
        missing = [
            part
            for part in _parts(current)
            if part.__class__ not in _PLAIN and id(part) not in built
        ]
        if missing and id(current) not in built:
            waiting.extend(missing)
            continue
        waiting.pop()
        if isinstance(current, (dict, Mapping)):
            built[id(current)] = {name: made(part) for name, part in current.items()}
        elif isinstance(current, Repeated | list | tuple):
            items: list[Any] = []
            for _, item, count in runs_of(current):
                items.extend([made(item)] * count)
            built[id(current)] = items
        else:
            built[id(current)] = current
    return made(value)


def describe(value: Any) -> Any:
    """Return a short JSON value that shows what a long one is like."""
    return _Description().describe(value)


class _Description:
    """One description, of at most `_SHOWN_PARTS` parts."""

    def __init__(self) -> None:
        self._left = _SHOWN_PARTS

    def describe(self, value: Any) -> Any:
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
                for _, item, count in islice(runs_of(element), self._take(_SHOWN_ITEMS)):
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
        if isinstance(value, str) and len(value) > _MOST_SHOWN:
            return f"{value[:_MOST_SHOWN]}... ({len(value):,} characters)"
        return value


def _parts(value: Any) -> list[Any]:
    if isinstance(value, (dict, Mapping)):
        return list(value.values())
    if isinstance(value, Repeated):
        return [item for item, _ in value.runs]
    return list(value) if isinstance(value, (list, tuple)) else []


_MAX_BITS = 100_000
SCALARS = frozenset({str, int, float, bool, type(None)})
_KINDS: dict[type, str] = {
    type(None): "null", bool: "boolean", int: "number", float: "number", str: "string",
    list: "array", tuple: "array", Repeated: "array", dict: "object",
}  # fmt: skip

Key: TypeAlias = "tuple[object, ...]"


def exact(number: float) -> Fraction:
    """Return the number that its shortest decimal text means."""
    return Fraction(number if isinstance(number, int) else Decimal(float.__repr__(number)))


def kind_of(value: object) -> str:
    """Return the JSON kind of a value; every number is a `number`."""
    known = _KINDS.get(value.__class__)
    if known is not None:
        return known
    return next((name for kind, name in _KINDS.items() if isinstance(value, kind)), "object")


def key_of(value: object) -> Key:
    """Return a hashable form that is equal exactly when the JSON values are."""
    return Keys().of(value)


class Keys:
    """Keys of the parts of values that live as long as this; each part is keyed once.

    An array or object is keyed by a digest of the keys of its parts, so that one whose parts are
    shared costs what it takes to store, not what it takes to write.

    Args:
        spend: is called for each array and object.
    """

    def __init__(self, spend: Callable[[int], None] = lambda _: None) -> None:
        self._spend = spend
        self._known: dict[int, Key] = {}
        self._scalars = 0

    def of(self, value: object) -> Key:
        """Return the key of a value.

        Raises:
            SchemaError: it is no JSON value.
        """
        if not is_composite(value):
            self._scalars += 1
            if not self._scalars % 32:
                self._spend(1)
            return _scalar_key(value)
        known = self._known.get(id(value))
        return self._composite(value) if known is None else known

    def _composite(self, value: object) -> Key:
        waiting: list[tuple[Any, bool]] = [(value, False)]
        around: set[int] = set()
        while waiting:
            item, entered = waiting.pop()
            if id(item) in self._known:
                continue
            if entered:
                around.discard(id(item))
                self._known[id(item)] = self._digest(item)
                continue
            if id(item) in around:
                raise SchemaError("", "a JSON value", "an array or object in itself")
            around.add(id(item))
            waiting.append((item, True))
            waiting.extend(
                (part, False) for part in _composites(item) if id(part) not in self._known
            )
        return self._known[id(value)]

    def _digest(self, value: Any) -> Key:
        self._spend(1)
        digest = blake2b(digest_size=32)
        if isinstance(value, Mapping):
            if not all(isinstance(name, str) for name in value):
                raise SchemaError("", "a JSON value", value)
            for name in sorted(value):
                digest.update(_octets(("string", name)) + _octets(self.of(value[name])))
            return ("object", digest.digest())
        if isinstance(value, Repeated):
            runs = [(self.of(item), count) for item, count in value.runs]
        else:
            runs = [(self.of(item), 1) for item in value]
        for key, same in groupby(runs, lambda run: run[0]):
            digest.update(_octets(key) + b"%d;" % sum(count for _, count in same))
        return ("array", digest.digest())


def is_composite(value: object) -> bool:
    """Say whether a value is an array or an object."""
    if value.__class__ in SCALARS:
        return False
    return isinstance(value, (dict, list, tuple, Repeated, Mapping))


def _composites(value: Any) -> list[Any]:
    if isinstance(value, Mapping):
        parts: Any = value.values()
    else:
        parts = (item for item, _ in value.runs) if isinstance(value, Repeated) else value
    return [part for part in parts if is_composite(part)]


def _scalar_key(value: object) -> Key:
    if value is None or isinstance(value, bool):
        return ("literal", value is None, bool(value))
    if isinstance(value, int):
        if value.bit_length() > _MAX_BITS:
            raise OutOfScopeError(f"a number of more than {_MAX_BITS:,} bits")
        return ("number", value)
    if isinstance(value, float):
        if not math.isfinite(value):
            raise SchemaError("", "a JSON value", value)
        number = exact(value)
        return ("number", int(number) if number.denominator == 1 else number)
    if isinstance(value, str):
        return ("string", value)
    raise SchemaError("", "a JSON value", value)


def _octets(key: Key) -> bytes:
    """Return a key as octets of which none begin another."""
    kind, content = str(key[0]), key[1]
    if kind == "literal":
        text = b"1" if content else b"2" if key[2] else b"3"
    elif kind == "string":
        text = str(content).encode("utf-8", "surrogatepass")
    elif isinstance(content, bytes):
        text = content
    else:
        number: Any = content
        text = b"%x/%x" % (number.numerator, number.denominator)
    return b"%c%d:%b" % (kind.encode()[0], len(text), text)
