"""Conversion of ROS 2 messages beside `rosidl_runtime_py`, both ways, in one run."""

from __future__ import annotations

import sys
from functools import partial
from typing import Any

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
    theirs = _theirs()
    rows = []
    for label, name in TYPES.items():
        shape = shape_of(import_type(name), name)
        wire = serialize_message(_filled(shape.native()))
        native: Any = deserialize_message(wire, shape.native)
        read, write = reader(shape), writer(shape)
        message = read(native)
        cells = [label, _median(lambda read=read, native=native: read(native), 200)]
        if theirs is not None:
            to_dict, set_fields = theirs
            cells.append(_median(lambda to_dict=to_dict, native=native: to_dict(native), 1, 30))
        cells.append(_median(lambda write=write, message=message: write(message), 200))
        if theirs is not None:
            plain = to_dict(native)
            cells.append(_median(partial(_set, set_fields, shape.native, plain), 1, 30))
        cells.append(
            _median(lambda wire=wire, kind=shape.native: deserialize_message(wire, kind), 10, 50)
        )
        rows.append(cells)
    head = ["message", "read"] + (["message_to_ordereddict"] if theirs else [])
    head += ["write, checked"] + (["set_message_fields"] if theirs else []) + ["CDR floor"]
    print_table("ROS 2 conversion (us, median)", head, rows)
    if theirs is None:
        print("\nrosidl_runtime_py is not here: a ROS 2 installation has it, PyPI does not")
    return 0


def _set(set_fields: Any, kind: Any, plain: Any) -> None:
    set_fields(kind(), plain)


def _theirs() -> tuple[Any, Any] | None:
    try:
        from rosidl_runtime_py import (  # noqa: PLC0415
            message_to_ordereddict,
            set_message_fields,
        )
    except ImportError:
        return None
    return message_to_ordereddict, set_message_fields


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
