"""What lies where: the ways of serialising values, and the layout that a structure has in one.

A layout is a value of its own: two structures of the same layout share what is generated for it.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any, Literal, TypeAlias

from attrs import frozen

from uoarm.cdr._basic import BASIC, FLOAT32_MAX
from uoarm.errors import MessageError

__all__ = [
    "CORBA",
    "DDS",
    "NATIVE",
    "ROS_1",
    "SIZES",
    "SWITCH",
    "ArrayLayout",
    "BooleanLayout",
    "ByteOrder",
    "CharacterLayout",
    "Encoding",
    "EnumerationLayout",
    "Layout",
    "NumberLayout",
    "RecordLayout",
    "TextLayout",
    "UnionLayout",
    "UnionMember",
    "layout_of",
    "least_size",
]

ByteOrder: TypeAlias = Literal["<", ">"]
"""Little-endian or big-endian, as `struct` and numpy write it."""

NATIVE: ByteOrder = "<" if sys.byteorder == "little" else ">"
"""The machine's own."""

SIZES = {"B": 1, "b": 1, "h": 2, "H": 2, "i": 4, "I": 4, "q": 8, "Q": 8, "f": 4, "d": 8}
"""Octets of each code of `struct`, which are its alignment, too."""

SWITCH = "switch"
"""The member of a union's message that says which other member it has."""

_MAX_DEPTH = 64


@frozen
class Encoding:
    """A way of serialising.

    Attributes:
        name: in the texts of errors.
        is_aligned: each number lies at a multiple of its size, as in CDR; else all is packed.
        is_encapsulated: four octets stand in front and say in which byte order the rest is;
            alignment is counted from behind them.
        is_idl: there are characters, enumerations and unions, texts are of the stated character set
            and truth values 0 or 1, as CORBA has it. ROS has none of them, and reads any octets.
        charset: of narrow texts.
    """

    name: str
    is_aligned: bool = True
    is_encapsulated: bool = False
    is_idl: bool = False
    charset: str = "utf-8"

    @property
    def header_size(self) -> int:
        """How many octets stand before the first value."""
        return 4 if self.is_encapsulated else 0


DDS = Encoding("CDR of DDS", is_encapsulated=True)
"""CDR version 1 as Fast CDR and so ROS 2 writes it, in either byte order."""

CORBA = Encoding("CDR of CORBA", is_idl=True)
"""CDR version 1 as CORBA writes it: the body alone, in the byte order that its carrier states."""

ROS_1 = Encoding("serialisation of ROS 1", is_aligned=False)
"""Everything packed; its byte order is the little one."""


@frozen
class NumberLayout:
    """An integer or a float.

    Attributes:
        code: of `struct` and numpy.
        name: of the type, in the texts of errors.
    """

    code: str
    name: str

    @property
    def bounds(self) -> tuple[int, int] | None:
        """The least and greatest integer; None: it is a float."""
        return _BOUNDS.get(self.code)


@frozen
class BooleanLayout:
    """A truth value, in one octet."""


@frozen
class CharacterLayout:
    """A character of Latin-1, or a wide one of the basic plane."""

    is_wide: bool = False


@frozen
class TextLayout:
    """A text; `bound` counts octets of the character set, of a wide one units of UTF-16."""

    is_wide: bool = False
    bound: int | None = None


@frozen
class EnumerationLayout:
    """One of several labels, as its position."""

    labels: tuple[str, ...]


@frozen
class ArrayLayout:
    """Elements: exactly `size`, at most `size`, or any number when `size` is None."""

    element: Layout
    size: int | None = None
    is_fixed: bool = False


@frozen
class RecordLayout:
    """Named members, one after another."""

    members: tuple[tuple[str, Layout], ...]


@frozen
class UnionMember:
    """One member of a union; `labels` are the values of the switch, None for all others."""

    name: str
    labels: tuple[object, ...] | None
    layout: Layout


@frozen
class UnionLayout:
    """A switch, and the member that it selects; none where no member has its value."""

    by: Layout
    members: tuple[UnionMember, ...]


Layout: TypeAlias = (
    "NumberLayout | BooleanLayout | CharacterLayout | TextLayout | EnumerationLayout"
    " | ArrayLayout | RecordLayout | UnionLayout"
)

_BOUNDS = {
    "b": (-(2**7), 2**7 - 1), "B": (0, 2**8 - 1), "h": (-(2**15), 2**15 - 1), "H": (0, 2**16 - 1),
    "i": (-(2**31), 2**31 - 1), "I": (0, 2**32 - 1), "q": (-(2**63), 2**63 - 1),
    "Q": (0, 2**64 - 1),
}  # fmt: skip
_CODES = {bounds: code for code, bounds in _BOUNDS.items()}
# Where a structure does not state all bounds, the framework's own name of the type counts.
_NATIVE = {
    **BASIC, "octet": "B", "short": "h", "unsigned short": "H", "long": "i", "unsigned long": "I",
    "long long": "q", "unsigned long long": "Q",
}  # fmt: skip
_NAMES = {
    "b": "int8", "B": "uint8", "h": "int16", "H": "uint16", "i": "int32", "I": "uint32",
    "q": "int64", "Q": "uint64", "f": "float32", "d": "float64",
}  # fmt: skip


def layout_of(
    schema: object, encoding: Encoding, where: str = "the message", depth: int = 0
) -> Layout:
    """Return the layout of what a schema describes.

    Raises:
        MessageError: it has no fixed layout; the text names the member.
    """
    if not isinstance(schema, Mapping) or depth > _MAX_DEPTH:
        raise _loose(where, "anything may stand there")
    kind, native = schema.get("type"), str(schema.get("x-native-type", ""))
    if kind == "array":
        return _array(schema, encoding, where, depth)
    if kind == "string":
        return _text(schema, native, encoding, where)
    if kind == "boolean":
        return BooleanLayout()
    if kind in ("integer", "number"):
        return _number(schema, native)
    if kind == "object":
        return _record(schema, encoding, where, depth)
    if encoding.is_idl and "x-switch" in schema:
        return _union(schema, encoding, where, depth)
    raise _loose(where, "no single type is stated for it")


def _number(schema: Mapping[str, Any], native: str) -> NumberLayout:
    bounds: tuple[Any, Any] = schema.get("minimum"), schema.get("maximum")
    if schema["type"] == "integer":
        code = _CODES.get(bounds) or _NATIVE.get(native, "q")
    else:
        is_narrow = native in {"float32", "float"} or bounds == (-FLOAT32_MAX, FLOAT32_MAX)
        code = "f" if is_narrow and native != "float64" else "d"
    return NumberLayout(code, native or _NAMES[code])


def _text(
    schema: Mapping[str, Any], native: str, encoding: Encoding, where: str
) -> TextLayout | CharacterLayout | EnumerationLayout:
    is_wide = native == "wstring"
    if encoding.is_idl:
        if native in {"char", "wchar"}:
            return CharacterLayout(is_wide=native == "wchar")
        if "enum" in schema:
            return EnumerationLayout(tuple(schema["enum"]))
    elif is_wide and not encoding.is_aligned:
        raise _loose(where, f"the {encoding.name} has no wide texts")
    bound = schema.get("x-max-utf16" if is_wide else "x-max-utf8")
    if bound is None and encoding.is_idl:
        bound = schema.get("maxLength")
    return TextLayout(is_wide, bound)


def _array(schema: Mapping[str, Any], encoding: Encoding, where: str, depth: int) -> ArrayLayout:
    items = schema.get("items")
    if not isinstance(items, Mapping) or "prefixItems" in schema:
        raise _loose(where, "its elements have no single type")
    if items.get("type") == "array" and not encoding.is_idl:
        raise _loose(where, "ROS has no arrays whose elements are arrays")
    least, most = schema.get("minItems"), schema.get("maxItems")
    element = layout_of(items, encoding, f"{where}[]", depth + 1)
    return ArrayLayout(element, most, is_fixed=most is not None and least == most)


def _record(schema: Mapping[str, Any], encoding: Encoding, where: str, depth: int) -> RecordLayout:
    fields: Mapping[str, object] = schema.get("properties", {})
    is_whole = fields.keys() == set(schema.get("required", ()))
    if not is_whole or schema.get("additionalProperties") is not False:
        raise _loose(where, "fields may be absent or added")
    return RecordLayout(
        tuple(
            (name, layout_of(field, encoding, f"{where}.{name}", depth + 1))
            for name, field in fields.items()
        )
    )


def _union(schema: Mapping[str, Any], encoding: Encoding, where: str, depth: int) -> UnionLayout:
    members = []
    for variant in schema.get("oneOf", ()):
        properties: Mapping[str, Any] = variant.get("properties", {})
        labels = properties[SWITCH].get("enum") if "not" not in properties[SWITCH] else None
        members += [
            UnionMember(
                name,
                None if labels is None else tuple(labels),
                layout_of(field, encoding, f"{where}.{name}", depth + 1),
            )
            for name, field in properties.items()
            if name != SWITCH
        ]
    by = layout_of(schema["x-switch"], encoding, f"{where}.{SWITCH}", depth + 1)
    # What has all other values is looked at last.
    return UnionLayout(by, tuple(sorted(members, key=lambda member: member.labels is None)))


def _loose(where: str, why: str) -> MessageError:
    return MessageError(f"{where} has no fixed layout ({why})")


def least_size(layout: Layout) -> int:
    """Return the least number of octets that a value takes, padding aside."""
    if isinstance(layout, RecordLayout):
        return sum(least_size(member) for _, member in layout.members)
    if isinstance(layout, ArrayLayout):
        return least_size(layout.element) * (layout.size or 0) if layout.is_fixed else 4
    if isinstance(layout, UnionLayout):
        return least_size(layout.by)
    if isinstance(layout, CharacterLayout):
        return 3 if layout.is_wide else 1
    if isinstance(layout, NumberLayout):
        return SIZES[layout.code]
    return 1 if isinstance(layout, BooleanLayout) else 4
