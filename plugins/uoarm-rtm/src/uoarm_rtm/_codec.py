"""One IDL type in both directions: messages to CDR and back, in either byte order.

Where a message or a buffer does not fit, it is walked once more, slowly, to name the field.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from struct import Struct
from typing import Any

from attrs import define

from uoarm.errors import MessageError
from uoarm.model import Message
from uoarm_rtm._codegen import reader, writer
from uoarm_rtm._shape import (
    SWITCH,
    IdlEnum,
    IdlScalar,
    IdlSequence,
    IdlString,
    IdlStruct,
    IdlUnion,
    Shape,
    least_size,
)
from uoarm_rtm._values import (
    CODES,
    SIZES,
    IdlMismatch,
    Order,
    blocks,
    checker,
    counted,
    is_block,
    shown,
    text_of,
    wchar_of,
    write_text,
    write_wchar,
)

__all__ = ["BIG", "LITTLE", "CdrCodec", "ExplainCursor", "codec_of", "fit", "read_slowly"]


def fit(shape: Shape, value: Message, encoding: str, path: str = "$") -> None:
    """Raise IdlMismatch that begins with the path of the first field that does not fit."""
    try:
        if isinstance(shape, IdlStruct):
            fields = {field.name: field.shape for field in shape.fields}
            _members(value, fields)
        elif isinstance(shape, IdlUnion):
            fields = _variant(shape, value, encoding)
        elif isinstance(shape, IdlSequence) and not is_block(shape):
            counted(shape)(value)
            for index, element in enumerate(value):
                fit(shape.element, element, encoding, f"{path}[{index}]")
            return
        else:
            _leaf(shape, value, encoding)
            return
    except IdlMismatch as error:
        text = str(error)
        if text.startswith("$"):
            raise
        glue = "" if text.startswith("[") else ": "
        raise IdlMismatch(f"{path}{glue}{text}") from None
    for name, inner in fields.items():
        fit(inner, value[name], encoding, f"{path}.{name}")


def _members(value: Message, fields: Mapping[str, Shape]) -> None:
    if not isinstance(value, Mapping):
        raise IdlMismatch(f"expected an object, got {shown(value)}")
    for name in fields:
        if name not in value:
            raise IdlMismatch(f"field {name!r} is missing; the fields are {', '.join(fields)}")
    unknown = [name for name in value if name not in fields]
    if unknown:
        raise IdlMismatch(f"there is no field {unknown[0]!r}; the fields are {', '.join(fields)}")


def _variant(choice: IdlUnion, value: Message, encoding: str) -> dict[str, Shape]:
    if not isinstance(value, Mapping) or SWITCH not in value:
        raise IdlMismatch(f"expected an object with {SWITCH!r}, got {shown(value)}")
    label = value[SWITCH]
    fit(choice.by, label, encoding, SWITCH)
    ordered = sorted(choice.variants, key=lambda variant: not variant.labels)
    chosen = next(
        (variant for variant in ordered if not variant.labels or label in variant.labels), None
    )
    fields: dict[str, Shape] = {SWITCH: choice.by}
    if chosen is not None:
        fields[chosen.name] = chosen.shape
    _members(value, fields)
    return fields


def _leaf(shape: Shape, value: Message, encoding: str) -> None:
    if isinstance(shape, IdlSequence):
        blocks(shape, "<")(value)
    elif isinstance(shape, IdlString):
        write_text(shape, "<", encoding)(value)
    elif isinstance(shape, IdlEnum):
        if not isinstance(value, str) or value not in shape.labels:
            raise IdlMismatch(f"expected one of {', '.join(shape.labels)}, got {shown(value)}")
    elif isinstance(shape, IdlScalar) and shape.name == "wchar":
        write_wchar(value)
    elif isinstance(shape, IdlScalar):
        checker(shape.name)(value)


@define
class ExplainCursor:
    """A position in a buffer."""

    data: bytes
    order: Order
    encoding: str
    at: int = 0

    def take(self, size: int, path: str) -> bytes:
        """Return the next bytes."""
        left = len(self.data) - self.at
        if size > left:
            raise IdlMismatch(f"{path}: expected {size} more bytes at {self.at}, {left} are left")
        self.at += size
        return self.data[self.at - size : self.at]

    def number(self, code: str, path: str) -> Any:
        """Return the next scalar."""
        self.at += -self.at % SIZES[code]
        return Struct(self.order + code).unpack(self.take(SIZES[code], path))[0]


def read_slowly(shape: Shape, cursor: ExplainCursor, path: str = "$") -> Message:
    """Return the value at the cursor; raises IdlMismatch that begins with a path."""
    if isinstance(shape, IdlStruct):
        return {
            field.name: read_slowly(field.shape, cursor, f"{path}.{field.name}")
            for field in shape.fields
        }
    if isinstance(shape, IdlSequence):
        return _read_list(shape, cursor, path)
    if isinstance(shape, IdlUnion):
        return _read_choice(shape, cursor, path)
    if isinstance(shape, IdlEnum):
        number = cursor.number("I", path)
        if number >= len(shape.labels):
            raise IdlMismatch(f"{path}: enumerator number {number} does not exist")
        return shape.labels[number]
    if isinstance(shape, IdlString):
        data = cursor.take(cursor.number("I", path), path)
        with _placed(path):
            return text_of(data, shape, cursor.encoding)
    if shape.name == "wchar":
        with _placed(path):
            return wchar_of(cursor.take(3, path))
    number = cursor.number(CODES[shape.name], path)
    if shape.name == "boolean" and number > 1:
        raise IdlMismatch(f"{path}: expected a boolean, 0 or 1, got {number}")
    if shape.name == "char":
        return chr(number)
    return number == 1 if shape.name == "boolean" else number


def _read_list(listing: IdlSequence, cursor: ExplainCursor, path: str) -> Message:
    size = listing.size
    number = size if listing.fixed else cursor.number("I", path)
    assert number is not None
    if size is not None and number > size:
        raise IdlMismatch(f"{path}: expected at most {size} elements, got {number}")
    left = len(cursor.data) - cursor.at
    if number * least_size(listing.element) > left:
        raise IdlMismatch(
            f"{path}: {number} elements do not fit into the {left} bytes that are left"
        )
    return [read_slowly(listing.element, cursor, f"{path}[{index}]") for index in range(number)]


def _read_choice(choice: IdlUnion, cursor: ExplainCursor, path: str) -> Message:
    label = read_slowly(choice.by, cursor, f"{path}.{SWITCH}")
    ordered = sorted(choice.variants, key=lambda variant: not variant.labels)
    for variant in ordered:
        if not variant.labels or label in variant.labels:
            inner = read_slowly(variant.shape, cursor, f"{path}.{variant.name}")
            return {SWITCH: label, variant.name: inner}
    return {SWITCH: label}


@contextmanager
def _placed(path: str) -> Iterator[None]:
    try:
        yield
    except IdlMismatch as error:
        raise IdlMismatch(f"{path}: {error}") from None


LITTLE: Order = "<"
BIG: Order = ">"

_UNFIT = (IdlMismatch, KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError)


class CdrCodec:
    """Marshals the messages of one type; made once a type, used from any thread.

    CDR here is what OpenRTM's data ports carry: the body alone, aligned from its first byte.

    Args:
        shape: the type.
        encoding: of narrow strings, `utf-8` or `latin-1`.
        name: what errors call the type.
    """

    def __init__(self, shape: Shape, encoding: str, name: str) -> None:
        self.shape = shape
        self._encoding = encoding
        self.name = name
        self._writers: dict[Order, Callable[[Message], bytes]] = {}
        self._readers: dict[Order, Callable[[bytes], Message]] = {}

    def encode(self, message: Message, order: Order = LITTLE) -> bytes:
        """Return the CDR of a message; padding is zero.

        Raises:
            MessageError: the message does not fit, with the path of the field.
        """
        write = self._writers.get(order)
        if write is None:
            write = self._writers[order] = writer(self.shape, order, self._encoding)
        try:
            return write(message)
        except (*_UNFIT, struct.error) as error:
            raise self._unfit(message, error) from None

    def decode(self, data: bytes, order: Order = LITTLE) -> Message:
        """Return the message in a buffer, which must end where the message does.

        Arrays of numbers are read-only views into `data` where its order is the machine's.

        Raises:
            MessageError: the buffer does not hold this type, with the path of the field.
        """
        read = self._readers.get(order)
        if read is None:
            read = self._readers[order] = reader(self.shape, order, self._encoding)
        try:
            return read(data)
        except (IdlMismatch, struct.error) as error:
            raise self._unreadable(data, order, error) from None

    def _unfit(self, message: Message, error: Exception) -> MessageError:
        try:
            fit(self.shape, message, self._encoding)
        except IdlMismatch as mismatch:
            return MessageError(f"message of type {self.name}: {mismatch}")
        return MessageError(f"message of type {self.name} does not fit: {error!r}")

    def _unreadable(self, data: bytes, order: Order, error: Exception) -> MessageError:
        kind = "little" if order == LITTLE else "big"
        what = f"{len(data)} bytes received as {self.name} ({kind}-endian) are something else"
        cursor = ExplainCursor(data, order, self._encoding)
        try:
            read_slowly(self.shape, cursor)
        except IdlMismatch as mismatch:
            return MessageError(f"{what}: {mismatch}")
        if cursor.at != len(data):
            return MessageError(f"{what}: the message ends after {cursor.at} bytes")
        return MessageError(f"{what}: {error}")


@lru_cache(maxsize=1024)
def codec_of(shape: Shape, encoding: str = "utf-8") -> CdrCodec:
    """Return the codec of a type, made once."""
    return CdrCodec(shape, encoding, getattr(shape, "name", type(shape).__name__))
