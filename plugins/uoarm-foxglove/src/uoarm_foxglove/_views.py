"""What viewers draw of messages of any framework: pictures, scans, points, grids and transforms.

A structure says what it is by its fields. Such an output has a second channel, of a type that
viewers know, beside the one with its messages as they are. What is of such a type already has none.
"""

from __future__ import annotations

import math
import operator
import re
import time
from array import array
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any, TypeAlias

from uoarm import cdr
from uoarm.bridge import foreign, text_of
from uoarm.errors import MessageError
from uoarm.model import Message, MessageStructure
from uoarm_foxglove._protocol import CDR, StructureCodec

Fields: TypeAlias = Mapping[str, Any]
Path: TypeAlias = "tuple[str, ...]"
Octets: TypeAlias = "bytes | bytearray | memoryview"
Make: TypeAlias = Callable[[Any], dict[str, Any]]

_NANO = 1_000_000_000
_DEEPEST = 3
_KNOWN_PACKAGES = ("sensor_msgs/", "nav_msgs/", "tf2_msgs/", "geometry_msgs/", "foxglove_msgs/")
_STAMPS: tuple[Path, ...] = (("timestamp",), ("stamp",), ("header", "stamp"), ("tm",))
_FRAMES: tuple[Path, ...] = (("frame_id",), ("header", "frame_id"))
_PIXELS = {8: "mono8", 16: "mono16", 24: "bgr8", 32: "bgra8"}  # by bits, as OpenCV has them
_OPENCV = re.compile(r"(8|16|32|64)[USF]C(\d+)")
_NAMED = re.compile(r"(mono|bayer|rgba?|bgra?)(?:_[a-z]+)?(8|16)")
_FLOAT64, _INT8, _UINT8 = 8, 2, 1
_IDENTITY = {
    "position": {"x": 0.0, "y": 0.0, "z": 0.0},
    "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
}
_HEAD = "builtin_interfaces/Time timestamp\nstring frame_id\n"
_POSED = f"{_HEAD}geometry_msgs/Pose pose\n"
_PACKED = "foxglove_msgs/PackedElementField[] fields\nuint8[] data\n"
_TRANSFORM = """builtin_interfaces/Time timestamp
string parent_frame_id
string child_frame_id
geometry_msgs/Vector3 translation
geometry_msgs/Quaternion rotation
"""
_TEXTS = {
    "CompressedImage": f"{_HEAD}uint8[] data\nstring format\n",
    "RawImage": f"{_HEAD}uint32 width\nuint32 height\nstring encoding\nuint32 step\nuint8[] data\n",
    "LaserScan": f"{_POSED}float64 start_angle\nfloat64 end_angle\n"
    "float64[] ranges\nfloat64[] intensities\n",
    "PointCloud": f"{_POSED}uint32 point_stride\n{_PACKED}",
    "Grid": f"{_POSED}uint32 column_count\nfoxglove_msgs/Vector2 cell_size\n"
    f"uint32 row_stride\nuint32 cell_stride\n{_PACKED}",
    "FrameTransforms": "foxglove_msgs/FrameTransform[] transforms\n",
}
_PARTS = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
    "foxglove_msgs/Vector2": "float64 x\nfloat64 y\n",
    "foxglove_msgs/PackedElementField": "string name\nuint32 offset\nuint8 type\n",
    "foxglove_msgs/FrameTransform": _TRANSFORM,
}


def view_of(structure: MessageStructure, frame: str) -> StructureCodec | None:
    """Return how viewers draw messages of a structure; None: it does not say what it is.

    Args:
        structure: of the messages.
        frame: for what names no frame of its own.
    """
    if structure.native_type.startswith(_KNOWN_PACKAGES):
        return None
    found = _look(_fields(structure.schema), frame, 0)
    return None if found is None else _codec(*found)


def _look(fields: Fields, frame: str, depth: int) -> tuple[str, Make] | None:
    """Return what there is to draw, at the top or, as in what has a time beside it, further in."""
    for kind, recognise in _KINDS.items():
        make = recognise(fields, frame)
        if make is not None:
            return kind, make
    if depth < _DEEPEST:
        for name, schema in fields.items():
            found = _look(_fields(schema), frame, depth + 1)
            if found is not None:
                return found[0], _within(name, found[1])
    return None


def _within(name: str, make: Make) -> Make:
    return lambda message: make(message[name])


@cache
def _definition(kind: str) -> tuple[cdr.RosDefinition, Callable[[Message], Sequence[Octets]]]:
    text, wanted = _TEXTS[kind], [_TEXTS[kind]]
    parts: dict[str, str] = {}
    while wanted:
        lines = wanted.pop().splitlines()
        for name in (line.split()[0].removesuffix("[]") for line in lines):
            if name in _PARTS and name not in parts:
                parts[name] = _PARTS[name]
                wanted.append(_PARTS[name])
    for name, part in parts.items():
        text += f"{'=' * 80}\nMSG: {name}\n{part}"
    definition = cdr.RosDefinition(f"foxglove_msgs/msg/{kind}", text)
    return definition, cdr.serialiser(cdr.structure_of_definition(definition))


def _codec(kind: str, make: Make) -> StructureCodec:
    definition, serialise = _definition(kind)

    def write(message: Message) -> bytes:
        try:
            made = foreign(make, message)
        except Exception as error:  # few messages are checked: one may be anything
            text = f"{kind}: {text_of(error)}"
            raise MessageError(f"a message cannot be drawn as {text}") from error
        return b"".join(serialise(made))

    return StructureCodec(CDR, definition.name, "ros2msg", definition.text, write)


# What a structure has.


def _fields(schema: object) -> Fields:
    if not isinstance(schema, Mapping) or schema.get("type") != "object":
        return {}
    properties: Fields = schema.get("properties", {})
    return properties


def _at(fields: Fields, path: Path) -> Mapping[str, Any] | None:
    """Return the schema of what stands at a path, where it is one of its own."""
    for name in path[:-1]:
        fields = _fields(fields.get(name))
    found = fields.get(path[-1])
    return found if isinstance(found, Mapping) else None


def _is_number(schema: object) -> bool:
    return isinstance(schema, Mapping) and schema.get("type") in ("number", "integer")


def _is_integer(schema: object) -> bool:
    return isinstance(schema, Mapping) and schema.get("type") == "integer"


def _is_text(schema: object) -> bool:
    return isinstance(schema, Mapping) and schema.get("type") == "string"


def _is_octets(schema: object) -> bool:
    return isinstance(schema, Mapping) and schema.get("x-octets") is True


def _is_list_of(schema: object, is_item: Callable[[object], bool]) -> bool:
    return (
        isinstance(schema, Mapping)
        and schema.get("type") == "array"
        and not _is_octets(schema)
        and is_item(schema.get("items"))
    )


def _has_numbers(schema: object, names: str) -> bool:
    fields = _fields(schema)
    return all(_is_number(fields.get(name)) for name in names)


def _first(fields: Fields, paths: tuple[Path, ...], fits: Callable[[object], bool]) -> Path | None:
    return next((path for path in paths if fits(_at(fields, path))), None)


def _is_time(schema: object) -> bool:
    fields = _fields(schema)
    return _is_integer(fields.get("sec")) and any(
        _is_integer(fields.get(name)) for name in ("nanosec", "nsec")
    )


# What a message has.


def _get(message: Any, path: Path) -> Any:
    for name in path:
        message = message[name]
    return message


def _header(fields: Fields, frame: str) -> Callable[[Any], dict[str, Any]]:
    """Return what makes the time and frame of a message; without a time it is now."""
    stamp, named = _first(fields, _STAMPS, _is_time), _first(fields, _FRAMES, _is_text)

    def make(message: Any) -> dict[str, Any]:
        return {
            "timestamp": _now() if stamp is None else _time(_get(message, stamp)),
            "frame_id": (_get(message, named) if named is not None else "") or frame,
        }

    return make


def _now() -> dict[str, int]:
    seconds, nanoseconds = divmod(time.time_ns(), _NANO)
    return {"sec": seconds, "nanosec": nanoseconds}


def _time(stamp: Any) -> dict[str, int]:
    return {"sec": stamp["sec"], "nanosec": stamp.get("nanosec", stamp.get("nsec", 0))}


def _angle(fields: Fields, path: Path) -> Callable[[Any], float]:
    """Return what reads an angle in radians."""
    schema = _at(fields, path) or {}
    factor = math.radians(1) if schema.get("x-unit") == "deg" else 1.0
    return lambda message: float(_get(message, path)) * factor


# What there is to draw.


def _raw_image(fields: Fields, frame: str) -> Make | None:
    data = _first(fields, (("data",), ("pixels",), ("image",)), _is_octets)
    if data is None or not (_is_integer(fields.get("width")) and _is_integer(fields.get("height"))):
        return None
    named = _first(fields, (("encoding",),), _is_text)
    bits = _first(fields, (("bpp",),), _is_integer)
    if named is None and bits is None:
        return None
    header, has_step = _header(fields, frame), _is_integer(fields.get("step"))

    def make(message: Any) -> dict[str, Any]:
        # By `index`: to multiply an array that has itself as an element ends the process.
        width, height = operator.index(message["width"]), operator.index(message["height"])
        octets = _get(message, data)
        encoding = _get(message, named) if named else _PIXELS[_get(message, bits or ())]
        step = has_step and operator.index(message["step"])
        step = step or width * _pixel_octets(encoding)
        if len(octets) < step * height:
            raise ValueError(f"{len(octets):,} octets are not {height} rows of {step}")
        shape = {"width": width, "height": height, "step": step}
        return {**header(message), **shape, "encoding": encoding, "data": octets}

    return make


def _pixel_octets(encoding: str) -> int:
    """Return how many octets a pixel has in an encoding of ROS; of those with other names two."""
    if found := _OPENCV.fullmatch(encoding):
        return int(found[1]) // 8 * int(found[2])
    found = _NAMED.fullmatch(encoding)
    if found is None:
        return 2
    return int(found[2]) // 8 * (1 if found[1] in {"mono", "bayer"} else len(found[1]))


def _compressed_image(fields: Fields, frame: str) -> Make | None:
    data = _first(fields, (("data",), ("image",), ("picture",), ("jpeg",), ("png",)), _is_octets)
    if data is None:
        return None
    media = str((_at(fields, data) or {}).get("contentMediaType", ""))
    stated = media.removeprefix("image/") if media.startswith("image/") else ""
    named = _first(fields, (("format",),), _is_text)
    if not stated and data[0] in {"jpeg", "png"}:
        stated = data[0]
    if not stated and named is None:
        return None
    header = _header(fields, frame)

    def make(message: Any) -> dict[str, Any]:
        words = stated or str(_get(message, named or ())).lower()
        kind = next((name for name in ("jpeg", "png", "webp", "avif") if name in words), "")
        if not kind and "jpg" not in words:
            raise ValueError(f"the format {words[:40]!r} is no picture's")
        return {**header(message), "data": _get(message, data), "format": kind or "jpeg"}

    return make


def _laser_scan(fields: Fields, frame: str) -> Make | None:
    if not _is_list_of(fields.get("ranges"), _is_number):
        return None
    starts = ("start_angle",), ("angle_min",), ("config", "minAngle")
    ends = ("end_angle",), ("angle_max",), ("config", "maxAngle")
    first, last = _first(fields, starts, _is_number), _first(fields, ends, _is_number)
    if first is None or last is None:
        return None
    header, start, end = _header(fields, frame), _angle(fields, first), _angle(fields, last)
    has_intensities = _is_list_of(fields.get("intensities"), _is_number)

    def make(message: Any) -> dict[str, Any]:
        return {
            **header(message),
            "pose": _IDENTITY,
            "start_angle": start(message),
            "end_angle": end(message),
            "ranges": message["ranges"],
            "intensities": message["intensities"] if has_intensities else [],
        }

    return make


def _point_cloud(fields: Fields, frame: str) -> Make | None:
    def is_point(schema: object) -> bool:
        return _has_numbers(schema, "xyz") or _has_numbers(_fields(schema).get("point"), "xyz")

    points = fields.get("points")
    if not _is_list_of(points, is_point):
        return None
    inner = not _has_numbers(points["items"], "xyz") if isinstance(points, Mapping) else False
    header = _header(fields, frame)

    def make(message: Any) -> dict[str, Any]:
        numbers = array("d")
        for point in message["points"]:
            place = point["point"] if inner else point
            numbers.extend((place["x"], place["y"], place["z"]))
        packed = [{"name": n, "offset": 8 * i, "type": _FLOAT64} for i, n in enumerate("xyz")]
        data = numbers.tobytes()
        cloud = {"pose": _IDENTITY, "point_stride": 24, "fields": packed, "data": data}
        return {**header(message), **cloud}

    return make


def _grid(fields: Fields, frame: str) -> Make | None:
    inner = ("info",) if "info" in fields else ()
    about = _fields(fields["info"]) if inner else fields
    if not (_is_integer(about.get("width")) and _is_integer(about.get("height"))):
        return None
    if not _is_number(about.get("resolution")):
        return None
    data = fields.get("data")
    if not (_is_octets(data) or _is_list_of(data, _is_integer)):
        return None
    header, kind = _header(fields, frame), _UINT8 if _is_octets(data) else _INT8

    def make(message: Any) -> dict[str, Any]:
        shape, cells = _get(message, inner), message["data"]
        octets = bytes(cells) if kind == _UINT8 else array("b", cells).tobytes()
        if len(octets) != shape["width"] * shape["height"]:
            size = f"{shape['width']} by {shape['height']}"
            raise ValueError(f"{len(octets):,} cells are not {size}")
        return {
            **header(message),
            "pose": _IDENTITY,
            "column_count": shape["width"],
            "cell_size": {"x": shape["resolution"], "y": shape["resolution"]},
            "row_stride": shape["width"],
            "cell_stride": 1,
            "fields": [{"name": "cell", "offset": 0, "type": kind}],
            "data": octets,
        }

    return make


def _transforms(fields: Fields, frame: str) -> Make | None:
    alone = _transform(fields, frame)
    if alone is not None:
        return lambda message: {"transforms": [alone(message)]}
    listed = fields.get("transforms")
    items = listed.get("items") if isinstance(listed, Mapping) else None
    make = _transform(_fields(items), frame)
    if make is None:
        return None
    return lambda message: {"transforms": [make(item) for item in message["transforms"]]}


def _transform(fields: Fields, frame: str) -> Make | None:
    inner = ("transform",) if "transform" in fields else ()
    about = _fields(fields["transform"]) if inner else fields
    parents = ("parent_frame_id",), ("header", "frame_id")
    parent = _first(fields, parents, _is_text)
    if parent is None or not _is_text(fields.get("child_frame_id")):
        return None
    if not _has_numbers(about.get("translation"), "xyz"):
        return None
    if not _has_numbers(about.get("rotation"), "xyzw"):
        return None
    header = _header(fields, frame)

    def make(message: Any) -> dict[str, Any]:
        moved = _get(message, inner)
        return {
            "timestamp": header(message)["timestamp"],
            "parent_frame_id": _get(message, parent),
            "child_frame_id": message["child_frame_id"],
            "translation": {name: moved["translation"][name] for name in "xyz"},
            "rotation": {name: moved["rotation"][name] for name in "xyzw"},
        }

    return make


_KINDS: dict[str, Callable[[Fields, str], Make | None]] = {
    "RawImage": _raw_image,
    "CompressedImage": _compressed_image,
    "LaserScan": _laser_scan,
    "PointCloud": _point_cloud,
    "Grid": _grid,
    "FrameTransforms": _transforms,
}
