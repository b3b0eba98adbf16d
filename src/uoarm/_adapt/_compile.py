"""Compiling an adapter into one function: closures over constants, nothing is evaluated."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

from uoarm._adapt._mapping import Clamp, Mapped, Path, Scale, write_path
from uoarm.errors import MessageError

__all__ = ["MISSING", "Maker", "build_object", "constant", "each_item", "mapped", "reader"]

Maker: TypeAlias = Callable[[Any], Any]


class _Missing:
    """Stands for an optional field that a message does not have."""


MISSING = _Missing()


def reader(path: Path) -> Maker:
    """Return a function that reads a path, MISSING where the message has nothing there."""
    if not path:
        return lambda message: message
    if len(path) == 1:
        (name,) = path
        return lambda message: message.get(name, MISSING)

    def read(message: Any) -> Any:
        for part in path:
            if message is MISSING:
                return MISSING
            message = message.get(part, MISSING)
        return message

    return read


def constant(value: Any) -> Maker:
    """Return a function that ignores the message."""
    return lambda _: value


def mapped(entry: Mapped, table: Mapping[Any, Any] | None, clamp: Clamp | None) -> Maker:
    """Return the function of one entry: read, look up, scale, clamp, default."""
    assert entry.source is not None, "constants are made by `constant`"
    read = reader(entry.source)
    changes = [] if entry.scale is None else [_scaler(entry.scale)]
    changes += [] if clamp is None else [_clamper(clamp)]
    if table is None and not changes and not entry.has_default:
        return read
    where = write_path(entry.source)

    def make(message: Any) -> Any:
        value = read(message)
        if value is MISSING:
            return entry.default if entry.has_default else MISSING
        if table is not None:
            if value not in table:
                raise MessageError(f"{where}: the enum map says nothing of {value!r}")
            value = table[value]
        for change in changes:
            value = change(value)
        return value

    return make


def each_item(read: Maker, make: Maker) -> Maker:
    """Return a function that makes every item of an array."""

    def items(message: Any) -> Any:
        value = read(message)
        return MISSING if value is MISSING else [make(item) for item in value]

    return items


def build_object(makers: Sequence[tuple[str, Maker, bool]]) -> Maker:
    """Return a function that makes an object of named values, without those that are missing."""
    if all(always for _, _, always in makers):

        def build(message: Any) -> Any:
            made = {name: make(message) for name, make, _ in makers}
            for name, value in made.items():
                if value is MISSING:
                    raise MessageError(f"the message has nothing for the field {name!r}")
            return made

        return build

    def build_present(message: Any) -> Any:
        made = {}
        for name, make, always in makers:
            value = make(message)
            if value is not MISSING:
                made[name] = value
            elif always:
                raise MessageError(f"the message has nothing for the field {name!r}")
        return made

    return build_present


def _scaler(scale: Scale) -> Maker:
    factor, offset = scale.factor, scale.offset

    def apply(value: Any) -> Any:
        if isinstance(value, int | float) or hasattr(value, "dtype"):
            return value * factor + offset
        return [item * factor + offset for item in value]

    return apply


def _clamper(clamp: Clamp) -> Maker:
    low, high = clamp.low, clamp.high

    def one(value: Any) -> Any:
        return low if value < low else min(value, high)

    def apply(value: Any) -> Any:
        if hasattr(value, "dtype"):
            return value.clip(low, high)
        return one(value) if isinstance(value, int | float) else [one(item) for item in value]

    return apply
