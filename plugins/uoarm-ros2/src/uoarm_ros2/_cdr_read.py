"""From serialised messages to messages: one generated function per type and byte order.

What is next to one another and of known size is taken with one `struct`; pictures and the like are
read-only views of what arrived. The messages are those of `_read`, field by field.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Callable
from functools import lru_cache, partial
from itertools import count
from typing import Any

import numpy as np

from uoarm.errors import MessageError
from uoarm.model import Message
from uoarm_ros2._cdr_layout import CODES, HEADER, Cursor, size_of
from uoarm_ros2._generate import Source
from uoarm_ros2._shape import Listing, Record, Scalar, Shape, Text

__all__ = ["cdr_reader"]

_ORDERS = {b"\0\0": ">", b"\0\1": "<"}
_Part = Callable[[bytes, int], tuple[Message, int]]


def cdr_reader(record: Record) -> Callable[[bytes], Message]:
    """Return the function that makes a message of the serialised form of one.

    It raises MessageError when what it gets is cut short or not a message of this type.
    """
    functions = {code: _part(record, order, whole=True) for code, order in _ORDERS.items()}

    def read(octets: bytes) -> Message:
        try:
            message, end = functions[octets[:2]](octets, HEADER)
        except KeyError:
            text = f"{record.name}: serialised in an unknown way, {octets[:2]!r}"
            raise MessageError(text) from None
        except (struct.error, ValueError) as error:
            raise MessageError(f"{record.name}: cannot be read: {error}") from error
        if end > len(octets):
            raise MessageError(f"{record.name}: cut short, {end} octets and {len(octets)} came")
        return message

    return read


@lru_cache(maxsize=1024)
def _part(record: Record, order: str, *, whole: bool) -> _Part:
    """Return the function that reads a record from an offset on, and where it ends."""
    return _Reading(order, Cursor(8 if whole else 1)).function(record)


class _Reading:
    """One function under construction: `b` are the octets, `o` is the offset so far.

    Numbers are gathered until something comes whose length only the message tells.
    """

    def __init__(self, order: str, cursor: Cursor) -> None:
        self._order = order
        self._cursor = cursor
        self._source = Source("read", "b, o")
        self._fresh = count()
        self._format = ""
        self._names: list[str] = []

    def function(self, record: Record) -> _Part:
        """Write and compile it."""
        value = self._record(record)
        self._flush()
        self._source.line(f"return {value}, o")
        made: Any = self._source.function()
        return made  # type: ignore[no-any-return]  # of two arguments, see above

    def _record(self, record: Record) -> str:
        if not record.fields:
            self._number("x", 1)  # C has no empty structures: one octet stands for it
            return "{}"
        members = [f"{field.name!r}: {self._value(field.shape)}" for field in record.fields]
        return "{" + ", ".join(members) + "}"

    def _value(self, shape: Shape) -> str:
        if isinstance(shape, Record):
            return self._record(shape)
        if isinstance(shape, Scalar):
            return self._number(CODES[shape.name], size_of(shape))
        if isinstance(shape, Text):
            return self._text(shape)
        return self._listing(shape)

    def _number(self, code: str, size: int) -> str:
        padding = self._cursor.align(size)
        if padding is None:
            self._flush()
            self._source.line(f"o = {Cursor.aligned('o', size)}")
            padding = 0
        self._cursor.advance(size)
        self._format += "x" * padding + code
        if code == "x":
            return ""
        self._names.append(f"v{next(self._fresh)}")
        return self._names[-1]

    def _flush(self) -> None:
        """Write the line that takes all numbers that were gathered."""
        if not self._format:
            return
        numbers = struct.Struct(self._order + self._format)
        take = self._source.constant(numbers.unpack_from)
        target = f"{', '.join(self._names)}, = " if self._names else ""
        self._source.line(f"{target}{take}(b, o)")
        self._source.line(f"o += {numbers.size}")
        self._format, self._names = "", []

    def _length(self) -> str:
        """Write the line that takes how many there are of something."""
        name = self._number("I", 4)
        self._flush()
        self._cursor.forget()
        return name

    def _text(self, text: Text) -> str:
        length, value = self._length(), f"v{next(self._fresh)}"
        line = self._source.line
        if text.wide:
            wide = self._source.constant(partial(_wide_text, self._order))
            line(f"e = o + 4 * {length}")
            line(f"{value} = {wide}(b, o, e)")
        else:
            line(f"e = o + {length}")
            line(f"{value} = b[o:e - 1].decode('utf-8', 'replace') if {length} else ''")
        line("o = e")
        return value

    def _listing(self, listing: Listing) -> str:
        line, constant, element = self._source.line, self._source.constant, listing.element
        if listing.fixed:
            self._flush()
            length = str(listing.size)
        else:
            length = self._length()
            limit = "len(b)" if listing.size is None else f"min(len(b), {listing.size})"
            line(f"if {length} > {limit}: raise ValueError('too many elements: %d' % {length})")
        value = f"v{next(self._fresh)}"
        if not isinstance(element, Scalar):
            one = constant(_element(element, self._order))
            line(f"{value} = []")
            line(f"for _ in range({length}):")
            line(f"e, o = {one}(b, o)", depth=2)
            line(f"{value}.append(e)", depth=2)
            self._cursor.forget()
            return value
        size = size_of(element)
        if size > 1:
            padding = self._cursor.align(size)
            if padding is None:
                line(f"if {length}: o = {Cursor.aligned('o', size)}")
            elif padding:
                line(f"o += {padding}")
        line(f"e = o + {length} * {size}")
        numbers = constant(_numbers(element, self._order, fixed=listing.fixed))
        line(f"{value} = {numbers}(b, o, e)")
        line("o = e")
        if listing.fixed:
            self._cursor.advance(size * (listing.size or 0))
        else:
            self._cursor.forget()
        return value


def _element(shape: Shape, order: str) -> _Part:
    if isinstance(shape, Record):
        return _part(shape, order, whole=False)
    assert isinstance(shape, Text)
    return _text_part(shape.wide, order)


@lru_cache(maxsize=8)
def _text_part(wide: bool, order: str) -> _Part:  # noqa: FBT001 - a key of the cache
    reading = _Reading(order, Cursor())
    value = reading._text(Text(wide=wide))  # noqa: SLF001 - its own module
    reading._source.line(f"return {value}, o")  # noqa: SLF001 - its own module
    made: Any = reading._source.function()  # noqa: SLF001 - its own module
    return made  # type: ignore[no-any-return]  # of two arguments


def _numbers(scalar: Scalar, order: str, *, fixed: bool) -> Callable[[bytes, int, int], Message]:
    """Return what makes an array of numbers, of the kind that rclpy makes, of octets."""
    if scalar.name == "bool":
        return lambda octets, start, end: list(map(bool, octets[start:end]))
    if scalar.name == "byte":
        return lambda octets, start, end: octets[start:end]
    code = CODES[scalar.name]
    if scalar.name == "uint8":
        return lambda octets, start, end: memoryview(octets)[start:end]
    swapped = (order == "<") is not (array("H", b"\1\0")[0] == 1)
    if fixed:
        return partial(_fixed, np.dtype(scalar.name), swapped)
    return partial(_sequence, code, swapped)


def _wide_text(order: str, octets: bytes, start: int, end: int) -> str:
    """Return a text of units of UTF-16, each of which Fast CDR gives four octets."""
    units = np.frombuffer(octets, f"{order}u4", (end - start) // 4, start)
    return units.astype("<u2").tobytes().decode("utf-16-le", "replace")


def _fixed(dtype: np.dtype[Any], swapped: bool, octets: bytes, start: int, end: int) -> Message:  # noqa: FBT001 - bound beforehand
    if end > len(octets):
        raise ValueError("cut short")
    # Over octets of its own an array is made by one call of numpy; a copy of a view takes two.
    numbers: np.ndarray[Any, Any] = np.ndarray(
        (end - start) // dtype.itemsize, dtype, bytearray(octets[start:end])
    )
    return numbers.byteswap() if swapped else numbers


def _sequence(code: str, swapped: bool, octets: bytes, start: int, end: int) -> Message:  # noqa: FBT001 - bound beforehand
    if end > len(octets):
        raise ValueError("cut short")
    numbers = array(code, octets[start:end])
    if swapped:
        numbers.byteswap()
    return numbers
