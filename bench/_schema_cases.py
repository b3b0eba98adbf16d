# ruff: noqa: E501 - a table is read best with one case a line
"""Pairs for the bench of the containment checker: real message types, hand-written ones, growth."""

from __future__ import annotations

from functools import reduce
from typing import Any, NamedTuple

Schema = dict[str, object]

FLOAT64: Schema = {"type": "number"}
STRING: Schema = {"type": "string"}
BOOLEAN: Schema = {"type": "boolean"}


class Case(NamedTuple):
    """One question with its true answer."""

    group: str
    name: str
    producer: Schema
    consumer: Schema
    contained: bool


def integer(bits: int, *, signed: bool = False) -> Schema:
    low = -(2 ** (bits - 1)) if signed else 0
    return {"type": "integer", "minimum": low, "maximum": low + 2**bits - 1}


def message(**fields: object) -> Schema:
    return {
        "type": "object",
        "properties": fields,
        "required": list(fields),
        "additionalProperties": False,
    }


def sequence(items: object, length: int | None = None) -> Schema:
    fixed = {} if length is None else {"minItems": length, "maxItems": length}
    return {"type": "array", "items": items, **fixed}


STAMP = message(sec=integer(32, signed=True), nanosec=integer(32))
HEADER = message(stamp=STAMP, frame_id=STRING)
POINT = message(x=FLOAT64, y=FLOAT64, z=FLOAT64)
QUATERNION = message(x=FLOAT64, y=FLOAT64, z=FLOAT64, w=FLOAT64)
POSE = message(position=POINT, orientation=QUATERNION)
TWIST = message(linear=POINT, angular=POINT)


def pose_stamped(header: Schema = HEADER) -> Schema:
    return message(header=header, pose=POSE)


def laser_scan(ranges: Schema | None = None) -> Schema:
    scalars = ("angle_min", "angle_max", "angle_increment", "time_increment", "scan_time")
    limits = dict.fromkeys((*scalars, "range_min", "range_max"), FLOAT64)
    values = ranges or sequence(FLOAT64)
    return message(header=HEADER, **limits, ranges=values, intensities=sequence(FLOAT64))


def image(data: Schema | None = None) -> Schema:
    return message(
        header=HEADER,
        height=integer(32),
        width=integer(32),
        encoding=STRING,
        is_bigendian=integer(8),
        step=integer(32),
        data=data or sequence(integer(8)),
    )


def odometry(child: Schema = STRING) -> Schema:
    return message(
        header=HEADER,
        child_frame_id=child,
        pose=message(pose=POSE, covariance=sequence(FLOAT64, 36)),
        twist=message(twist=TWIST, covariance=sequence(FLOAT64, 36)),
    )


def command(**bodies: Schema) -> Schema:
    return {"oneOf": [message(kind={"const": tag}, body=body) for tag, body in bodies.items()]}


def tree(value: Schema) -> Schema:
    children = sequence({"$ref": "#/$defs/node"})
    return {"$defs": {"node": message(value=value, children=children)}, "$ref": "#/$defs/node"}


def optional_unions(count: int, *branches: Schema) -> Schema:
    fields: dict[str, object] = {f"f{n}": {"anyOf": list(branches)} for n in range(count)}
    return {"type": "object", "properties": fields, "additionalProperties": False}


def nested(levels: int, leaf: Schema) -> Schema:
    return reduce(lambda inner, _: message(a=inner), range(levels), leaf)


def wide(count: int, value: Schema) -> Schema:
    return message(**{f"field_{n}": value for n in range(count)})


def tags(count: int, value: Schema) -> Schema:
    return command(**{f"tag{n}": value for n in range(count)})


def zero_message(schema: Any, given: Any = None) -> Any:
    """Return a message of a structure that is zero where nothing is given."""
    if schema.get("type") == "object":
        members = schema["properties"].items()
        return {key: zero_message(member, (given or {}).get(key)) for key, member in members}
    if given is not None:
        return given
    if schema.get("type") == "array":
        return [zero_message(schema["items"]) for _ in range(schema.get("minItems", 0))]
    kinds: dict[object, object] = {"string": "", "boolean": False, "integer": 0}
    return kinds.get(schema.get("type"), 0.0)


_SHORT_HEADER = message(stamp=message(sec=integer(32, signed=True)), frame_id=STRING)
_WORD: Schema = {"type": "string", "pattern": "^[a-z]{2,8}$"}
_IDENTIFIER: Schema = {"type": "string", "pattern": "^[a-z][a-z0-9_]*$", "maxLength": 64}
_MAP: Schema = {"type": "object", "additionalProperties": integer(8)}
_OPEN: Schema = {"type": "object", "properties": {"x": FLOAT64}, "required": ["x"]}
_PLAN: Schema = {
    "type": "object",
    "properties": {"mode": {"enum": ["auto", "manual"]}, "speed": {"type": "number", "minimum": 0}},
    "required": ["mode"],
    "if": {"properties": {"mode": {"const": "auto"}}},
    "then": {"required": ["speed"]},
    "additionalProperties": False,
}

ROBOT = (
    Case("robot", "PoseStamped, same", pose_stamped(), pose_stamped(), contained=True),
    Case("robot", "PoseStamped, no nanosec", pose_stamped(_SHORT_HEADER), pose_stamped(), False),
    Case("robot", "LaserScan, same", laser_scan(), laser_scan(), contained=True),
    Case("robot", "LaserScan, 720 into any", laser_scan(sequence(FLOAT64, 720)), laser_scan(), True),
    Case("robot", "LaserScan, any into 720", laser_scan(), laser_scan(sequence(FLOAT64, 720)), False),
    Case("robot", "Image, same", image(), image(), contained=True),
    Case("robot", "Image, int8 data", image(sequence(integer(8, signed=True))), image(), False),
    Case("robot", "Odometry, same", odometry(), odometry(), contained=True),
    Case("robot", "Odometry, child nullable", odometry(), odometry({"type": ["string", "null"]}), True),
    Case("robot", "Odometry, from nullable", odometry({"type": ["string", "null"]}), odometry(), False),
    Case("robot", "uint64 into float64", message(n=integer(64)), message(n=FLOAT64), contained=True),
    Case("robot", "bool into uint8", message(n=BOOLEAN), message(n=integer(8)), contained=False),
)  # fmt: skip
HAND = (
    Case("hand-written", "tagged union, more tags", command(go=POSE, stop=STRING), command(stop=STRING, go=POSE, wait=FLOAT64), True),
    Case("hand-written", "tagged union, fewer tags", command(go=POSE, stop=STRING), command(go=POSE), False),
    Case("hand-written", "pattern into pattern", message(id=_WORD), message(id=_IDENTIFIER), True),
    Case("hand-written", "pattern into narrower", message(id=_IDENTIFIER), message(id=_WORD), False),
    Case("hand-written", "map into a closed record", _MAP, message(x=FLOAT64), contained=False),
    Case("hand-written", "open into typed optional", _OPEN, {"type": "object", "properties": {"y": STRING}}, False),
    Case("hand-written", "tree widens", tree(integer(8)), tree(FLOAT64), contained=True),
    Case("hand-written", "tree narrows", tree(FLOAT64), tree(integer(8)), contained=False),
    Case("hand-written", "condition into its cases", _PLAN, {"oneOf": [{"properties": {"mode": {"const": "auto"}}, "required": ["speed"]}, {"properties": {"mode": {"const": "manual"}}}]}, True),
    Case("hand-written", "decimal steps", {"type": "number", "multipleOf": 0.1}, {"type": "number", "multipleOf": 0.01}, True),
    Case("hand-written", "three unique booleans", {"type": "array", "items": BOOLEAN, "uniqueItems": True}, {"type": "array", "maxItems": 2}, True),
)  # fmt: skip
GROWTH = (
    *(Case("fields", str(n), wide(n, integer(8)), wide(n, FLOAT64), True) for n in (10, 100, 1000, 2000)),
    *(Case("depth", str(n), nested(n, integer(8)), nested(n, FLOAT64), True) for n in (10, 50, 100, 500)),
    *(Case("optional union fields", str(n), optional_unions(n, integer(8), STRING), optional_unions(n, STRING, FLOAT64), True) for n in (2, 5, 10, 20)),
    *(Case("tags of a union", str(n), tags(n, integer(8)), tags(n, FLOAT64), True) for n in (5, 20, 100)),
    *(Case("enum members", str(n), {"enum": [f"w{k}" for k in range(n)]}, {"enum": [f"w{k}" for k in reversed(range(n))]}, True) for n in (10, 1000, 10_000)),
)  # fmt: skip
CASES: tuple[Case, ...] = (*ROBOT, *HAND, *GROWTH)
