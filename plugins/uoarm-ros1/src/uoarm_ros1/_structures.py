"""Message structures of ROS 1 types, exact with types and units, and what serialises by them."""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import lru_cache
from typing import Any

from uoarm.bridge import Description
from uoarm.cdr import FLOAT32_MAX, ROS_1, Codec, ros_unit
from uoarm.model import Budget, Message, MessageStructure
from uoarm_ros1._definitions import NUMBERS, Field, Listing, Record, Scalar, Service, Shape, Text

__all__ = ["LENGTH", "described_service", "framed_writer", "reader", "structure_of"]

LENGTH = struct.Struct("<I")
"""What stands before every message on a connection."""


@lru_cache(maxsize=1024)
def structure_of(record: Record) -> MessageStructure:
    """Return the structure of a record: a closed object with every field required."""
    return MessageStructure(_schema_of(record, None), native_type=record.name)


def described_service(service: Service) -> Description:
    """Return the structures of a service."""
    return Description(request=structure_of(service.request), reply=structure_of(service.reply))


def reader(record: Record, budget: Budget) -> Callable[[bytes | bytearray], Message]:
    """Return the function that makes a message of its octets; it raises MessageError."""
    codec = Codec(structure_of(record), ROS_1, budget)
    return lambda octets: codec.decode(octets, "<")


def framed_writer(record: Record) -> Callable[[Message], bytes]:
    """Return the function that serialises a message, with its length in front.

    It raises MessageError with the path of the member that does not fit.
    """
    write = Codec(structure_of(record), ROS_1).encode_parts

    def frame(message: Message) -> bytes:
        parts = write(message, "<")
        return b"".join((LENGTH.pack(sum(map(len, parts))), *parts))

    return frame


def _schema_of(shape: Shape, unit: str | None) -> dict[str, Any]:
    """Return the schema of a shape; `unit` holds for the numbers in it that state none."""
    if isinstance(shape, Record):
        return _object(shape, unit)
    if isinstance(shape, Listing):
        return _array(shape, unit)
    if isinstance(shape, Text):
        return {"type": "string"}
    return _scalar(shape, unit)


def _object(record: Record, unit: str | None) -> dict[str, Any]:
    stated = {"name": record.name, "hash": record.md5} if record.md5 else record.name
    schema: dict[str, Any] = {
        "type": "object",
        "properties": {member.name: _member(record, member, unit) for member in record.fields},
        "required": [member.name for member in record.fields],
        "additionalProperties": False,
        "x-native-type": record.name,
        "x-type": stated,
    }
    if record.constants:
        schema["x-constants"] = dict(record.constants)
    return schema


def _member(record: Record, member: Field, unit: str | None) -> dict[str, Any]:
    # A vector that is a velocity counts metres a second, whatever its own type would say.
    return _schema_of(member.shape, unit or ros_unit(record.name, member.name))


def _array(listing: Listing, unit: str | None) -> dict[str, Any]:
    schema: dict[str, Any] = {"type": "array", "items": _schema_of(listing.element, unit)}
    if listing.size is not None:
        schema["minItems"] = schema["maxItems"] = listing.size
    if isinstance(listing.element, Scalar) and NUMBERS.get(listing.element.name) == "B":
        schema["x-octets"] = True
    return schema


def _scalar(scalar: Scalar, unit: str | None) -> dict[str, Any]:
    if scalar.name == "bool":
        return {"type": "boolean"}
    schema: dict[str, Any] = {"type": "integer", "x-native-type": scalar.name}
    code = NUMBERS[scalar.name]
    if code in "bBhHiIqQ":
        bits = 8 * struct.calcsize(f"<{code}")
        least = -(2 ** (bits - 1)) if code.islower() else 0
        schema["minimum"], schema["maximum"] = least, least + 2**bits - 1
    else:
        schema.update({"type": "number", "x-nonfinite": True})
        if scalar.name == "float32":
            schema["minimum"], schema["maximum"] = -FLOAT32_MAX, FLOAT32_MAX
    if unit is not None:
        schema["x-unit"] = unit
    return schema
