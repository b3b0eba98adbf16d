"""What an IDL type is made of, as plain values independent of any ORB, its structure and codec.

Schemas, writers and readers are all derived from shapes. A schema has the exact ranges and the
native facts; units are those that the comments in OpenRTM's own IDL state.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, TypeAlias

from attrs import evolve, frozen

from uoarm.cdr import CORBA, FLOAT32_MAX, SWITCH, ByteOrder, Codec
from uoarm.model import MessageStructure, closed_object

INTEGERS = {
    "octet": (0, 255),
    "short": (-(2**15), 2**15 - 1),
    "unsigned short": (0, 2**16 - 1),
    "long": (-(2**31), 2**31 - 1),
    "unsigned long": (0, 2**32 - 1),
    "long long": (-(2**63), 2**63 - 1),
    "unsigned long long": (0, 2**64 - 1),
}
"""Least and greatest value of each integer type."""


@frozen
class IdlScalar:
    """A number, `boolean`, `char` or `wchar`, by its IDL name."""

    name: str


@frozen
class IdlString:
    """A string; `bound` counts characters, None for no bound."""

    wide: bool = False
    bound: int | None = None


@frozen
class IdlEnum:
    """One of several labels; the wire carries the position."""

    name: str
    labels: tuple[str, ...]


@frozen
class IdlSequence:
    """Many elements: exactly `size`, at most `size`, or any number when `size` is None."""

    element: Shape
    size: int | None = None
    fixed: bool = False


@frozen
class IdlMember:
    """One named member of a record."""

    name: str
    shape: Shape


@frozen
class IdlStruct:
    """A struct. `name` is its repository id, such as `IDL:RTC/Time:1.0`."""

    name: str
    fields: tuple[IdlMember, ...]


@frozen
class IdlUnionMember:
    """One member of a union; `labels` are the discriminator's values, empty for the default."""

    name: str
    labels: tuple[object, ...]
    shape: Shape


@frozen
class IdlUnion:
    """A union. `by` is the discriminator: an IdlScalar or an IdlEnum (labels as strings)."""

    name: str
    by: IdlScalar | IdlEnum
    variants: tuple[IdlUnionMember, ...]


Shape: TypeAlias = "IdlScalar | IdlString | IdlEnum | IdlSequence | IdlStruct | IdlUnion"


def _all(unit: str, *names: str) -> dict[str, str]:
    return dict.fromkeys(names, unit)


_UNITS: Mapping[str, Mapping[str, str]] = {
    "Time": {"sec": "s", "nsec": "ns"},
    "Point2D": _all("m", "x", "y"),
    "Vector2D": _all("m", "x", "y"),
    "Pose2D": {"heading": "rad"},
    "Velocity2D": _all("m/s", "vx", "vy") | {"va": "rad/s"},
    "Acceleration2D": _all("m/s2", "ax", "ay"),
    "Size2D": _all("m", "l", "w"),
    "Carlike": {"speed": "m/s", "steeringAngle": "rad"},
    "SpeedHeading2D": {"speed": "m/s", "heading": "rad"},
    "Point3D": _all("m", "x", "y", "z"),
    "Vector3D": _all("m", "x", "y", "z"),
    "Orientation3D": _all("rad", "r", "p", "y"),
    "Velocity3D": _all("m/s", "vx", "vy", "vz") | _all("rad/s", "vr", "vp", "va"),
    "AngularVelocity3D": _all("rad/s", "avx", "avy", "avz"),
    "Acceleration3D": _all("m/s2", "ax", "ay", "az"),
    "AngularAcceleration3D": _all("rad/s2", "aax", "aay", "aaz"),
    "Size3D": _all("m", "l", "w", "h"),
    "SpeedHeading3D": {"speed": "m/s"},
    # Directions, although a vector's own comment counts metres.
    "OAP": _all("1", "orientation", "approach"),
    "ActArrayActuatorGeometry": {"axis": "1"},
    "BumperGeometry": {"roc": "m"},
    "FiducialFOV": _all("m", "minRange", "maxRange") | {"viewAngle": "rad"},
    "GPSData": _all("deg", "latitude", "longitude")
    | _all("m", "altitude", "horizontalError", "verticalError")
    | _all("m/s", "horizontalSpeed", "verticalSpeed")
    | {"heading": "rad"},
    "INSData": _all("deg", "latitude", "longitude") | _all("m", "altitude", "heightAMSL"),
    "LineFeature": {"rho": "m", "alpha": "rad"},
    "Waypoint2D": {"distanceTolerance": "m", "headingTolerance": "rad"},
    "Waypoint3D": {"distanceTolerance": "m", "headingTolerance": "rad"},
    "PanTiltAngles": _all("rad", "pan", "tilt"),
    "PanTiltState": _all("rad/s", "panSpeed", "tiltSpeed"),
    "RangerConfig": _all("rad", "minAngle", "maxAngle", "angularRes")
    | _all("m", "minRange", "maxRange", "rangeRes"),
    "RangeData": {"ranges": "m"},
}


def unit_of(record: str, member: str) -> str | None:
    """Return the unit of a member's numbers, None where the IDL states none.

    Args:
        record: repository id of the struct.
        member: its name.
    """
    module, _, name = record.removeprefix("IDL:").partition(":")[0].rpartition("/")
    return _UNITS.get(name, {}).get(member) if module == "RTC" else None


DERIVED = "IDL:uoarm/"
"""How the names of types begin that we derive from structures."""

_REPOSITORY_ID = re.compile(r"IDL:(.+):([0-9.]+)")


def structure_of(shape: Shape, encoding: str = "utf-8") -> MessageStructure:
    """Return the structure of a shape; records are closed objects with every field required."""
    return MessageStructure(schema_of(shape, encoding), native_type=getattr(shape, "name", ""))


def schema_of(shape: Shape, encoding: str = "utf-8", unit: str | None = None) -> dict[str, Any]:
    """Return the schema of a shape.

    Args:
        shape: of the messages.
        encoding: of narrow strings, whose bounds count what they are written in.
        unit: holds for the numbers in it that state none.
    """
    if isinstance(shape, IdlStruct):
        return _record(shape, encoding, unit)
    if isinstance(shape, IdlSequence):
        return _array(shape, encoding, unit)
    if isinstance(shape, IdlUnion):
        return {
            "oneOf": list(_variants(shape, encoding)),
            "x-native-type": shape.name,
            "x-switch": schema_of(shape.by, encoding),
        }
    if isinstance(shape, IdlEnum):
        return {"type": "string", "enum": list(shape.labels), "x-native-type": shape.name}
    if isinstance(shape, IdlString):
        return _string(shape, encoding)
    return _scalar(shape, unit)


def _string(text: IdlString, encoding: str) -> dict[str, Any]:
    schema: dict[str, Any] = {"type": "string", "x-nul": False}
    if text.bound is not None:
        schema["maxLength"] = text.bound
        if text.wide:
            schema["x-max-utf16"] = text.bound
        elif encoding == "utf-8":
            schema["x-max-utf8"] = text.bound
    return {**schema, "x-native-type": "wstring"} if text.wide else schema


def _record(record: IdlStruct, encoding: str, unit: str | None) -> dict[str, Any]:
    members = {
        member.name: schema_of(member.shape, encoding, unit or unit_of(record.name, member.name))
        for member in record.fields
    }
    schema = _object(members, record.name)
    named = _REPOSITORY_ID.fullmatch(record.name)
    # A type that we derived is named after its port: it is whatever its messages are.
    if named is not None and not record.name.startswith(DERIVED):
        schema["x-type"] = {"name": named[1].replace("/", "::"), "version": named[2]}
    return schema


def _object(properties: dict[str, Any], name: str) -> dict[str, Any]:
    return closed_object(properties, **({"x_native_type": name} if name else {}))


def _array(listing: IdlSequence, encoding: str, unit: str | None) -> dict[str, Any]:
    items = schema_of(listing.element, encoding, unit)
    schema: dict[str, Any] = {"type": "array", "items": items}
    if listing.size is not None:
        schema["maxItems"] = listing.size
    if listing.fixed:
        schema["minItems"] = listing.size
    if listing.element == IdlScalar("octet"):
        schema["x-octets"] = True
    return schema


def _scalar(scalar: IdlScalar, unit: str | None = None) -> dict[str, Any]:
    name = scalar.name
    if name == "boolean":
        return {"type": "boolean"}
    if name in {"char", "wchar"}:
        last = "\\u00ff" if name == "char" else "\\uffff"
        character = {"minLength": 1, "maxLength": 1, "pattern": f"^[\\u0000-{last}]$"}
        return {"type": "string", **character, "x-native-type": name}
    if name in INTEGERS:
        low, high = INTEGERS[name]
        schema: dict[str, Any] = {"type": "integer", "minimum": low, "maximum": high}
        schema["x-native-type"] = name
    else:
        schema = {"type": "number", "x-native-type": name, "x-nonfinite": True}
        if name == "float":
            schema["minimum"], schema["maximum"] = -FLOAT32_MAX, FLOAT32_MAX
    return schema if unit is None else {**schema, "x-unit": unit}


def _variants(choice: IdlUnion, encoding: str) -> list[dict[str, Any]]:
    """Return one closed object for every member, and one for the values that have none."""
    schemas = []
    named = [label for variant in choice.variants for label in variant.labels]
    rest = _rest(choice.by, named)
    for variant in choice.variants:
        labels: dict[str, Any] = {"enum": list(variant.labels)}
        if not variant.labels:
            labels = rest or {"enum": []}
        inner = schema_of(variant.shape, encoding)
        schemas.append(_object({SWITCH: labels, variant.name: inner}, choice.name))
    if rest is not None and all(variant.labels for variant in choice.variants):
        schemas.append(_object({SWITCH: rest}, choice.name))
    return schemas


def _rest(by: IdlScalar | IdlEnum, named: list[object]) -> dict[str, Any] | None:
    """Return the schema of the discriminator's other values, None when there are none."""
    if isinstance(by, IdlEnum) or by.name == "boolean":
        every: tuple[object, ...] = (False, True) if isinstance(by, IdlScalar) else by.labels
        left = [label for label in every if label not in named]
        return {"enum": left} if left else None
    if by.name not in INTEGERS:
        return {**_scalar(by), "not": {"enum": list(named)}}
    low, high = INTEGERS[by.name]
    gaps = []
    for label in sorted(label for label in named if isinstance(label, int)):
        if low < label:
            gaps.append({"type": "integer", "minimum": low, "maximum": label - 1})
        low = label + 1
    if low <= high:
        gaps.append({"type": "integer", "minimum": low, "maximum": high})
    return {"anyOf": gaps} if gaps else None


LITTLE: ByteOrder = "<"
BIG: ByteOrder = ">"


class CdrCodec(Codec):
    """Marshals the messages of one type: the body alone, aligned from its first byte.

    Args:
        encoding: of narrow strings, `utf-8` or `latin-1`.
        name: what errors call the type.
    """

    def __init__(self, shape: Shape, encoding: str, name: str) -> None:
        structure = structure_of(shape, encoding)
        super().__init__(structure, evolve(CORBA, charset=encoding), name=name)
        self.shape = shape


@lru_cache(maxsize=1024)
def codec_of(shape: Shape, encoding: str = "utf-8") -> CdrCodec:
    """Return the codec of a type, made once."""
    return CdrCodec(shape, encoding, getattr(shape, "name", type(shape).__name__))
