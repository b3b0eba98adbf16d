"""Messages as ROS 2 serialises them: CDR, version 1 of its plain encoding, in this machine's order.

The layout is read from a structure once, by the rules of `basic_type`, and compiled: what is next
to one another and of known size is packed with one `struct`. A long array of
numbers, as in an image, is not copied. Source: the Common Data Representation of CORBA 3.3,
part 2, section 9.3, and the encapsulation header of DDSI-RTPS 2.3, section 10; that a text counts
its closing zero, that a wide character takes four octets and that a type without fields has one
octet of zero is what Fast CDR and rosidl do.
"""

from __future__ import annotations

import struct
import sys
from array import array
from collections.abc import Callable, Mapping
from itertools import count
from typing import Any, TypeAlias

from uoarm.cdr._basic import BASIC, basic_type
from uoarm.errors import MessageError
from uoarm.model import Message, MessageStructure

__all__ = ["serialiser"]

Part: TypeAlias = "bytes | bytearray | memoryview"
Put: TypeAlias = "Callable[[_Out, Any], None]"
_HEADER = b"\0\1\0\0" if sys.byteorder == "little" else b"\0\0\0\0"
_MAX_DEPTH = 64
_GREATEST = 8
_LONG = 65_536  # octets from which on an array is a part of its own
_UNFIT = (struct.error, ArithmeticError, AttributeError, LookupError, TypeError, ValueError)
_count = struct.Struct("=I").pack


class _Out(bytearray):
    """What is serialised of a message, behind the parts that are complete.

    A long array is a part as it is. To append it here would copy it into memory that grows, and
    which the system gives and takes back for each message: ten times what one join of all costs.

    Attributes:
        parts: what stands before, in order.
        before: how many octets they have.
    """

    __slots__ = ("before", "parts")

    def __init__(self, octets: bytes) -> None:
        super().__init__(octets)
        self.parts: list[Part] = []
        self.before = 0

    def add_part(self, octets: memoryview | bytes) -> None:
        """Append a long array as it is; nobody changes it before the parts are joined."""
        self.parts += (bytes(self), octets)
        self.before += len(self) + memoryview(octets).nbytes
        self.clear()


def serialiser(structure: MessageStructure) -> Callable[[Message], list[Part]]:
    """Return the function that serialises messages of a structure, encapsulation header first.

    What it returns is to be joined at once: parts may be the message's own memory. It raises
    MessageError for a message that does not fit.

    Raises:
        MessageError: the structure has no fixed layout; the text names the field.
    """
    writing = _Writing(_GREATEST)
    writing.record(structure.schema, "v", "the message", 0)
    put = writing.function()

    def serialise(message: Message) -> list[Part]:
        out = _Out(_HEADER)
        try:
            put(out, message)
        except _UNFIT as error:
            raise MessageError(f"the message does not fit its structure: {error}") from error
        return [*out.parts, out]

    return serialise


class _Writing:
    """One function under construction: `v` is the value, `out` are the octets so far.

    Of the place of the next field is known that it is `rest` more than a multiple of `modulus`.
    """

    def __init__(self, modulus: int) -> None:
        self._modulus = modulus
        self._rest = 0
        self._lines = ["def put(out, v):"]
        self._constants: dict[str, Any] = {}
        self._fresh = count()
        self._format = ""
        self._values: list[str] = []

    def function(self) -> Put:
        """Compile it, with what was written before."""
        self._flush()
        # Nothing of a structure is in the text but names of fields, each as a literal.
        exec("\n ".join(self._lines), self._constants)  # noqa: S102 - our own text, see above
        put: Put = self._constants["put"]
        return put

    def value(self, schema: object, place: str, where: str, depth: int) -> None:
        """Write what puts a value of any kind; `place` is the expression for it."""
        if not isinstance(schema, Mapping) or depth > _MAX_DEPTH:
            raise _loose(where, "anything may stand there")
        basic = basic_type(schema)
        if schema.get("type") == "array":
            self._array(schema, place, where, depth)
        elif basic == "string":
            self._call(_put_text, place)
        elif basic == "wstring":
            self._call(_put_wide_text, place)
        elif basic:
            self._number(BASIC[basic], place)
        else:
            self.record(schema, place, where, depth)

    def record(self, schema: object, place: str, where: str, depth: int) -> None:
        """Write what puts a record, whose fields are written out in place."""
        if not isinstance(schema, Mapping) or schema.get("type") != "object":
            raise _loose(where, "no single type is stated for it")
        fields: Mapping[str, object] = schema.get("properties", {})
        always = fields.keys() == set(schema.get("required", ()))
        if not always or schema.get("additionalProperties") is not False:
            raise _loose(where, "fields may be absent or added")
        holder = f"r{next(self._fresh)}"
        self._lines.append(f"{holder} = {place}")
        for name, field in fields.items():
            self.value(field, f"{holder}[{name!r}]", f"{where}.{name}", depth + 1)
        if not fields:
            self._number("B", "0")

    def _array(self, schema: Mapping[str, Any], place: str, where: str, depth: int) -> None:
        put, aligned = _listing(schema, where, depth)
        self._call(put, place)
        self._modulus = aligned

    def _number(self, code: str, place: str) -> None:
        """Gather a number, to be packed with those around it."""
        size = struct.calcsize(f"={code}")
        if self._modulus % size:
            self._flush()
            self._lines.append(f"{self._constant(_align)}(out, {size})")
            self._modulus, self._rest = size, 0
        padding = -self._rest % size
        self._rest = (self._rest + padding + size) % self._modulus
        self._format += "x" * padding + code
        self._values.append(place)

    def _call(self, put: Put, place: str) -> None:
        """Have something put whose length only the message tells."""
        self._flush()
        self._lines.append(f"{self._constant(put)}(out, {place})")
        self._modulus, self._rest = 1, 0

    def _flush(self) -> None:
        """Write the line that packs all numbers that were gathered."""
        if self._format:
            pack = self._constant(struct.Struct(f"={self._format}").pack)
            self._lines.append(f"out += {pack}({', '.join(self._values)})")
            self._format, self._values = "", []

    def _constant(self, value: object) -> str:
        name = f"c{len(self._constants)}"
        self._constants[name] = value
        return name


def _listing(schema: Mapping[str, Any], where: str, depth: int) -> tuple[Put, int]:
    """Return what puts an array, and of what number the place behind it is always a multiple."""
    items = schema.get("items")
    if not isinstance(items, Mapping) or "prefixItems" in schema or items.get("type") == "array":
        raise _loose(where, "its elements have no single type that ROS has")
    least, most = schema.get("minItems"), schema.get("maxItems")
    fixed = least if isinstance(least, int) and least == most else None
    basic = basic_type(items)
    if BASIC.get(basic):
        elements = _block(BASIC[basic])
    else:
        writing = _Writing(1)
        writing.value(items, "v", f"{where}[]", depth + 1)
        elements = _each(writing.function())

    def put(out: _Out, value: Any) -> None:
        if fixed is None:
            _align(out, 4)
            out += _count(len(value))
        elif len(value) != fixed:
            raise ValueError(f"{where} has {len(value)} elements, expected {fixed}")
        if len(value):
            elements(out, value)

    return put, struct.calcsize(f"={BASIC[basic]}") if fixed and BASIC.get(basic) else 1


def _each(put: Put) -> Put:
    def put_all(out: _Out, values: Any) -> None:
        for value in values:
            put(out, value)

    return put_all


def _block(code: str) -> Put:
    """Return what puts an array of numbers: a buffer of theirs as it is, others one by one."""
    size = struct.calcsize(f"={code}")

    def put(out: _Out, values: Any) -> None:
        _align(out, size)
        octets = _octets(values, code, size)
        if octets is None:
            listed = values.tolist() if hasattr(values, "tolist") else list(values)
            octets = struct.pack(f"={len(listed)}{code}", *listed)
        if memoryview(octets).nbytes >= _LONG:
            out.add_part(octets)
        else:
            out += octets

    return put


def _octets(values: Any, code: str, size: int) -> memoryview | bytes | None:
    """Return what a buffer of the very type consists of, None for anything else."""
    try:
        buffer = memoryview(values)
    except TypeError:
        return None
    same = buffer.itemsize == size and _kind(buffer.format) == _kind(code)
    if not same or buffer.ndim != 1:
        return None
    return buffer if buffer.c_contiguous else buffer.tobytes()


def _kind(code: str) -> str:
    """Return whether a format is of signed or unsigned integers, of floats, or another one."""
    return next((kinds for kinds in ("bhilqn", "BHILQN", "fd") if code in kinds), code)


def _put_text(out: _Out, value: Any) -> None:
    octets = value.encode()
    _align(out, 4)
    out += _count(len(octets) + 1)
    out += octets
    out.append(0)


def _put_wide_text(out: _Out, value: Any) -> None:
    units = array("H", value.encode("utf-16-le" if sys.byteorder == "little" else "utf-16-be"))
    _align(out, 4)
    out += _count(len(units))
    out += array("I", units).tobytes()


def _align(out: _Out, size: int) -> None:
    """Fill up to a multiple of a size, counted from after the header."""
    gap = (len(_HEADER) - out.before - len(out)) % size
    if gap:
        out += bytes(gap)


def _loose(where: str, why: str) -> MessageError:
    return MessageError(f"{where} has no fixed layout ({why})")
