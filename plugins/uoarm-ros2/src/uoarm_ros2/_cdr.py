"""Between serialised messages and messages or native objects: generated functions.

ROS 2 sends XCDR version 1: four octets that say in which byte order, then the fields one after
another, each number at a multiple of its own size, counted from behind those four.

Reading makes the messages that `_conversion.reader` makes, of either byte order: adjacent numbers
are taken with one `struct`, pictures and the like are read-only views of what arrived. Writing
takes the native objects that `_conversion.writer` has checked, where no generated code of ROS 2
serialises them; the byte order is the machine's own.
"""

from __future__ import annotations

import struct
import sys
from array import array
from collections.abc import Callable
from functools import lru_cache, partial
from itertools import count
from typing import Any

import numpy as np

from uoarm.errors import MessageError
from uoarm.model import Message
from uoarm_ros2._conversion import FunctionBuilder
from uoarm_ros2._types import NUMBER_CODES, ArrayType, RecordType, ScalarType, Shape, StringType

__all__ = ["CODES", "HEADER", "Cursor", "cdr_reader", "cdr_writer", "size_of"]

HEADER = 4
CODES = {"bool": "?", "byte": "B", **NUMBER_CODES}
_SIZES = {"?": 1, "b": 1, "B": 1, "h": 2, "H": 2, "i": 4, "I": 4, "q": 8, "Q": 8, "f": 4, "d": 8}
_WIDEST = 8


def size_of(scalar: ScalarType) -> int:
    """Return how many octets a number has."""
    return _SIZES[CODES[scalar.name]]


class Cursor:
    """What is known of the place of the next field: it is `rest` more than a multiple of `modulus`.

    Behind the four octets everything is known, behind a text nothing.
    """

    def __init__(self, modulus: int = 1) -> None:
        self.modulus = modulus
        self.rest = 0

    def forget(self) -> None:
        """Something of unknown length lies behind."""
        self.modulus, self.rest = 1, 0

    def align(self, size: int) -> int | None:
        """Go to a multiple of `size`; return how many octets that takes, None: it depends."""
        if self.modulus % size:
            self.modulus, self.rest = size, 0
            return None
        padding = -self.rest % size
        self.advance(padding)
        return padding

    def advance(self, octets: int) -> None:
        """Go past so many octets."""
        self.rest = (self.rest + octets) % self.modulus

    @staticmethod
    def aligned(place: str, size: int) -> str:
        """Return the expression for the next multiple of `size`, of an offset in the whole."""
        if size == _WIDEST:  # the four octets before are half of it
            return f"({place} + 3 & -8) + 4"
        return f"{place} + {size - 1} & -{size}"


_ORDERS = {b"\0\0": ">", b"\0\1": "<"}
_RecordReader = Callable[[bytes, int], tuple[Message, int]]


def cdr_reader(record: RecordType) -> Callable[[bytes], Message]:
    """Return the function that makes a message of the serialised form of one.

    It raises MessageError when what it gets is cut short or not a message of this type.
    """
    functions = {code: _record_reader(record, order, whole=True) for code, order in _ORDERS.items()}

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
def _record_reader(record: RecordType, order: str, *, whole: bool) -> _RecordReader:
    """Return the function that reads a record from an offset on, and where it ends."""
    return _ReaderSource(order, Cursor(8 if whole else 1)).function(record)


class _ReaderSource:
    """One function under construction: `b` are the octets, `o` is the offset so far.

    Numbers are gathered up to the first value whose length only the message has.
    """

    def __init__(self, order: str, cursor: Cursor) -> None:
        self._order = order
        self._cursor = cursor
        self._source = FunctionBuilder("read", "b, o")
        self._fresh = count()
        self._format = ""
        self._names: list[str] = []

    def function(self, record: RecordType) -> _RecordReader:
        """Write and compile it."""
        value = self._record(record)
        self._flush()
        self._source.line(f"return {value}, o")
        made: Any = self._source.function()
        return made  # type: ignore[no-any-return]  # of two arguments, see above

    def _record(self, record: RecordType) -> str:
        if not record.fields:
            self._number("x", 1)  # C has no empty structures: one octet stands for it
            return "{}"
        members = [f"{field.name!r}: {self._value(field.shape)}" for field in record.fields]
        return "{" + ", ".join(members) + "}"

    def _value(self, shape: Shape) -> str:
        if isinstance(shape, RecordType):
            return self._record(shape)
        if isinstance(shape, ScalarType):
            return self._number(CODES[shape.name], size_of(shape))
        if isinstance(shape, StringType):
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

    def _text(self, text: StringType) -> str:
        length, value = self._length(), f"v{next(self._fresh)}"
        line = self._source.line
        if text.wide:
            wide = self._source.constant(partial(_read_wide_text, self._order))
            line(f"e = o + 4 * {length}")
            line(f"{value} = {wide}(b, o, e)")
        else:
            line(f"e = o + {length}")
            line(f"{value} = b[o:e - 1].decode('utf-8', 'replace') if {length} else ''")
        line("o = e")
        return value

    def _listing(self, listing: ArrayType) -> str:
        line, constant, element = self._source.line, self._source.constant, listing.element
        if listing.fixed:
            self._flush()
            length = str(listing.size)
        else:
            length = self._length()
            limit = "len(b)" if listing.size is None else f"min(len(b), {listing.size})"
            line(f"if {length} > {limit}: raise ValueError('too many elements: %d' % {length})")
        value = f"v{next(self._fresh)}"
        if not isinstance(element, ScalarType):
            read = constant(_element_reader(element, self._order))
            line(f"{value} = []")
            line(f"for _ in range({length}):")
            line(f"e, o = {read}(b, o)", depth=2)
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


def _element_reader(shape: Shape, order: str) -> _RecordReader:
    if isinstance(shape, RecordType):
        return _record_reader(shape, order, whole=False)
    assert isinstance(shape, StringType)
    return _text_reader(shape.wide, order)


@lru_cache(maxsize=8)
def _text_reader(wide: bool, order: str) -> _RecordReader:  # noqa: FBT001 - a key of the cache
    reading = _ReaderSource(order, Cursor())
    value = reading._text(StringType(wide=wide))  # noqa: SLF001 - its own module
    reading._source.line(f"return {value}, o")  # noqa: SLF001 - its own module
    made: Any = reading._source.function()  # noqa: SLF001 - its own module
    return made  # type: ignore[no-any-return]  # of two arguments


def _numbers(
    scalar: ScalarType, order: str, *, fixed: bool
) -> Callable[[bytes, int, int], Message]:
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


def _read_wide_text(order: str, octets: bytes, start: int, end: int) -> str:
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


_LITTLE = sys.byteorder == "little"
_ENCAPSULATION = b"\0\1\0\0" if _LITTLE else b"\0\0\0\0"
_LENGTH = struct.Struct("=I").pack
_Append = Callable[[Any, bytearray], None]


def cdr_writer(record: RecordType) -> Callable[[object], bytes]:
    """Return the function that serialises a native object of this type."""
    append = _appender(record, whole=True)

    def write(native: object) -> bytes:
        octets = bytearray(_ENCAPSULATION)
        append(native, octets)
        return bytes(octets)

    return write


@lru_cache(maxsize=1024)
def _appender(shape: RecordType | StringType, *, whole: bool) -> _Append:
    """Return the function that adds a value at the end of the octets that are there."""
    return _WriterSource(Cursor(8 if whole else 1)).function(shape)


class _WriterSource:
    """One function under construction: `n` is the native object, `b` the octets so far."""

    def __init__(self, cursor: Cursor) -> None:
        self._cursor = cursor
        self._source = FunctionBuilder("append", "n, b")
        self._format = ""
        self._values: list[str] = []

    def function(self, shape: RecordType | StringType) -> _Append:
        """Write and compile it."""
        self._value(shape, "n")
        self._flush()
        self._source.line("return None")
        made: Any = self._source.function()
        return made  # type: ignore[no-any-return]  # of two arguments, see above

    def _value(self, shape: Shape, place: str) -> None:
        if isinstance(shape, RecordType):
            for field in shape.fields:
                self._value(field.shape, f"{place}.{field.attribute}")
            if not shape.fields:
                self._number("x", 1, "")  # C has no empty structures: one octet stands for it
        elif isinstance(shape, ScalarType):
            value = f"{place}[0]" if shape.name == "byte" else place
            self._number(CODES[shape.name], size_of(shape), value)
        elif isinstance(shape, StringType):
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
        start = HEADER if size == _WIDEST else 0
        self._source.line(f"b += bytes({start} - len(b) & {size - 1})", depth)

    def _flush(self) -> None:
        if self._format:
            pack = self._source.constant(struct.Struct(f"={self._format}").pack)
            self._source.line(f"b += {pack}({', '.join(self._values)})")
            self._format, self._values = "", []

    def _text(self, text: StringType, place: str) -> None:
        self._flush()
        if self._cursor.align(4) != 0:
            self._align(4)
        write = self._source.constant(_append_wide_text if text.wide else _append_text)
        self._source.line(f"{write}({place}, b)")
        self._cursor.forget()

    def _listing(self, listing: ArrayType, place: str) -> None:
        element, line, constant = listing.element, self._source.line, self._source.constant
        if listing.fixed:
            self._flush()
        else:
            self._number("I", 4, f"len({place})")
            self._flush()
        if not isinstance(element, ScalarType):
            append = constant(_appender(element, whole=False))
            line(f"for e in {place}: {append}(e, b)")
            self._cursor.forget()
            return
        size = size_of(element)
        if size > 1 and self._cursor.align(size) != 0:
            line(f"if len({place}):")
            self._align(size, depth=2)
        line(f"b += {constant(_octets_of(element))}({place})")
        self._cursor.forget()


def _append_text(value: str, octets: bytearray) -> None:
    encoded = value.encode()
    octets += _LENGTH(len(encoded) + 1)
    octets += encoded
    octets.append(0)


def _append_wide_text(value: str, octets: bytearray) -> None:
    """Add a text as units of UTF-16, to each of which Fast CDR gives four octets."""
    units = np.frombuffer(value.encode("utf-16-le"), "<u2")
    octets += _LENGTH(len(units))
    octets += units.astype(np.uint32).tobytes()


def _octets_of(scalar: ScalarType) -> Callable[[Any], bytes]:
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
