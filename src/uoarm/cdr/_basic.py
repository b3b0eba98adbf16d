"""The basic types of ROS, which of them a schema of a scalar stands for, and units of members."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from typing import Any

__all__ = ["BASIC", "FLOAT32_MAX", "basic_type", "number_schema", "ros_unit"]

BASIC = {
    "bool": "?", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H",
    "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
    "string": "", "wstring": "",
}  # fmt: skip
"""Every basic type and its format in `struct`; empty for texts."""

_WHOLE = frozenset("bBhHiIqQ")
_INTEGERS = (
    ("uint8", 0, 2**8 - 1), ("int8", -(2**7), 2**7 - 1), ("uint16", 0, 2**16 - 1),
    ("int16", -(2**15), 2**15 - 1), ("uint32", 0, 2**32 - 1), ("int32", -(2**31), 2**31 - 1),
    ("uint64", 0, 2**64 - 1),
)  # fmt: skip
FLOAT32_MAX = 340282346638528859811704183484516925440
"""The greatest finite number of 32 bits."""

_KINDS = {"boolean": ("bool",), "string": ("string", "wstring"), "number": ("float64", "float32")}


def basic_type(schema: Mapping[str, Any]) -> str:
    """Return the basic type of a scalar, "" for anything else.

    A framework's own name counts where ROS has it, too; then the bounds; then the widest type.
    """
    kind, native = schema.get("type"), str(schema.get("x-native-type"))
    bounds = schema.get("minimum"), schema.get("maximum")
    if kind == "integer":
        if BASIC.get(native) in _WHOLE:
            return native
        return next((name for name, low, high in _INTEGERS if bounds == (low, high)), "int64")
    known = _KINDS.get(kind) if isinstance(kind, str) else None
    if known is None:
        return ""
    if native in known:
        return native
    narrow = kind == "number" and bounds == (-FLOAT32_MAX, FLOAT32_MAX)
    return "float32" if narrow else known[0]


def number_schema(name: str, code: str, unit: str | None = None) -> dict[str, Any]:
    """Return the schema of a number or a truth value of ROS.

    Args:
        name: of the type, as the framework has it.
        code: its format in `struct`: a `byte` is signed in ROS 1 and not in ROS 2.
        unit: what it counts, where that is known.
    """
    if code == "?":
        return {"type": "boolean"}
    schema: dict[str, Any] = {"type": "integer", "x-native-type": name}
    if code in _WHOLE:
        bits = 8 * struct.calcsize(f"<{code}")
        least = -(2 ** (bits - 1)) if code.islower() else 0
        schema["minimum"], schema["maximum"] = least, least + 2**bits - 1
    else:
        schema.update({"type": "number", "x-nonfinite": True})
        if code == "f":
            schema["minimum"], schema["maximum"] = -FLOAT32_MAX, FLOAT32_MAX
    if unit is not None:
        schema["x-unit"] = unit
    return schema


# As REP-103 and the comments of the definitions state them.
_UNITS: Mapping[str, Mapping[str, str]] = {
    "builtin_interfaces/Duration": {"sec": "s", "nanosec": "ns"},
    "builtin_interfaces/Time": {"sec": "s", "nanosec": "ns"},
    "duration": {"secs": "s", "nsecs": "ns"},
    "time": {"secs": "s", "nsecs": "ns"},
    "geometry_msgs/Accel": {"linear": "m/s2", "angular": "rad/s2"},
    "geometry_msgs/Inertia": {"m": "kg", "com": "m"},
    "geometry_msgs/Point": {"x": "m", "y": "m", "z": "m"},
    "geometry_msgs/Point32": {"x": "m", "y": "m", "z": "m"},
    "geometry_msgs/Pose2D": {"x": "m", "y": "m", "theta": "rad"},
    "geometry_msgs/Quaternion": {"x": "1", "y": "1", "z": "1", "w": "1"},
    "geometry_msgs/Transform": {"translation": "m"},
    "geometry_msgs/Twist": {"linear": "m/s", "angular": "rad/s"},
    "geometry_msgs/Wrench": {"force": "N", "torque": "N.m"},
    "nav_msgs/GridCells": {"cell_width": "m", "cell_height": "m"},
    "nav_msgs/MapMetaData": {"resolution": "m"},
    "sensor_msgs/BatteryState": {
        "voltage": "V",
        "temperature": "degC",
        "current": "A",
        "charge": "A.h",
        "capacity": "A.h",
        "design_capacity": "A.h",
        "percentage": "1",
        "cell_voltage": "V",
        "cell_temperature": "degC",
    },
    "sensor_msgs/FluidPressure": {"fluid_pressure": "Pa"},
    "sensor_msgs/Illuminance": {"illuminance": "lx"},
    "sensor_msgs/Imu": {"angular_velocity": "rad/s", "linear_acceleration": "m/s2"},
    "sensor_msgs/LaserScan": {
        "angle_min": "rad",
        "angle_max": "rad",
        "angle_increment": "rad",
        "time_increment": "s",
        "scan_time": "s",
        "range_min": "m",
        "range_max": "m",
        "ranges": "m",
    },
    "sensor_msgs/MagneticField": {"magnetic_field": "T"},
    "sensor_msgs/NavSatFix": {"latitude": "deg", "longitude": "deg", "altitude": "m"},
    "sensor_msgs/Range": {
        "field_of_view": "rad",
        "min_range": "m",
        "max_range": "m",
        "range": "m",
    },
    "sensor_msgs/RelativeHumidity": {"relative_humidity": "1"},
    "sensor_msgs/Temperature": {"temperature": "degC"},
}


def ros_unit(type_name: str, member: str) -> str | None:
    """Return the unit of the numbers in a member of a type of ROS, None where none is stated.

    Args:
        type_name: `package/Name`, or `package/msg/Name` as ROS 2 has it.
        member: of the type.
    """
    return _UNITS.get(type_name.replace("/msg/", "/"), {}).get(member)
