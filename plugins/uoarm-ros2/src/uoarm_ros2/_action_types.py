"""What an action is made of: as a call, and as streams."""

from __future__ import annotations

from typing import Any

from uoarm.bridge import Description
from uoarm.model import MessageStructure
from uoarm_ros2._schema import schema_of, structure_of
from uoarm_ros2._shape import Record, shape_of
from uoarm_ros2._types import import_type

__all__ = ["described", "part_structure", "records"]

_STATES = ["accepted", "rejected", "succeeded", "canceled", "aborted", "lost"]


def described(type_name: str) -> Description:
    """Return an action as a call: the goal as request, the result as reply."""
    goal, _, result = records(type_name)
    return Description(request=structure_of(goal), reply=structure_of(result))


def part_structure(type_name: str, part: str) -> MessageStructure:
    """Return the structure of one stream of an action."""
    goal, feedback, result = records(type_name)
    if part == "goal":
        return structure_of(goal)
    members: dict[str, object] = {"goal_id": {"type": "string"}}
    if part in {"status", "result"}:
        members["status"] = {"type": "string", "enum": _STATES}
    if part in {"feedback", "result"}:
        members[part] = schema_of(feedback if part == "feedback" else result)
    schema = {
        "type": "object",
        "properties": members,
        "required": list(members),
        "additionalProperties": False,
    }
    return MessageStructure(schema, native_type=f"{type_name}.{part}")


def records(type_name: str) -> tuple[Record, Record, Record]:
    """Return the shapes of the goal, the feedback and the result of an action type."""
    native: Any = import_type(type_name)
    return (
        shape_of(native.Goal, f"{type_name}_Goal"),
        shape_of(native.Feedback, f"{type_name}_Feedback"),
        shape_of(native.Result, f"{type_name}_Result"),
    )
