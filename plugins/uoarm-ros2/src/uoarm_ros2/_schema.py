"""Message structures of native types: JSON Schema with exact ranges and the native facts."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from uoarm.model import MessageStructure
from uoarm_ros2._shape import Field, Listing, Record, Scalar, Shape, Text
from uoarm_ros2._units import unit_of

__all__ = ["FLOAT32_MAX", "integer_range", "schema_of", "structure_of"]

FLOAT32_MAX = 340282346638528859811704183484516925440


@lru_cache(maxsize=64)
def integer_range(name: str) -> tuple[int, int] | None:
    """Return the least and greatest value of an integer type, None for other scalars."""
    if name == "byte":
        return 0, 255
    signed = name.startswith("int")
    if not signed and not name.startswith("uint"):
        return None
    bits = int(name.removeprefix("u").removeprefix("int"))
    return (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if signed else (0, 2**bits - 1)


@lru_cache(maxsize=1024)
def structure_of(record: Record) -> MessageStructure:
    """Return the structure of a record: a closed object with every field required."""
    return MessageStructure(schema_of(record), native_type=record.name)


def schema_of(shape: Shape, unit: str | None = None) -> dict[str, Any]:
    """Return the schema of a shape; `unit` holds for the numbers in it that state none."""
    if isinstance(shape, Record):
        return _object(shape, unit)
    if isinstance(shape, Listing):
        return _array(shape, unit)
    if isinstance(shape, Text):
        return _string(shape)
    return _scalar(shape, unit)


def _object(record: Record, unit: str | None) -> dict[str, Any]:
    schema: dict[str, Any] = {
        "type": "object",
        "properties": {field.name: _member(record, field, unit) for field in record.fields},
        "required": [field.name for field in record.fields],
        "additionalProperties": False,
        "x-native-type": record.name,
        "x-type": record.name,
    }
    if record.constants:
        schema["x-constants"] = dict(record.constants)
    return schema


def _member(record: Record, member: Field, unit: str | None) -> dict[str, Any]:
    # A vector that is a velocity counts metres a second, whatever its own type would say.
    schema = schema_of(member.shape, unit or unit_of(record.name, member.name))
    if member.default is not None:
        schema["default"] = member.default
    return schema


def _array(listing: Listing, unit: str | None) -> dict[str, Any]:
    schema: dict[str, Any] = {"type": "array", "items": schema_of(listing.element, unit)}
    if listing.size is not None:
        schema["maxItems"] = listing.size
        if listing.fixed:
            schema["minItems"] = listing.size
    if listing.element in {Scalar("uint8"), Scalar("byte")}:
        schema["x-octets"] = True
    return schema


def _string(text: Text) -> dict[str, Any]:
    """A bound counts what the text is written in: octets, or units of UTF-16."""
    schema: dict[str, Any] = {"type": "string", "x-nul": False}
    if text.bound is not None:
        schema["maxLength"] = text.bound
        schema["x-max-utf16" if text.wide else "x-max-utf8"] = text.bound
    if text.wide:
        schema["x-native-type"] = "wstring"
    return schema


def _scalar(scalar: Scalar, unit: str | None) -> dict[str, Any]:
    if scalar.name == "bool":
        return {"type": "boolean"}
    schema: dict[str, Any] = {"type": "integer", "x-native-type": scalar.name}
    limits = integer_range(scalar.name)
    if limits is not None:
        schema["minimum"], schema["maximum"] = limits
    else:
        schema.update({"type": "number", "x-nonfinite": True})
        if scalar.name == "float32":
            schema["minimum"], schema["maximum"] = -FLOAT32_MAX, FLOAT32_MAX
    if unit is not None:
        schema["x-unit"] = unit
    return schema
