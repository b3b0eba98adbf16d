"""From native objects to their serialised form, where no generated code of ROS 2 does that.

The native objects are those that `_write` has checked. The byte order is the machine's own.
"""

from __future__ import annotations

import struct
import sys
from array import array
from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from uoarm_ros2._cdr_layout import CODES, HEADER, Cursor, size_of
from uoarm_ros2._generate import Source
from uoarm_ros2._shape import Listing, Record, Scalar, Shape, Text

__all__ = ["cdr_writer"]

_LITTLE = sys.byteorder == "little"
_HEADER = b"\0\1\0\0" if _LITTLE else b"\0\0\0\0"
_LENGTH = struct.Struct("=I").pack
_GREATEST = 8
_Append = Callable[[Any, bytearray], None]


def cdr_writer(record: Record) -> Callable[[object], bytes]:
    """Return the function that serialises a native object of this type."""
    append = _appender(record, whole=True)

    def write(native: object) -> bytes:
        octets = bytearray(_HEADER)
        append(native, octets)
        return bytes(octets)

    return write


@lru_cache(maxsize=1024)
def _appender(shape: Record | Text, *, whole: bool) -> _Append:
    """Return the function that adds a value at the end of the octets that are there."""
    return _Writing(Cursor(8 if whole else 1)).function(shape)


class _Writing:
    """One function under construction: `n` is the native object, `b` the octets so far."""

    def __init__(self, cursor: Cursor) -> None:
        self._cursor = cursor
        self._source = Source("append", "n, b")
        self._format = ""
        self._values: list[str] = []

    def function(self, shape: Record | Text) -> _Append:
        """Write and compile it."""
        self._value(shape, "n")
        self._flush()
        self._source.line("return None")
        made: Any = self._source.function()
        return made  # type: ignore[no-any-return]  # of two arguments, see above

    def _value(self, shape: Shape, place: str) -> None:
        if isinstance(shape, Record):
            for field in shape.fields:
                self._value(field.shape, f"{place}.{field.attribute}")
            if not shape.fields:
                self._number("x", 1, "")  # C has no empty structures: one octet stands for it
        elif isinstance(shape, Scalar):
            value = f"{place}[0]" if shape.name == "byte" else place
            self._number(CODES[shape.name], size_of(shape), value)
        elif isinstance(shape, Text):
            self._text(shape, place)
        else:
            self._listing(shape, place)

    def _number(self, code: str, size: int, value: str) -> None:
        padding = self._cursor.align(size)
        if padding is None:
            self._flush()
            self._align(size)
            padding = 0
        self._cursor.advance(size)
        self._format += "x" * padding + code
        if value:
            self._values.append(value)

    def _align(self, size: int, depth: int = 1) -> None:
        start = HEADER if size == _GREATEST else 0
        self._source.line(f"b += bytes({start} - len(b) & {size - 1})", depth)

    def _flush(self) -> None:
        if self._format:
            pack = self._source.constant(struct.Struct(f"={self._format}").pack)
            self._source.line(f"b += {pack}({', '.join(self._values)})")
            self._format, self._values = "", []

    def _text(self, text: Text, place: str) -> None:
        self._flush()
        if self._cursor.align(4) != 0:
            self._align(4)
        write = self._source.constant(_wide_text if text.wide else _text)
        self._source.line(f"{write}({place}, b)")
        self._cursor.forget()

    def _listing(self, listing: Listing, place: str) -> None:
        element, line, constant = listing.element, self._source.line, self._source.constant
        if listing.fixed:
            self._flush()
        else:
            self._number("I", 4, f"len({place})")
            self._flush()
        if not isinstance(element, Scalar):
            one = constant(_appender(element, whole=False))
            line(f"for e in {place}: {one}(e, b)")
            self._cursor.forget()
            return
        size = size_of(element)
        if size > 1 and self._cursor.align(size) != 0:
            line(f"if len({place}):")
            self._align(size, depth=2)
        line(f"b += {constant(_octets_of(element))}({place})")
        self._cursor.forget()


def _text(value: str, octets: bytearray) -> None:
    encoded = value.encode()
    octets += _LENGTH(len(encoded) + 1)
    octets += encoded
    octets.append(0)


def _wide_text(value: str, octets: bytearray) -> None:
    """Add a text as units of UTF-16, to each of which Fast CDR gives four octets."""
    units = np.frombuffer(value.encode("utf-16-le"), "<u2")
    octets += _LENGTH(len(units))
    octets += units.astype(np.uint32).tobytes()


def _octets_of(scalar: Scalar) -> Callable[[Any], bytes]:
    """Return what makes octets of a native array: a buffer, or a list of single values."""
    if scalar.name == "byte":
        return b"".join
    if scalar.name == "bool":
        return bytes
    dtype, code = np.dtype(scalar.name), CODES[scalar.name]

    def octets(value: Any) -> bytes:
        if isinstance(value, array) and value.typecode == code:
            return value.tobytes()
        if isinstance(value, bytes):
            return value
        return np.ascontiguousarray(value, dtype).tobytes()

    return octets
