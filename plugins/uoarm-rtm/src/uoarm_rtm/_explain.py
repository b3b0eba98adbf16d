"""Where a message or a buffer does not fit: walked once more, slowly, to name the place."""

from __future__ import annotations

from collections.abc import Mapping
from struct import Struct
from typing import Any

from attrs import define

from uoarm.model import Message
from uoarm_rtm._arrays import blocks, counted, is_block
from uoarm_rtm._scalars import CODES, SIZES, Misfit, Order, checker, shown
from uoarm_rtm._schema import SWITCH
from uoarm_rtm._shape import (
    Choice,
    Enumeration,
    Field,
    Listing,
    Record,
    Scalar,
    Shape,
    Text,
    least_size,
)
from uoarm_rtm._texts import text_of, wchar_of, write_text, write_wchar

__all__ = ["Cursor", "fit", "read_slowly"]


def fit(shape: Shape, value: Message, encoding: str, path: str = "$") -> None:
    """Raise Misfit that begins with the path of the first field that does not fit."""
    try:
        if isinstance(shape, Record):
            fields = {field.name: field.shape for field in shape.fields}
            _members(value, fields)
        elif isinstance(shape, Choice):
            fields = _variant(shape, value, encoding)
        elif isinstance(shape, Listing) and not is_block(shape):
            counted(shape)(value)
            for index, item in enumerate(value):
                fit(shape.element, item, encoding, f"{path}[{index}]")
            return
        else:
            _leaf(shape, value, encoding)
            return
    except Misfit as error:
        text = str(error)
        if text.startswith("$"):
            raise
        glue = "" if text.startswith("[") else ": "
        raise Misfit(f"{path}{glue}{text}") from None
    for name, inner in fields.items():
        fit(inner, value[name], encoding, f"{path}.{name}")


def _members(value: Message, fields: Mapping[str, Shape]) -> None:
    if not isinstance(value, Mapping):
        raise Misfit(f"expected an object, got {shown(value)}")
    for name in fields:
        if name not in value:
            raise Misfit(f"field {name!r} is missing; the fields are {', '.join(fields)}")
    unknown = [name for name in value if name not in fields]
    if unknown:
        raise Misfit(f"there is no field {unknown[0]!r}; the fields are {', '.join(fields)}")


def _variant(choice: Choice, value: Message, encoding: str) -> dict[str, Shape]:
    if not isinstance(value, Mapping) or SWITCH not in value:
        raise Misfit(f"expected an object with {SWITCH!r}, got {shown(value)}")
    label = value[SWITCH]
    fit(choice.by, label, encoding, SWITCH)
    ordered = sorted(choice.variants, key=lambda variant: not variant.labels)
    chosen = next((item for item in ordered if not item.labels or label in item.labels), None)
    fields: dict[str, Shape] = {SWITCH: choice.by}
    if chosen is not None:
        fields[chosen.name] = chosen.shape
    _members(value, fields)
    return fields


def _leaf(shape: Shape, value: Message, encoding: str) -> None:
    if isinstance(shape, Listing):
        blocks(shape, "<")(value)
    elif isinstance(shape, Text):
        write_text(shape, "<", encoding)(value)
    elif isinstance(shape, Enumeration):
        if not isinstance(value, str) or value not in shape.labels:
            raise Misfit(f"expected one of {', '.join(shape.labels)}, got {shown(value)}")
    elif isinstance(shape, Scalar) and shape.name == "wchar":
        write_wchar(value)
    elif isinstance(shape, Scalar):
        checker(shape.name)(value)


@define
class Cursor:
    """A place in a buffer."""

    data: bytes
    order: Order
    encoding: str
    at: int = 0

    def take(self, size: int, path: str) -> bytes:
        """Return the next bytes."""
        left = len(self.data) - self.at
        if size > left:
            raise Misfit(f"{path}: expected {size} more bytes at {self.at}, {left} are left")
        self.at += size
        return self.data[self.at - size : self.at]

    def number(self, code: str, path: str) -> Any:
        """Return the next scalar."""
        self.at += -self.at % SIZES[code]
        return Struct(self.order + code).unpack(self.take(SIZES[code], path))[0]


def read_slowly(shape: Shape, cursor: Cursor, path: str = "$") -> Message:
    """Return the value at the cursor; raises Misfit that begins with a path."""
    if isinstance(shape, Record):
        return {
            field.name: read_slowly(field.shape, cursor, f"{path}.{field.name}")
            for field in shape.fields
        }
    if isinstance(shape, Listing):
        return _read_list(shape, cursor, path)
    if isinstance(shape, Choice):
        return _read_choice(shape, cursor, path)
    if isinstance(shape, Enumeration):
        number = cursor.number("I", path)
        if number >= len(shape.labels):
            raise Misfit(f"{path}: enumerator number {number} does not exist")
        return shape.labels[number]
    if isinstance(shape, Text):
        data = cursor.take(cursor.number("I", path), path)
        return _placed(path, lambda: text_of(data, shape, cursor.encoding))
    if shape.name == "wchar":
        return _placed(path, lambda: wchar_of(cursor.take(3, path)))
    number = cursor.number(CODES[shape.name], path)
    if shape.name == "boolean" and number > 1:
        raise Misfit(f"{path}: expected a boolean, 0 or 1, got {number}")
    if shape.name == "char":
        return chr(number)
    return number == 1 if shape.name == "boolean" else number


def _read_list(listing: Listing, cursor: Cursor, path: str) -> Message:
    size = listing.size
    number = size if listing.fixed else cursor.number("I", path)
    assert number is not None
    if size is not None and number > size:
        raise Misfit(f"{path}: expected at most {size} elements, got {number}")
    left = len(cursor.data) - cursor.at
    if number * least_size(listing.element) > left:
        raise Misfit(f"{path}: {number} elements do not fit into the {left} bytes that are left")
    return [read_slowly(listing.element, cursor, f"{path}[{index}]") for index in range(number)]


def _read_choice(choice: Choice, cursor: Cursor, path: str) -> Message:
    label = read_slowly(choice.by, cursor, f"{path}.{SWITCH}")
    ordered = sorted(choice.variants, key=lambda variant: not variant.labels)
    for item in ordered:
        if not item.labels or label in item.labels:
            member = Field(item.name, item.shape)
            inner = read_slowly(member.shape, cursor, f"{path}.{member.name}")
            return {SWITCH: label, item.name: inner}
    return {SWITCH: label}


def _placed(path: str, make: Any) -> Message:
    try:
        return make()
    except Misfit as error:
        raise Misfit(f"{path}: {error}") from None
