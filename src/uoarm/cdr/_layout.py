"""What lies where: basic types, ways of serialising, and the layout of a structure in one of them.

A layout is a value of its own: two structures of the same layout share what is generated for it.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Mapping
from typing import Any, Literal, TypeAlias

from attrs import frozen

from uoarm.errors import MessageError

BASIC = {
    "bool": "?", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H",
    "int32": "i", "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
    "string": "", "wstring": "",
}  # fmt: skip
"""Every basic type and its format in `struct`; empty for texts."""

_WHOLE = frozenset("bBhHiIqQ")
FLOAT32_MAX = 340282346638528859811704183484516925440
"""The greatest finite number of 32 bits."""

_KINDS = {"boolean": ("bool",), "string": ("string", "wstring"), "number": ("float64", "float32")}


def basic_type(schema: Mapping[str, Any]) -> str:
    """Return the basic type of a scalar, "" for anything else.

    A framework's own name counts where ROS has it, too; then the bounds; then the widest type.
    """
    kind, native = schema.get("type"), str(schema.get("x-native-type"))
    bounds: tuple[Any, Any] = schema.get("minimum"), schema.get("maximum")
    if kind == "integer":
        if BASIC.get(native) in _WHOLE:
            return native
        return _NAMES[_CODES.get(bounds, "q")]
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


ByteOrder: TypeAlias = Literal["<", ">"]
"""Little-endian or big-endian, as `struct` and numpy write it."""

NATIVE: ByteOrder = "<" if sys.byteorder == "little" else ">"
"""The machine's own."""

SIZES = {"B": 1, "b": 1, "h": 2, "H": 2, "i": 4, "I": 4, "q": 8, "Q": 8, "f": 4, "d": 8}
"""Octets of each code of `struct`, which are its alignment, too."""

SWITCH = "switch"
"""The member of a union's message that says which other member it has."""

_MAX_DEPTH = 64


@frozen
class Encoding:
    """A way of serialising.

    Attributes:
        name: in the texts of errors.
        is_aligned: each number lies at a multiple of its size, as in CDR; else all is packed.
        is_encapsulated: four octets stand in front and say in which byte order the rest is;
            alignment is counted from behind them.
        is_idl: there are characters, enumerations and unions, texts are of the stated character set
            and truth values 0 or 1, as CORBA has it. ROS has none of them, and reads any octets.
        charset: of narrow texts.
    """

    name: str
    is_aligned: bool = True
    is_encapsulated: bool = False
    is_idl: bool = False
    charset: str = "utf-8"

    @property
    def header_size(self) -> int:
        """How many octets stand before the first value."""
        return 4 if self.is_encapsulated else 0


DDS = Encoding("CDR of DDS", is_encapsulated=True)
"""CDR version 1 as Fast CDR and so ROS 2 writes it, in either byte order."""

CORBA = Encoding("CDR of CORBA", is_idl=True)
"""CDR version 1 as CORBA writes it: the body alone, in the byte order that its carrier states."""

ROS_1 = Encoding("serialisation of ROS 1", is_aligned=False)
"""Everything packed; its byte order is the little one."""


@frozen
class NumberLayout:
    """An integer or a float.

    Attributes:
        code: of `struct` and numpy.
        name: of the type, in the texts of errors.
    """

    code: str
    name: str

    @property
    def bounds(self) -> tuple[int, int] | None:
        """The least and greatest integer; None: it is a float."""
        return _BOUNDS.get(self.code)


@frozen
class BooleanLayout:
    """A truth value, in one octet."""


@frozen
class CharacterLayout:
    """A character of Latin-1, or a wide one of the basic plane."""

    is_wide: bool = False


@frozen
class TextLayout:
    """A text; `bound` counts octets of the character set, of a wide one units of UTF-16."""

    is_wide: bool = False
    bound: int | None = None


@frozen
class EnumerationLayout:
    """One of several labels, as its position."""

    labels: tuple[str, ...]


@frozen
class ArrayLayout:
    """Elements: exactly `size`, at most `size`, or any number when `size` is None."""

    element: Layout
    size: int | None = None
    is_fixed: bool = False


@frozen
class RecordLayout:
    """Named members, one after another."""

    members: tuple[tuple[str, Layout], ...]


@frozen
class UnionMember:
    """One member of a union; `labels` are the values of the switch, None for all others."""

    name: str
    labels: tuple[object, ...] | None
    layout: Layout


@frozen
class UnionLayout:
    """A switch, and the member that it selects; none where no member has its value."""

    by: Layout
    members: tuple[UnionMember, ...]


Layout: TypeAlias = (
    "NumberLayout | BooleanLayout | CharacterLayout | TextLayout | EnumerationLayout"
    " | ArrayLayout | RecordLayout | UnionLayout"
)

_BOUNDS = {
    "b": (-(2**7), 2**7 - 1), "B": (0, 2**8 - 1), "h": (-(2**15), 2**15 - 1), "H": (0, 2**16 - 1),
    "i": (-(2**31), 2**31 - 1), "I": (0, 2**32 - 1), "q": (-(2**63), 2**63 - 1),
    "Q": (0, 2**64 - 1),
}  # fmt: skip
_CODES = {bounds: code for code, bounds in _BOUNDS.items()}
# Where a structure does not state all bounds, the framework's own name of the type counts.
_NATIVE = {
    **BASIC, "octet": "B", "short": "h", "unsigned short": "H", "long": "i", "unsigned long": "I",
    "long long": "q", "unsigned long long": "Q",
}  # fmt: skip
_NAMES = {code: name for name, code in BASIC.items() if name not in {"byte", "char"}}


def layout_of(
    schema: object, encoding: Encoding, where: str = "the message", depth: int = 0
) -> Layout:
    """Return the layout of what a schema describes.

    Raises:
        MessageError: it has no fixed layout; the text names the member.
    """
    if not isinstance(schema, Mapping) or depth > _MAX_DEPTH:
        raise _loose(where, "anything may stand there")
    kind, native = schema.get("type"), str(schema.get("x-native-type", ""))
    if kind == "array":
        return _array(schema, encoding, where, depth)
    if kind == "string":
        return _text(schema, native, encoding, where)
    if kind == "boolean":
        return BooleanLayout()
    if kind in ("integer", "number"):
        return _number(schema, native)
    if kind == "object":
        return _record(schema, encoding, where, depth)
    if encoding.is_idl and "x-switch" in schema:
        return _union(schema, encoding, where, depth)
    raise _loose(where, "no single type is stated for it")


def _number(schema: Mapping[str, Any], native: str) -> NumberLayout:
    bounds: tuple[Any, Any] = schema.get("minimum"), schema.get("maximum")
    if schema["type"] == "integer":
        code = _CODES.get(bounds) or _NATIVE.get(native, "q")
    else:
        is_narrow = native in {"float32", "float"} or bounds == (-FLOAT32_MAX, FLOAT32_MAX)
        code = "f" if is_narrow and native != "float64" else "d"
    return NumberLayout(code, native or _NAMES[code])


def _text(
    schema: Mapping[str, Any], native: str, encoding: Encoding, where: str
) -> TextLayout | CharacterLayout | EnumerationLayout:
    is_wide = native == "wstring"
    if encoding.is_idl:
        if native in {"char", "wchar"}:
            return CharacterLayout(is_wide=native == "wchar")
        if "enum" in schema:
            return EnumerationLayout(tuple(schema["enum"]))
    elif is_wide and not encoding.is_aligned:
        raise _loose(where, f"the {encoding.name} has no wide texts")
    bound = schema.get("x-max-utf16" if is_wide else "x-max-utf8")
    if bound is None and encoding.is_idl:
        bound = schema.get("maxLength")
    return TextLayout(is_wide, bound)


def _array(schema: Mapping[str, Any], encoding: Encoding, where: str, depth: int) -> ArrayLayout:
    items = schema.get("items")
    if not isinstance(items, Mapping) or "prefixItems" in schema:
        raise _loose(where, "its elements have no single type")
    if items.get("type") == "array" and not encoding.is_idl:
        raise _loose(where, "ROS has no arrays whose elements are arrays")
    least, most = schema.get("minItems"), schema.get("maxItems")
    element = layout_of(items, encoding, f"{where}[]", depth + 1)
    return ArrayLayout(element, most, is_fixed=most is not None and least == most)


def _record(schema: Mapping[str, Any], encoding: Encoding, where: str, depth: int) -> RecordLayout:
    fields: Mapping[str, object] = schema.get("properties", {})
    is_whole = fields.keys() == set(schema.get("required", ()))
    if not is_whole or schema.get("additionalProperties") is not False:
        raise _loose(where, "fields may be absent or added")
    return RecordLayout(
        tuple(
            (name, layout_of(field, encoding, f"{where}.{name}", depth + 1))
            for name, field in fields.items()
        )
    )


def _union(schema: Mapping[str, Any], encoding: Encoding, where: str, depth: int) -> UnionLayout:
    members = []
    for variant in schema.get("oneOf", ()):
        properties: Mapping[str, Any] = variant.get("properties", {})
        labels = properties[SWITCH].get("enum") if "not" not in properties[SWITCH] else None
        members += [
            UnionMember(
                name,
                None if labels is None else tuple(labels),
                layout_of(field, encoding, f"{where}.{name}", depth + 1),
            )
            for name, field in properties.items()
            if name != SWITCH
        ]
    by = layout_of(schema["x-switch"], encoding, f"{where}.{SWITCH}", depth + 1)
    # What has all other values is looked at last.
    return UnionLayout(by, tuple(sorted(members, key=lambda member: member.labels is None)))


def _loose(where: str, why: str) -> MessageError:
    return MessageError(f"{where} has no fixed layout ({why})")


def least_size(layout: Layout) -> int:
    """Return the least number of octets that a value takes, padding aside."""
    if isinstance(layout, RecordLayout):
        return sum(least_size(member) for _, member in layout.members)
    if isinstance(layout, ArrayLayout):
        return least_size(layout.element) * (layout.size or 0) if layout.is_fixed else 4
    if isinstance(layout, UnionLayout):
        return least_size(layout.by)
    if isinstance(layout, CharacterLayout):
        return 3 if layout.is_wide else 1
    if isinstance(layout, NumberLayout):
        return SIZES[layout.code]
    return 1 if isinstance(layout, BooleanLayout) else 4
