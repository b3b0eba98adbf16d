"""Conversion of ROS 2 messages beside `rosidl_runtime_py` and rosbridge, both ways, in one run.

Others are measured where they can be imported: neither comes from PyPI, so put their sources on
PYTHONPATH (`rosidl_runtime_py`, and `rosbridge_library/src` of rosbridge_suite).
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from bench.tables import at, microseconds, print_table

TYPES = {
    "String": "std_msgs/msg/String",
    "PoseStamped": "geometry_msgs/msg/PoseStamped",
    "LaserScan, 720 ranges": "sensor_msgs/msg/LaserScan",
    "Image 640x480 rgb8": "sensor_msgs/msg/Image",
    "PointCloud2, 100,000 points": "sensor_msgs/msg/PointCloud2",
    "OccupancyGrid 1000x1000": "nav_msgs/msg/OccupancyGrid",
}


def main() -> int:
    """Print the table; 0 also when there is no ROS 2 to measure."""
    try:
        from rclpy.serialization import deserialize_message, serialize_message  # noqa: PLC0415
        from uoarm_ros2._read import reader  # noqa: PLC0415
        from uoarm_ros2._shape import shape_of  # noqa: PLC0415
        from uoarm_ros2._types import import_type  # noqa: PLC0415
        from uoarm_ros2._write import writer  # noqa: PLC0415
    except ImportError as error:
        print(f"no conversion table: {error}", file=sys.stderr)
        return 0
    others = [other for other in (_rosidl(), _rosbridge()) if other is not None]
    rows = []
    for label, name in TYPES.items():
        shape = shape_of(import_type(name), name)
        wire = serialize_message(_filled(shape.native()))
        native: Any = deserialize_message(wire, shape.native)
        read, write = reader(shape), writer(shape)
        message = read(native)
        reads = [_median(partial(read, native), 200)]
        writes = [_median(partial(write, message), 200)]
        for other in others:
            reads.append(_median(partial(other.read, native), 1, 30))
            plain = other.read(native)
            writes.append(_median(partial(_set, other.write, shape.native, plain), 1, 30))
        floor = _median(partial(deserialize_message, wire, shape.native), 10, 50)
        rows.append([label, *reads, *writes, floor])
    names = ["ours", *(other.name for other in others)]
    head = ["message", *(f"read: {name}" for name in names), *(f"write: {name}" for name in names)]
    print_table("ROS 2 conversion (us, median)", [*head, "CDR floor"], rows)
    return 0


class Other(NamedTuple):
    """Another converter: a native object to plain values, and plain values into an object."""

    name: str
    read: Callable[[Any], Any]
    write: Callable[[Any, Any], Any]


def _set(write: Callable[[Any, Any], Any], kind: Any, plain: Any) -> None:
    write(kind(), plain)


def _rosidl() -> Other | None:
    try:
        from rosidl_runtime_py import (  # noqa: PLC0415
            message_to_ordereddict,
            set_message_fields,
        )
    except ImportError as error:
        print(f"without rosidl_runtime_py: {error}", file=sys.stderr)
        return None
    return Other("rosidl_runtime_py", message_to_ordereddict, set_message_fields)


def _rosbridge() -> Other | None:
    try:
        from rosbridge_library.internal import message_conversion as theirs  # noqa: PLC0415
    except ImportError as error:
        print(f"without rosbridge: {error}", file=sys.stderr)
        return None
    return Other(
        "rosbridge", theirs.extract_values, lambda made, msg: theirs.populate_instance(msg, made)
    )


def _filled(message: Any) -> Any:
    if hasattr(message, "ranges"):
        message.ranges = [1.5] * 720
        message.intensities = [0.5] * 720
    elif hasattr(message, "point_step"):
        message.data = bytes(100_000 * 16)
    elif hasattr(message, "encoding"):
        message.height, message.width, message.encoding = 480, 640, "rgb8"
        message.data = bytes(640 * 480 * 3)
    elif hasattr(message, "info"):
        message.data = [0] * 1_000_000
    return message


def _median(action: Any, batch: int, repeat: int = 100) -> str:
    return f"{at(microseconds(action, repeat=repeat, batch=batch), 0.5):,.2f}"


if __name__ == "__main__":
    sys.exit(main())
