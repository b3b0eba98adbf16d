"""Message structures of native types: JSON Schema with exact ranges, units and native facts.

Units are those that REP-103 and the comments of the message definitions state.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from uoarm.bridge import Description
from uoarm.cdr import BASIC, number_schema, ros_unit
from uoarm.model import MessageStructure, closed_object
from uoarm_ros2._types import (
    ArrayType,
    RecordField,
    RecordType,
    ScalarType,
    Shape,
    StringType,
    import_type,
    shape_of,
)


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
def structure_of(record: RecordType) -> MessageStructure:
    """Return the structure of a record: a closed object with every field required."""
    return MessageStructure(schema_of(record), native_type=record.name)


def schema_of(shape: Shape, unit: str | None = None) -> dict[str, Any]:
    """Return the schema of a shape; `unit` holds for the numbers in it that state none."""
    if isinstance(shape, RecordType):
        return _object(shape, unit)
    if isinstance(shape, ArrayType):
        return _array(shape, unit)
    if isinstance(shape, StringType):
        return _string(shape)
    return number_schema(shape.name, BASIC[shape.name], unit)


def _object(record: RecordType, unit: str | None) -> dict[str, Any]:
    properties = {field.name: _member(record, field, unit) for field in record.fields}
    schema = closed_object(properties, x_native_type=record.name, x_type=record.name)
    if record.constants:
        schema["x-constants"] = dict(record.constants)
    return schema


def _member(record: RecordType, member: RecordField, unit: str | None) -> dict[str, Any]:
    # A vector that is a velocity counts metres a second, whatever its own type would say.
    schema = schema_of(member.shape, unit or ros_unit(record.name, member.name))
    if member.default is not None:
        schema["default"] = member.default
    return schema


def _array(listing: ArrayType, unit: str | None) -> dict[str, Any]:
    schema: dict[str, Any] = {"type": "array", "items": schema_of(listing.element, unit)}
    if listing.size is not None:
        schema["maxItems"] = listing.size
        if listing.fixed:
            schema["minItems"] = listing.size
    if listing.element in {ScalarType("uint8"), ScalarType("byte"), ScalarType("char")}:
        schema["x-octets"] = True
    return schema


def _string(text: StringType) -> dict[str, Any]:
    """A bound counts what the text is written in: octets, or units of UTF-16."""
    schema: dict[str, Any] = {"type": "string", "x-nul": False}
    if text.bound is not None:
        schema["maxLength"] = text.bound
        schema["x-max-utf16" if text.wide else "x-max-utf8"] = text.bound
    if text.wide:
        schema["x-native-type"] = "wstring"
    return schema


_STATES = ["accepted", "rejected", "succeeded", "canceled", "aborted", "lost"]


def describe_action(type_name: str) -> Description:
    """Return an action as a call: the goal as request, the result as reply."""
    goal, _, result = action_records(type_name)
    return Description(request=structure_of(goal), reply=structure_of(result))


def part_structure(type_name: str, part: str) -> MessageStructure:
    """Return the structure of one stream of an action."""
    goal, feedback, result = action_records(type_name)
    if part == "goal":
        return structure_of(goal)
    members: dict[str, object] = {"goal_id": {"type": "string"}}
    if part in {"status", "result"}:
        members["status"] = {"type": "string", "enum": _STATES}
    if part in {"feedback", "result"}:
        members[part] = schema_of(feedback if part == "feedback" else result)
    return MessageStructure(closed_object(members), native_type=f"{type_name}.{part}")


def action_records(type_name: str) -> tuple[RecordType, RecordType, RecordType]:
    """Return the shapes of the goal, the feedback and the result of an action type."""
    native: Any = import_type(type_name)
    return (
        shape_of(native.Goal, f"{type_name}_Goal"),
        shape_of(native.Feedback, f"{type_name}_Feedback"),
        shape_of(native.Result, f"{type_name}_Result"),
    )


def describe_service(type_name: str) -> Description:
    """Return the request and reply structures of a service type."""
    request, reply = service_records(import_type(type_name), type_name)
    return Description(request=structure_of(request), reply=structure_of(reply))


def service_records(native: type, name: str) -> tuple[RecordType, RecordType]:
    request: type = native.Request  # type: ignore[attr-defined]  # generated
    reply: type = native.Response  # type: ignore[attr-defined]  # generated
    return shape_of(request, f"{name}_Request"), shape_of(reply, f"{name}_Response")
