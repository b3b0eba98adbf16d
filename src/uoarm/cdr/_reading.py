"""From octets to messages: functions generated for each structure of a fixed layout.

ROS 2 sends CDR, version 1 of its plain encoding, of either byte order: four octets that say which,
then each number at a multiple of its own size, counted from behind those four. ROS 1 packs
everything, little-endian. What enters has a budget: no list is made of more elements than the
octets, and the budget, hold.
"""

from __future__ import annotations

import struct
import sys
from array import array
from collections.abc import Callable, Mapping
from functools import partial
from itertools import count
from typing import Any, TypeAlias

from uoarm.cdr._basic import BASIC, basic_type
from uoarm.errors import MessageError
from uoarm.model import Budget, Message, MessageStructure

__all__ = ["deserialiser"]

_HEADER = 4
_ORDERS = {b"\0\0": ">", b"\0\1": "<"}
_WIDEST = 8
_CHARACTER = 4  # octets of a character of a wide text, as Fast CDR writes it
_MOST_PADDING = 3
_MAX_DEPTH = 64
_PLAIN = Budget()
_Read: TypeAlias = Callable[[Any, int, list[int]], tuple[Any, int]]


def deserialiser(
    structure: MessageStructure, *, budget: Budget = _PLAIN, is_packed: bool = False
) -> Callable[[bytes | bytearray | memoryview], Message]:
    """Return the function that makes messages of octets, which it does not keep.

    It raises MessageError for what is cut short, too long, of another encoding or over the budget.

    Args:
        structure: of a fixed layout.
        budget: what one message may cost.
        is_packed: whether it is ROS 1 that serialised it.

    Raises:
        MessageError: the structure has no fixed layout; the text names the field.
    """
    orders = {b"": "<"} if is_packed else _ORDERS
    functions = {
        code: _LayoutReader(order, _WIDEST, is_packed=is_packed).function(structure.schema)
        for code, order in orders.items()
    }
    name = structure.native_type or "the message"
    header, padding = (0, 0) if is_packed else (_HEADER, _MOST_PADDING)

    def read(octets: bytes | bytearray | memoryview) -> Message:
        if len(octets) > budget.octets:
            raise MessageError(f"{name}: {len(octets):,} octets; {budget.octets:,} are allowed")
        part = functions.get(bytes(octets[: header // 2]))
        if part is None or len(octets) < header:
            raise MessageError(f"{name}: {bytes(octets[:header])!r} is no header of plain CDR")
        body = memoryview(octets)[header:]
        try:
            message, end = part(body, 0, [budget.elements])
        except (struct.error, ValueError) as error:
            raise MessageError(f"{name}: cannot be read: {error}") from error
        if not 0 <= len(body) - end <= padding:
            raise MessageError(f"{name}: {len(body):,} octets came, {end:,} were expected")
        return message

    return read


class _LayoutReader:
    """One function under construction: `b` is the body, `o` the offset, `k` what may still be made.

    Of the place of the next field is known that it is `rest` more than a multiple of `modulus`.
    Numbers are gathered up to the first value whose length only the message has. Nothing of a
    structure is in the text but names of fields, each as a literal.
    """

    def __init__(self, order: str, modulus: int, *, is_packed: bool) -> None:
        self._order, self._is_packed = order, is_packed
        self._modulus, self._rest = modulus, 0
        self._lines = ["def read(b, o, k):"]
        self._constants: dict[str, Any] = {}
        self._fresh = count()
        self._format = ""
        self._names: list[str] = []

    def function(self, schema: object, where: str = "the message", depth: int = 0) -> _Read:
        """Write and compile it."""
        value = self._value(schema, where, depth)
        self._flush()
        self._line(f"return {value}, o")
        exec("\n".join(self._lines), self._constants)  # noqa: S102 - our own text, see the class
        made: _Read = self._constants["read"]
        return made

    def _value(self, schema: object, where: str, depth: int) -> str:
        if not isinstance(schema, Mapping) or depth > _MAX_DEPTH:
            raise _no_layout(where, "anything may stand there")
        basic = basic_type(schema)
        if schema.get("type") == "array":
            return self._array(schema, where, depth)
        if basic in {"string", "wstring"}:
            return self._text(is_wide=basic == "wstring")
        if basic:
            return self._number(BASIC[basic])
        return self._record(schema, where, depth)

    def _record(self, schema: Mapping[str, Any], where: str, depth: int) -> str:
        if schema.get("type") != "object":
            raise _no_layout(where, "no single type is stated for it")
        fields: Mapping[str, object] = schema.get("properties", {})
        always = fields.keys() == set(schema.get("required", ()))
        if not always or schema.get("additionalProperties") is not False:
            raise _no_layout(where, "fields may be absent or added")
        if not fields and not self._is_packed:
            self._number("x")  # C has no empty structures: one octet stands for it
        members = (
            f"{name!r}: {self._value(field, f'{where}.{name}', depth + 1)}"
            for name, field in fields.items()
        )
        return "{" + ", ".join(members) + "}"

    def _number(self, code: str) -> str:
        size = struct.calcsize(f"={code}")
        padding = self._padding(size)
        self._rest = (self._rest + padding + size) % self._modulus
        self._format += "x" * padding + code
        if code == "x":
            return ""
        self._names.append(f"v{next(self._fresh)}")
        return self._names[-1]

    def _padding(self, size: int) -> int:
        """Return how many octets are left out before a number, as far as that is known."""
        if self._is_packed:
            return 0
        if self._modulus % size:
            self._flush()
            self._line(f"o = o + {size - 1} & -{size}")
            self._modulus, self._rest = size, 0
        return -self._rest % size

    def _flush(self) -> None:
        """Write the line that takes all numbers that were gathered."""
        if self._format:
            numbers = struct.Struct(self._order + self._format)
            target = f"{', '.join(self._names)}, = " if self._names else ""
            self._line(f"{target}{self._constant(numbers.unpack_from)}(b, o)")
            self._line(f"o += {numbers.size}")
            self._format, self._names = "", []

    def _length(self) -> str:
        name = self._number("I")
        self._flush()
        return name

    def _behind_unknown(self) -> None:
        self._modulus, self._rest = 1, 0

    def _text(self, *, is_wide: bool) -> str:
        length, value = self._length(), f"v{next(self._fresh)}"
        self._line(f"e = o + {length} * {_CHARACTER if is_wide else 1}")
        self._line("if e > len(b): raise ValueError('a text is cut short')")
        if is_wide:
            wide = self._constant(partial(_wide_text, self._order))
            self._line(f"{value} = {wide}(b[o:e])")
        else:
            # The last octet of CDR is a zero.
            end = "e" if self._is_packed else "max(o, e - 1)"
            self._line(f"{value} = str(b[o:{end}], 'utf-8', 'replace')")
        self._line("o = e")
        self._behind_unknown()
        return value

    def _array(self, schema: Mapping[str, Any], where: str, depth: int) -> str:
        items = schema.get("items")
        if (
            not isinstance(items, Mapping)
            or "prefixItems" in schema
            or items.get("type") == "array"
        ):
            raise _no_layout(where, "its elements have no single type that ROS has")
        least, most = schema.get("minItems"), schema.get("maxItems")
        fixed = least if isinstance(least, int) and least == most else None
        self._flush()
        length = str(fixed) if fixed is not None else self._length()
        value, code = f"v{next(self._fresh)}", BASIC.get(basic_type(items), "")
        if not code:
            self._line(f"k[0] -= {length}")
            self._line("if k[0] < 0: raise ValueError('it holds more elements than are allowed')")
            reader = _LayoutReader(self._order, 1, is_packed=self._is_packed)
            part = self._constant(reader.function(items, f"{where}[]", depth + 1))
            self._line(f"{value} = []")
            self._line(f"for _ in range({length}):")
            self._line(f"    e, o = {part}(b, o, k)")
            self._line(f"    {value}.append(e)")
            self._behind_unknown()
            return value
        size = struct.calcsize(f"={code}")
        if not self._is_packed and size > 1 and fixed != 0:
            # Without elements nothing is left out for them.
            self._line(f"if {length}: o = o + {size - 1} & -{size}")
        self._line(f"e = o + {length} * {size}")
        self._line("if e > len(b): raise ValueError('an array is cut short')")
        self._line(f"{value} = {self._constant(_block(code, self._order))}(b[o:e])")
        self._line("o = e")
        self._behind_unknown()
        return value

    def _line(self, text: str) -> None:
        self._lines.append(f"    {text}")

    def _constant(self, value: object) -> str:
        name = f"c{len(self._constants)}"
        self._constants[name] = value
        return name


def _block(code: str, order: str) -> Callable[[memoryview], Message]:
    """Return what makes an array of numbers of octets: a buffer, but of truth values a list."""
    if code == "?":
        return lambda octets: list(map(bool, octets))
    if code == "B":
        return bytes
    return partial(_numbers, code, (order == "<") is not (sys.byteorder == "little"))


def _numbers(code: str, swaps: bool, octets: memoryview) -> array[Any]:  # noqa: FBT001 - bound before
    numbers = array(code, bytes(octets))
    if swaps:
        numbers.byteswap()
    return numbers


def _wide_text(order: str, octets: memoryview) -> str:
    """Return a text of units of UTF-16, each of which Fast CDR gives four octets."""
    units = struct.unpack(f"{order}{len(octets) // _CHARACTER}I", octets)
    return array("H", [unit & 0xFFFF for unit in units]).tobytes().decode(_UTF16, "replace")


_UTF16 = "utf-16-le" if sys.byteorder == "little" else "utf-16-be"


def _no_layout(where: str, why: str) -> MessageError:
    return MessageError(f"{where} has no fixed layout ({why})")
