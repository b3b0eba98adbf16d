"""Units of members, as the comments in OpenRTM's own IDL have them.

What those leave open, such as metres or radians of an actuator, has none.
"""

from __future__ import annotations

from collections.abc import Mapping

__all__ = ["unit_of"]


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
