"""What clients send: by name or, as rosbridge allows, as a list in order, and not always whole."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from uoarm.errors import MessageError, UsageError
from uoarm.model import Message, MessageStructure
from uoarm.server.front_end import TEXT_FORM, Read, read_message
from uoarm_rosbridge._typedefs import check_type, service_type

__all__ = ["read_arguments", "reader_of"]

_MOST_ADDED = 100_000
_TIME = {"secs": "sec", "nsecs": "nanosec"}
# Fields of ROS 1 by their types and the names that ROS 2 has for them; None: it has none.
_OF_ROS_1: Mapping[str, Mapping[str, str | None]] = {
    "builtin_interfaces/msg/Time": _TIME,
    "builtin_interfaces/msg/Duration": _TIME,
    "std_msgs/msg/Header": {"seq": None},
}
_ZEROS: Mapping[object, Message] = {"boolean": False, "integer": 0, "number": 0.0, "string": ""}


def read_arguments(structure: MessageStructure, arguments: Message) -> Message:
    """Return the logical value of a message, a request or a goal.

    A list stands for the fields in their order. A field of a ROS type that is missing has the value
    that ROS gives it, as with rosbridge; what other frameworks require stays required.

    Raises:
        UsageError: the list has more values than there are fields.
        MessageError: a text is not what its place may carry, or too much is left out.
    """
    named = _named(structure.schema, arguments)
    return read_message(TEXT_FORM, structure, _Filling().filled(structure.schema, named))


def reader_of(what: str, stated: str) -> Read:
    """Return what reads a request after the type that the client states for it was compared.

    Args:
        what: the service or the action, for the error.
        stated: its type, empty: none.
    """

    def read(structure: MessageStructure, arguments: Message) -> Message:
        check_type(what, stated, service_type(structure, ""))
        return read_arguments(structure, arguments)

    return read if stated else read_arguments


def _named(schema: Any, arguments: Message) -> Message:
    if arguments is None:
        return {}
    if isinstance(arguments, list) and isinstance(schema, Mapping):
        names = schema.get("properties")
        if isinstance(names, Mapping):
            if len(arguments) > len(names):
                raise UsageError(f"expected at most {len(names)} arguments, got {len(arguments)}")
            return dict(zip(names, arguments, strict=False))
    return arguments


class _Filling:
    """One message whose missing fields are added, of which there may be so many."""

    def __init__(self) -> None:
        self._left = _MOST_ADDED

    def filled(self, schema: Any, value: Message) -> Message:
        """Return a value with the fields that are missing in its objects of ROS types."""
        if not isinstance(schema, Mapping):
            return value
        if isinstance(value, dict) and _is_ros_record(schema):
            value = _spelt_as_ros_2(schema, value)
            known = {
                name: self.filled(member, value[name]) if name in value else self._initial(member)
                for name, member in schema["properties"].items()
            }
            return {**known, **{name: item for name, item in value.items() if name not in known}}
        items = schema.get("items")
        if isinstance(value, list) and isinstance(items, Mapping) and _is_ros_record(items):
            return [self.filled(items, item) for item in value]
        return value

    def _initial(self, schema: Any) -> Message:
        """Return the value with which ROS begins a field."""
        self._left -= 1
        if self._left < 0:
            text = f"more than {_MOST_ADDED:,} values are left out; write them"
            raise MessageError(text)
        if not isinstance(schema, Mapping):
            return None
        if "default" in schema:
            return schema["default"]
        if schema.get("type") == "object":
            members = schema.get("properties", {}).items()
            return {name: self._initial(member) for name, member in members}
        if schema.get("type") == "array":
            return [self._initial(schema["items"]) for _ in range(schema.get("minItems", 0))]
        return _ZEROS.get(schema.get("type"))


def _is_ros_record(schema: Mapping[str, Any]) -> bool:
    return schema.get("type") == "object" and "x-native-type" in schema


def _spelt_as_ros_2(schema: Mapping[str, Any], value: Mapping[str, Message]) -> dict[str, Message]:
    """Return a record with the names of ROS 2, without the `seq` of a header, which it has not."""
    names = _OF_ROS_1.get(schema["x-native-type"], {})
    return {
        known: item for name, item in value.items() if (known := names.get(name, name)) is not None
    }
