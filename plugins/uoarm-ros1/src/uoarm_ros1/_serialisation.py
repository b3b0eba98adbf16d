"""Messages of ROS 1 to octets and back: functions generated for each type, compiled once.

Everything is little-endian and packed: numbers as they are, texts and arrays after their length in
four octets, arrays of a fixed size without it. Arrays of numbers are read-only views of what came.
What enters has a budget: no array is made of more elements than its octets, and the budget, hold.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import lru_cache
from itertools import count
from typing import Any

import numpy as np

from uoarm.errors import MessageError
from uoarm.model import Budget, Message
from uoarm_ros1._definitions import NUMBERS, Listing, Record, Scalar, Shape, Text
from uoarm_ros1._values import Misfit, checker, octets_of, shown, text_octets

__all__ = ["LENGTH", "framed_writer", "reader", "writer"]

LENGTH = struct.Struct("<I")
_Read = Callable[[Any, int, list[int]], tuple[Any, int]]
_Append = Callable[[Any, bytearray], None]


def reader(record: Record, budget: Budget) -> Callable[[bytes | bytearray], Message]:
    """Return the function that makes a message of its octets.

    It raises MessageError when they are cut short, too long, too many, or hold too many elements.
    """
    part = _part(record)
    most, elements, name = budget.octets, budget.elements, record.name

    def read(octets: bytes | bytearray) -> Message:
        if len(octets) > most:
            raise MessageError(f"{name}: {len(octets):,} octets; {most:,} are allowed")
        try:
            message, end = part(octets, 0, [elements])
        except (struct.error, ValueError) as error:
            raise MessageError(f"{name}: cannot be read: {error}") from error
        if end != len(octets):
            text = f"{name}: {len(octets):,} octets came, {end:,} were expected"
            raise MessageError(text)
        return message

    return read


def writer(record: Record) -> Callable[[Message], bytearray]:
    """Return the function that serialises a message; it raises MessageError with a path."""
    return _written(record, b"")


def framed_writer(record: Record) -> Callable[[Message], bytearray]:
    """Return the function that serialises a message, with its length in front."""
    write = _written(record, bytes(LENGTH.size))

    def frame(message: Message) -> bytearray:
        octets = write(message)
        LENGTH.pack_into(octets, 0, len(octets) - LENGTH.size)
        return octets

    return frame


def _written(record: Record, start: bytes) -> Callable[[Message], bytearray]:
    append, name = _appender(record), record.name

    def write(message: Message) -> bytearray:
        octets = bytearray(start)
        try:
            append(message, octets)
        except (Misfit, KeyError, TypeError, ValueError, OverflowError, struct.error) as error:
            raise MessageError(f"{name}: {_reason(record, message) or error}") from error
        return octets

    return write


class _Source:
    """The text of one function under construction, and the constants that it refers to.

    Nothing of a message or of a definition enters the text but the names of fields, as literals.
    """

    def __init__(self, arguments: str) -> None:
        self._lines = [f"def made({arguments}):"]
        self._constants: dict[str, object] = {}
        self._fresh = count()

    def line(self, text: str, depth: int = 1) -> None:
        self._lines.append("    " * depth + text)

    def constant(self, value: object) -> str:
        name = f"c{len(self._constants)}"
        self._constants[name] = value
        return name

    def variable(self) -> str:
        return f"v{next(self._fresh)}"

    def function(self) -> Any:
        names: dict[str, Any] = dict(self._constants)
        exec("\n".join(self._lines), names)  # noqa: S102 - our own text, see the class
        return names["made"]


@lru_cache(maxsize=1024)
def _part(shape: Record | Text) -> _Read:
    """Return the function that reads a value from an offset on, and where it ends."""
    return _Reading().function(shape)


@lru_cache(maxsize=1024)
def least_size(shape: Shape) -> int:
    """Return how many octets a value has at the least."""
    if isinstance(shape, Scalar):
        return 1 if shape.name == "bool" else struct.calcsize(f"<{NUMBERS[shape.name]}")
    if isinstance(shape, Record):
        return sum(least_size(member.shape) for member in shape.fields)
    if isinstance(shape, Listing) and shape.size is not None:
        return shape.size * least_size(shape.element)
    return LENGTH.size


class _Reading:
    """One reader: `b` are the octets, `o` is the offset, `k` holds how many elements are left.

    Numbers are gathered until something comes whose length only the message says.
    """

    def __init__(self) -> None:
        self._source = _Source("b, o, k")
        self._format = ""
        self._names: list[str] = []

    def function(self, shape: Record | Text) -> _Read:
        value = self._value(shape)
        self._flush()
        self._source.line(f"return {value}, o")
        made: _Read = self._source.function()
        return made

    def _value(self, shape: Shape) -> str:
        if isinstance(shape, Record):
            members = [f"{member.name!r}: {self._value(member.shape)}" for member in shape.fields]
            return "{" + ", ".join(members) + "}"
        if isinstance(shape, Scalar):
            return self._number("?" if shape.name == "bool" else NUMBERS[shape.name])
        if isinstance(shape, Text):
            return self._text()
        return self._listing(shape)

    def _number(self, code: str) -> str:
        self._format += code
        self._names.append(self._source.variable())
        return self._names[-1]

    def _flush(self) -> None:
        """Write the line that takes all numbers that were gathered."""
        if self._format:
            numbers = struct.Struct(f"<{self._format}")
            take = self._source.constant(numbers.unpack_from)
            self._source.line(f"{', '.join(self._names)}, = {take}(b, o)")
            self._source.line(f"o += {numbers.size}")
            self._format, self._names = "", []

    def _length(self) -> str:
        name = self._number("I")
        self._flush()
        return name

    def _text(self) -> str:
        length, value = self._length(), self._source.variable()
        self._source.line(f"e = o + {length}")
        self._source.line("if e > len(b): raise ValueError('a text is cut short')")
        self._source.line(f"{value} = str(b[o:e], 'utf-8', 'replace')")
        self._source.line("o = e")
        return value

    def _listing(self, listing: Listing) -> str:
        line, constant, element = self._source.line, self._source.constant, listing.element
        self._flush()
        length = str(listing.size) if listing.size is not None else self._length()
        value, size = self._source.variable(), least_size(element)
        line(f"if o + {length} * {size} > len(b):")
        line(f"raise ValueError('an array of %d elements is cut short' % {length})", depth=2)
        if not isinstance(element, Scalar):
            line(f"k[0] -= {length}")
            line("if k[0] < 0: raise ValueError('it holds more elements than are allowed')")
            part = constant(_part(element))
            line(f"{value} = []")
            line(f"for _ in range({length}):")
            line(f"e, o = {part}(b, o, k)", depth=2)
            line(f"{value}.append(e)", depth=2)
            return value
        line(f"e = o + {length} * {size}")
        if element.name == "bool":
            line(f"k[0] -= {length}")
            line("if k[0] < 0: raise ValueError('it holds more elements than are allowed')")
            line(f"{value} = list(map(bool, b[o:e]))")
        elif NUMBERS[element.name] == "B":
            line(f"{value} = {constant(memoryview)}(b)[o:e].toreadonly()")
        else:
            numbers = constant(np.frombuffer)
            dtype = constant(np.dtype(f"<{NUMBERS[element.name]}"))
            line(f"{value} = {numbers}(b, {dtype}, {length}, o)")
            line(f"{value}.flags.writeable = False")
        line("o = e")
        return value


@lru_cache(maxsize=1024)
def _appender(shape: Record | Text) -> _Append:
    """Return the function that adds a value at the end of the octets that are there."""
    return _Writing().function(shape)


class _Writing:
    """One writer: `v` is the message, `b` the octets so far.

    It takes what has exactly the types of a field; the rest is left to the checks of `_values`.
    """

    def __init__(self) -> None:
        self._source = _Source("v, b")
        self._format = ""
        self._values: list[str] = []

    def function(self, shape: Record | Text) -> _Append:
        self._value(shape, "v")
        self._flush()
        self._source.line("return None")
        made: _Append = self._source.function()
        return made

    def _value(self, shape: Shape, place: str) -> None:
        if isinstance(shape, Record):
            self._record(shape, place)
        elif isinstance(shape, Scalar):
            self._scalar(shape, place)
        elif isinstance(shape, Text):
            self._text(place)
        else:
            self._listing(shape, place)

    def _record(self, record: Record, place: str) -> None:
        line = self._source.line
        line(f"if type({place}) is not dict or len({place}) != {len(record.fields)}:")
        line(f"{place} = {self._source.constant(_members)}({place}, {len(record.fields)})", depth=2)
        for member in record.fields:
            inner = self._source.variable()
            line(f"{inner} = {place}[{member.name!r}]")
            self._value(member.shape, inner)

    def _scalar(self, scalar: Scalar, value: str) -> None:
        line, check = self._source.line, self._source.constant(checker(scalar))
        if scalar.name == "bool":
            line(f"if {value} is not True and {value} is not False: {value} = {check}({value})")
            self._format += "?"
        else:
            code = NUMBERS[scalar.name]
            kind = "float" if code in "fd" else "int"
            line(f"if type({value}) is not {kind}: {value} = {check}({value})")
            self._format += code
        self._values.append(value)

    def _flush(self) -> None:
        if self._format:
            pack = self._source.constant(struct.Struct(f"<{self._format}").pack)
            self._source.line(f"b += {pack}({', '.join(self._values)})")
            self._format, self._values = "", []

    def _text(self, place: str) -> None:
        octets = self._source.variable()
        encode = self._source.constant(text_octets)
        self._source.line(f"{octets} = {encode}({place})")
        self._format += "I"
        self._values.append(f"len({octets})")
        self._flush()
        self._source.line(f"b += {octets}")

    def _listing(self, listing: Listing, place: str) -> None:
        element, line, constant = listing.element, self._source.line, self._source.constant
        if isinstance(element, Scalar):
            length, octets = self._source.variable(), self._source.variable()
            line(f"{length}, {octets} = {constant(octets_of(listing))}({place})")
            if listing.size is None:
                self._format += "I"
                self._values.append(length)
            self._flush()
            line(f"b += {octets}")
            return
        line(f"{place} = {constant(_elements)}({place}, {listing.size})")
        if listing.size is None:
            self._format += "I"
            self._values.append(f"len({place})")
        self._flush()
        append = constant(_appender(element))
        line(f"for e in {place}: {append}(e, b)")


def _members(value: Any, expected: int) -> Any:
    """Return an object of the right number of members, or raise Misfit."""
    if isinstance(value, str | bytes) or not hasattr(value, "keys"):
        raise Misfit(f"expected an object, got {shown(value)}")
    if len(value) != expected:
        raise Misfit(f"expected {expected} members, got {len(value)}")
    return value


def _elements(value: Any, size: int | None) -> Any:
    """Return an array of the right size, or raise Misfit."""
    if isinstance(value, str | bytes) or hasattr(value, "keys") or not hasattr(value, "__len__"):
        raise Misfit(f"expected an array, got {shown(value)}")
    if size is not None and len(value) != size:
        raise Misfit(f"expected {size} elements, got {len(value)}")
    return value


def _reason(shape: Shape, value: Any, path: str = "$") -> str:
    """Say what of a message does not fit and where; looked for only once something did not."""
    try:
        if isinstance(shape, Record):
            return _reason_of_record(shape, value, path)
        if isinstance(shape, Scalar):
            checker(shape)(value)
        elif isinstance(shape, Text):
            text_octets(value)
        elif isinstance(shape.element, Scalar):
            octets_of(shape)(value)
        else:
            for index, item in enumerate(_elements(value, shape.size)):
                if found := _reason(shape.element, item, f"{path}[{index}]"):
                    return found
    except Misfit as error:
        return f"{path}: {error}"
    return ""


def _reason_of_record(record: Record, value: Any, path: str) -> str:
    if isinstance(value, str | bytes) or not hasattr(value, "keys"):
        return f"{path}: expected an object, got {shown(value)}"
    names = [member.name for member in record.fields]
    if missing := [name for name in names if name not in value]:
        return f"{path}: the member {missing[0]!r} is missing"
    if unknown := [name for name in value if name not in names]:
        return f"{path}: there is no member {str(unknown[0])[:80]!r} in {record.name}"
    for member in record.fields:
        if found := _reason(member.shape, value[member.name], f"{path}.{member.name}"):
            return found
    return ""
