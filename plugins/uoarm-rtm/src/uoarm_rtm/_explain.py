"""Where a message or a buffer does not fit: walked once more, slowly, to name the field."""

from __future__ import annotations

from collections.abc import Mapping
from struct import Struct
from typing import Any

from attrs import define

from uoarm.model import Message
from uoarm_rtm._arrays import blocks, counted, is_block
from uoarm_rtm._scalars import CODES, SIZES, IdlMismatch, Order, checker, shown
from uoarm_rtm._schema import SWITCH
from uoarm_rtm._shape import (
    IdlEnum,
    IdlMember,
    IdlScalar,
    IdlSequence,
    IdlString,
    IdlStruct,
    IdlUnion,
    Shape,
    least_size,
)
from uoarm_rtm._texts import text_of, wchar_of, write_text, write_wchar

__all__ = ["ExplainCursor", "fit", "read_slowly"]


def fit(shape: Shape, value: Message, encoding: str, path: str = "$") -> None:
    """Raise Misfit that begins with the path of the first field that does not fit."""
    try:
        if isinstance(shape, IdlStruct):
            fields = {field.name: field.shape for field in shape.fields}
            _members(value, fields)
        elif isinstance(shape, IdlUnion):
            fields = _variant(shape, value, encoding)
        elif isinstance(shape, IdlSequence) and not is_block(shape):
            counted(shape)(value)
            for index, item in enumerate(value):
                fit(shape.element, item, encoding, f"{path}[{index}]")
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
    chosen = next((item for item in ordered if not item.labels or label in item.labels), None)
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
    """Return the value at the cursor; raises Misfit that begins with a path."""
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
        return _placed(path, lambda: text_of(data, shape, cursor.encoding))
    if shape.name == "wchar":
        return _placed(path, lambda: wchar_of(cursor.take(3, path)))
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
    for item in ordered:
        if not item.labels or label in item.labels:
            member = IdlMember(item.name, item.shape)
            inner = read_slowly(member.shape, cursor, f"{path}.{member.name}")
            return {SWITCH: label, item.name: inner}
    return {SWITCH: label}


def _placed(path: str, make: Any) -> Message:
    try:
        return make()
    except IdlMismatch as error:
        raise IdlMismatch(f"{path}: {error}") from None
