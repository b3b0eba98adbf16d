"""Nominal types: their names, and which of them are alike though named otherwise."""

from __future__ import annotations

from collections.abc import Mapping

__all__ = ["BUILT_IN", "are_alike", "name_of_type"]

_PLAIN = ("Byte", "Char", "Float32", "Float64", "Int8", "Int16", "Int32", "Int64", "UInt8",
          "UInt16", "UInt32", "UInt64")  # fmt: skip
# Each with where it says so.
BUILT_IN: tuple[frozenset[str], ...] = (
    # Their definitions: examples without a meaning, "create your own semantically meaningful one".
    *(
        frozenset(f"{package}/msg/{name}" for package in ("std_msgs", "example_interfaces")
                  for name in names)
        for names in (_PLAIN, ("Bool",), ("String",), ("Empty",),
                      tuple(f"{name}MultiArray" for name in _PLAIN))
    ),
    # Point32.msg: "a point in free space (with 32 bits of precision)"; the foxglove schemas name
    # the ROS message that each stands for.
    frozenset({"geometry_msgs/msg/Point", "geometry_msgs/msg/Point32", "foxglove.Point3",
               "RTC::Point3D"}),
    frozenset({"geometry_msgs/msg/Vector3", "foxglove.Vector3", "RTC::Vector3D"}),
    frozenset({"geometry_msgs/msg/Quaternion", "foxglove.Quaternion", "RTC::Quaternion"}),
    frozenset({"geometry_msgs/msg/Pose", "foxglove.Pose"}),
    frozenset({"builtin_interfaces/msg/Time", "foxglove.Timestamp", "RTC::Time"}),
    frozenset({"builtin_interfaces/msg/Duration", "foxglove.Duration"}),
)  # fmt: skip


def name_of_type(told: object) -> str:
    """Return the name in what `x-type` says, nothing where it says none."""
    if isinstance(told, Mapping):
        told = told.get("name")
    return told if isinstance(told, str) else ""


def are_alike(one: str, other: str, declared: tuple[frozenset[str], ...]) -> bool:
    """Say whether two names of types stand for the same: equal, built in, or declared so."""
    return one == other or any(one in names and other in names for names in (*declared, *BUILT_IN))
