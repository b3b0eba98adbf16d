"""Two native forms that have nothing in common, and codecs between them and messages.

`ROWS`, which producers of the `MemoryBridge` speak: a record is a tuple of its values in the
order of the field names, an integer its decimal digits.
`PAIRS`, which consumers speak: a record is a tuple of (name, value), last name first, an integer
its bytes in two's complement, big end first.

A codec is made from a structure once. It refuses what does not fit that structure, so that a
manager that confuses the structures of two ports is found out by the first message.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from attrs import frozen

from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Message, Schema

__all__ = ["PAIRS", "ROWS", "NativeCodec", "NativeDialect", "codec"]

_ABSENT = "<absent>"
_MAX_DEPTH = 64
_SCALARS: Mapping[str, tuple[type, ...]] = {
    "boolean": (bool,),
    "null": (type(None),),
    "number": (int, float),
    "string": (str,),
}


@frozen
class NativeCodec:
    """How the messages of one structure are written in a native form and read back."""

    write: Callable[[Message], Any]
    read: Callable[[Any], Message]


@frozen
class NativeDialect:
    """How one native form writes integers and records."""

    write_integer: Callable[[int], object]
    read_integer: Callable[[Any], int]
    write_record: Callable[[Mapping[str, object], Sequence[str]], tuple[object, ...]]
    read_record: Callable[[Any, Sequence[str]], dict[str, Any]]


def _to_bytes(number: int) -> bytes:
    return number.to_bytes((number.bit_length() + 8) // 8, "big", signed=True)


def _from_bytes(digits: bytes) -> int:
    return int.from_bytes(digits, "big", signed=True)


def _to_row(fields: Mapping[str, object], names: Sequence[str]) -> tuple[object, ...]:
    return tuple(fields.get(name, _ABSENT) for name in names)


def _from_row(row: Any, names: Sequence[str]) -> dict[str, Any]:
    if len(row) != len(names):
        raise ValueError(f"a row of {len(row)} values for {len(names)} fields")
    return {name: item for name, item in zip(names, row, strict=True) if item is not _ABSENT}


def _to_pairs(fields: Mapping[str, object], names: Sequence[str]) -> tuple[object, ...]:
    return tuple((name, fields[name]) for name in reversed(names) if name in fields)


def _from_pairs(pairs: Any, names: Sequence[str]) -> dict[str, Any]:
    found = {str(name): item for name, item in pairs}
    unknown = found.keys() - set(names)
    if unknown:
        raise ValueError(f"unknown fields {sorted(unknown)}")
    return found


ROWS = NativeDialect(str, int, _to_row, _from_row)
PAIRS = NativeDialect(_to_bytes, _from_bytes, _to_pairs, _from_pairs)


def codec(schema: Schema, dialect: NativeDialect) -> NativeCodec:
    """Return the codec of a structure; what its schema leaves open carries tags.

    Both directions raise BridgeError with BAD_MESSAGE when something does not fit.
    """
    inner = _codec(schema, dialect)

    def guarded(step: str, convert: Callable[[Any], Any]) -> Callable[[Any], Any]:
        def run(value: Any) -> Any:
            try:
                return convert(value)
            except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
                text = f"{step} failed: {error}"
                raise BridgeError(text, FailureReason.BAD_MESSAGE) from error

        return run

    return NativeCodec(guarded("writing a message", inner.write), guarded("reading", inner.read))


def _codec(schema: Any, dialect: NativeDialect) -> NativeCodec:
    kind = schema.get("type") if isinstance(schema, Mapping) else None
    if kind == "integer":
        return _integer(dialect)
    if isinstance(kind, str) and kind in _SCALARS:
        return _scalar(kind)
    if kind == "array" and schema.get("x-octets"):
        return NativeCodec(bytes, bytes)
    if kind == "array":
        return _array(schema, dialect)
    if kind == "object" and schema.get("additionalProperties") is False:
        return _record(schema, dialect)
    return _tagged(dialect)


def _integer(dialect: NativeDialect) -> NativeCodec:
    def write(value: Any) -> object:
        if isinstance(value, bool) or value != int(value):
            raise TypeError(f"{value!r} is no integer")
        return dialect.write_integer(int(value))

    return NativeCodec(write, dialect.read_integer)


def _scalar(kind: str) -> NativeCodec:
    types = _SCALARS[kind]

    def check(value: Any) -> Any:
        if not isinstance(value, types) or (isinstance(value, bool) and kind != "boolean"):
            raise TypeError(f"{value!r} is no {kind}")
        return value

    return NativeCodec(check, check)


def _array(schema: Mapping[str, Any], dialect: NativeDialect) -> NativeCodec:
    first = [_codec(prefix_item, dialect) for prefix_item in schema.get("prefixItems", ())]
    rest = _codec(schema.get("items", True), dialect)
    closed = schema.get("items") is False

    def each(items: Iterable[Any], convert: Callable[[NativeCodec, Any], Any]) -> list[Any]:
        if isinstance(items, (str, bytes, Mapping)):
            raise TypeError(f"{items!r:.40} is no array")
        found = [
            convert(first[index] if index < len(first) else rest, element)
            for index, element in enumerate(items)
        ]
        if len(found) < len(first) or (closed and len(found) > len(first)):
            raise ValueError(f"{len(found)} items instead of {len(first)}")
        return found

    return NativeCodec(
        lambda items: tuple(each(items, lambda one, item: one.write(item))),
        lambda items: each(items, lambda one, item: one.read(item)),
    )


def _record(schema: Mapping[str, Any], dialect: NativeDialect) -> NativeCodec:
    fields = {
        name: _codec(item, dialect) for name, item in sorted(schema.get("properties", {}).items())
    }
    names, required = tuple(fields), frozenset(schema.get("required", ()))

    def known(message: Mapping[str, Any]) -> Mapping[str, Any]:
        missing, unknown = required - message.keys(), message.keys() - fields.keys()
        if missing or unknown:
            raise ValueError(f"missing fields {sorted(missing)}, unknown {sorted(unknown)}")
        return message

    def write(message: Mapping[str, Any]) -> tuple[object, ...]:
        native = {name: fields[name].write(value) for name, value in known(message).items()}
        return dialect.write_record(native, names)

    def read(native: Any) -> dict[str, Any]:
        found = known(dialect.read_record(native, names))
        return {name: fields[name].read(value) for name, value in found.items()}

    return NativeCodec(write, read)


def _tagged(dialect: NativeDialect) -> NativeCodec:
    """Return the codec of values whose kind stands beside them, since no schema says it."""

    def write(value: Any, depth: int = 0) -> tuple[str, Any]:
        if depth > _MAX_DEPTH:
            raise ValueError(f"nested deeper than {_MAX_DEPTH}")
        if isinstance(value, Mapping):
            return "map", tuple((str(key), write(item, depth + 1)) for key, item in value.items())
        if isinstance(value, int) and not isinstance(value, bool):
            return "integer", dialect.write_integer(value)
        if isinstance(value, (bytes, bytearray, memoryview)):
            return "octets", bytes(value)
        if value is None or isinstance(value, (bool, float, str)):
            return "plain", value
        return "array", tuple(write(item, depth + 1) for item in value)

    def read(native: Any) -> Any:
        tag, value = native
        if tag == "map":
            return {key: read(item) for key, item in value}
        if tag == "array":
            return [read(item) for item in value]
        return dialect.read_integer(value) if tag == "integer" else value

    return NativeCodec(write, read)
