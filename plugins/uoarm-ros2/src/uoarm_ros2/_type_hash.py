"""The hash of a type (RIHS01), by which ROS 2 tells definitions of one name apart.

It is the SHA-256 of the type's description as JSON, without defaults, as `rosidl` writes it from
Iron on. The numbers of types are those of `type_description_interfaces/msg/FieldType`.
"""

from __future__ import annotations

import hashlib
import json
from typing import Any

from uoarm_ros2._shape import Field, Listing, Record, Scalar, Shape, Text

__all__ = ["BOUNDED_TEXTS", "EMPTY", "KINDS", "NESTED", "SCALARS", "TEXTS", "type_hash"]

EMPTY = "structure_needs_at_least_one_member"
"""What stands in C for a message without fields: one octet."""
KINDS = 48
"""Numbers of types: one value, then arrays, bounded and unbounded sequences of each."""
NESTED = 1
TEXTS = {17: False, 18: True, 21: False, 22: True}
"""Whether it is wide."""
BOUNDED_TEXTS = (21, 22)
SCALARS = {
    2: "int8",
    3: "uint8",
    4: "int16",
    5: "uint16",
    6: "int32",
    7: "uint32",
    8: "int64",
    9: "uint64",
    10: "float32",
    11: "float64",
    13: "uint8",
    15: "bool",
    16: "byte",
}
_CHAR = 13  # an `.idl` may have it; `.msg` files call an octet so, which is number 3
_NUMBERS = {name: number for number, name in SCALARS.items() if number != _CHAR}
_TEXT_NUMBERS = {(wide, number in BOUNDED_TEXTS): number for number, wide in TEXTS.items()}
_ARRAY, _BOUNDED, _UNBOUNDED = 1, 2, 3


def type_hash(record: Record) -> str:
    """Return `RIHS01_` and 64 hexadecimal digits."""
    within: dict[str, Record] = {}
    _collect(record, within)
    description = {
        "type_description": _described(record),
        "referenced_type_descriptions": [_described(within[name]) for name in sorted(within)],
    }
    text = json.dumps(description)  # its spaces and the order of its keys are part of the hash
    return f"RIHS01_{hashlib.sha256(text.encode()).hexdigest()}"


def _collect(record: Record, within: dict[str, Record]) -> None:
    for field in record.fields:
        shape = field.shape.element if isinstance(field.shape, Listing) else field.shape
        if isinstance(shape, Record) and shape.name not in within:
            within[shape.name] = shape
            _collect(shape, within)


def _described(record: Record) -> dict[str, Any]:
    fields = record.fields or (Field(EMPTY, EMPTY, Scalar("uint8")),)
    return {
        "type_name": record.name,
        "fields": [{"name": field.name, "type": _kind(field.shape)} for field in fields],
    }


def _kind(shape: Shape) -> dict[str, Any]:
    element, many, capacity = shape, 0, 0
    if isinstance(shape, Listing):
        element, capacity = shape.element, shape.size or 0
        many = _ARRAY if shape.fixed else _UNBOUNDED if shape.size is None else _BOUNDED
    bound, nested = 0, ""
    if isinstance(element, Record):
        number, nested = NESTED, element.name
    elif isinstance(element, Text):
        number, bound = _TEXT_NUMBERS[element.wide, element.bound is not None], element.bound or 0
    else:
        assert isinstance(element, Scalar)
        number = _NUMBERS[element.name]
    return {
        "type_id": number + many * KINDS,
        "capacity": capacity,
        "string_capacity": bound,
        "nested_type_name": nested,
    }
