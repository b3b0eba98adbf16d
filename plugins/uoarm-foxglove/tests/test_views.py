"""What viewers draw: of structures that say what they are, in types that viewers know."""

from __future__ import annotations

import math
import struct
from array import array
from typing import Any

import pytest
from components import shown_script
from tests.hostile import misbehaviour  # type: ignore[import-not-found]
from uoarm_foxglove._views import view_of
from viewer import Serve, Viewer

from uoarm.cdr import RosDefinition, deserialiser, structure_of_definition
from uoarm.errors import MessageError
from uoarm.model import MessageStructure

NUMBER, INTEGER, TEXT = {"type": "number"}, {"type": "integer"}, {"type": "string"}
OCTETS = {"type": "array", "items": INTEGER, "x-octets": True}
NUMBERS = {"type": "array", "items": NUMBER}
STAMP = {"sec": 7, "nanosec": 8}


def some(**fields: Any) -> Any:
    return {"type": "object", "properties": fields}


XYZ = some(x=NUMBER, y=NUMBER, z=NUMBER)
HEADER = some(stamp=some(sec=INTEGER, nanosec=INTEGER), frame_id=TEXT)
CAMERA_IMAGE = some(  # of OpenRTM
    tm=some(sec=INTEGER, nsec=INTEGER), width=INTEGER, height=INTEGER, bpp=INTEGER, format=TEXT,
    fDiv=NUMBER, pixels=OCTETS,
)  # fmt: skip
RANGE_DATA = some(
    tm=some(sec=INTEGER, nsec=INTEGER),
    ranges=NUMBERS,
    config=some(minAngle=NUMBER, maxAngle=NUMBER, angularRes=NUMBER),
)
TRANSFORM = some(
    header=HEADER,
    child_frame_id=TEXT,
    transform=some(translation=XYZ, rotation=some(x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER)),
)
POINT = {"x": 1.0, "y": 2.0, "z": 3.0}
MOVED = {"translation": POINT, "rotation": {**POINT, "w": 4.0}}
TRANSFORMED: Any = {
    "header": {"stamp": STAMP, "frame_id": "map"},
    "child_frame_id": "base",
    "transform": MOVED,
}


def drawn(schema: Any, message: Any, **structure: Any) -> tuple[str, Any]:
    """Return the type that viewers are shown, and what they read of a message."""
    codec = view_of(MessageStructure(schema, **structure), "eye")
    assert codec is not None
    assert (codec.encoding, codec.schema_encoding) == ("cdr", "ros2msg")
    read = structure_of_definition(RosDefinition(codec.schema_name, codec.schema))
    return codec.schema_name, deserialiser(read)(codec.write(message))


@pytest.mark.parametrize(
    ("schema", "message"),
    [
        (
            some(width=INTEGER, height=INTEGER, step=INTEGER, encoding=TEXT, data=OCTETS),
            {"width": 1, "height": 1, "step": 3, "encoding": "rgb8", "data": b"rgb"},
        ),
        (some(format=TEXT, data=OCTETS), {"format": "png", "data": b"abc"}),
        (
            some(ranges=NUMBERS, angle_min=NUMBER, angle_max=NUMBER, intensities=NUMBERS),
            {"ranges": [1.0], "angle_min": 0.0, "angle_max": 1.0, "intensities": [1.0]},
        ),
        (some(points={"type": "array", "items": XYZ}), {"points": [POINT]}),
        (TRANSFORM, TRANSFORMED),
    ],
)
def test_what_a_value_does_itself_is_a_refusal(schema: Any, message: Any) -> None:
    codec = view_of(MessageStructure(schema), "eye")
    assert codec is not None
    write = codec.write
    assert write(message)
    assert not misbehaviour(write)
    for name in message:
        assert not misbehaviour(lambda value, name=name: write({**message, name: value}))
    if "points" in message:
        assert not misbehaviour(lambda value: write({"points": [{**POINT, "x": value}]}))


def test_a_picture_of_pixels_is_a_raw_image() -> None:
    message = {"tm": {"sec": 1, "nsec": 2}, "width": 2, "height": 2, "bpp": 24, "format": "",
               "fDiv": 1.0, "pixels": bytes(range(12))}  # fmt: skip
    assert drawn(CAMERA_IMAGE, message) == (
        "foxglove_msgs/msg/RawImage",
        {"timestamp": {"sec": 1, "nanosec": 2}, "frame_id": "eye", "width": 2, "height": 2,
         "encoding": "bgr8", "step": 6, "data": bytes(range(12))},
    )  # fmt: skip


def test_pixels_that_are_too_few_are_none() -> None:
    codec = view_of(MessageStructure(CAMERA_IMAGE), "eye")
    assert codec is not None
    wrong = {"tm": STAMP, "width": 9, "height": 2, "bpp": 24, "pixels": b"123"}
    with pytest.raises(MessageError, match="cannot be drawn as RawImage: ValueError: 3 octets"):
        codec.write(wrong)
    with pytest.raises(MessageError, match="cannot be drawn as RawImage: KeyError"):
        codec.write({})


@pytest.mark.parametrize(
    ("encoding", "octets"),
    [("mono8", 1), ("bayer_rggb8", 1), ("bayer_grbg16", 2), ("rgb8", 3), ("bgra8", 4), ("rgb16", 6),
     ("8UC3", 3), ("16UC1", 2), ("32FC1", 4), ("yuyv", 2)],
)  # fmt: skip
def test_pixels_have_the_octets_of_their_encoding(encoding: str, octets: int) -> None:
    schema = some(width=INTEGER, height=INTEGER, encoding=TEXT, data=OCTETS)
    message = {"width": 4, "height": 2, "encoding": encoding, "data": bytes(8 * octets)}
    assert drawn(schema, message)[1]["step"] == 4 * octets


def test_what_does_not_match_its_structure_is_left_out() -> None:
    schema = some(width=INTEGER, height=INTEGER, encoding=TEXT, data=OCTETS)
    codec = view_of(MessageStructure(schema), "eye")
    assert codec is not None
    with pytest.raises(MessageError, match="cannot be drawn as RawImage: TypeError"):
        codec.write({"width": 4, "height": 2, "encoding": 5, "data": b"12345678"})


@pytest.mark.parametrize(
    ("schema", "message", "kind"),
    [
        (some(format=TEXT, data=OCTETS), {"format": "bgr8; jpeg compressed", "data": b"1"}, "jpeg"),
        (some(format=TEXT, data=OCTETS), {"format": "JPG", "data": b"1"}, "jpeg"),
        (some(image={**OCTETS, "contentMediaType": "image/png"}), {"image": b"1"}, "png"),
        (some(jpeg=OCTETS, boxes=NUMBERS), {"jpeg": b"1", "boxes": []}, "jpeg"),
    ],
)
def test_a_compressed_picture_is_a_compressed_image(schema: Any, message: Any, kind: str) -> None:
    name, read = drawn(schema, message)
    assert name == "foxglove_msgs/msg/CompressedImage"
    assert (read["format"], read["data"]) == (kind, b"1")
    assert read["timestamp"]["sec"] > 1_700_000_000  # it has no time of its own: it is now


def test_ranges_and_angles_are_a_scan() -> None:
    config = {"minAngle": -1.0, "maxAngle": 1.0, "angularRes": 0.5}
    name, read = drawn(RANGE_DATA, {"tm": STAMP, "ranges": [1.0, 2.5], "config": config})
    assert name == "foxglove_msgs/msg/LaserScan"
    assert (read["start_angle"], read["end_angle"], [*read["ranges"]]) == (-1.0, 1.0, [1.0, 2.5])
    assert (read["pose"]["orientation"]["w"], [*read["intensities"]]) == (1.0, [])
    degrees = {"type": "number", "x-unit": "deg"}
    schema = some(ranges=NUMBERS, angle_min=degrees, angle_max=degrees, intensities=NUMBERS)
    message = {"ranges": [1.0], "angle_min": -90.0, "angle_max": 90.0, "intensities": [7.0]}
    _, read = drawn(schema, message)
    assert read["end_angle"] == pytest.approx(math.pi / 2)
    assert [*read["intensities"]] == [7.0]


@pytest.mark.parametrize("inner", [False, True])
def test_points_are_a_cloud(inner: bool) -> None:
    item = some(point=XYZ, colour=XYZ) if inner else XYZ
    points = [{"point": POINT, "colour": POINT}] if inner else [POINT]
    name, read = drawn(some(points={"type": "array", "items": item}), {"points": points})
    assert name == "foxglove_msgs/msg/PointCloud"
    assert struct.unpack("<ddd", read["data"]) == (1.0, 2.0, 3.0)
    assert [(field["name"], field["offset"], field["type"]) for field in read["fields"]] == [
        ("x", 0, 8), ("y", 8, 8), ("z", 16, 8),
    ]  # fmt: skip


def test_cells_are_a_grid() -> None:
    cells = {"type": "array", "items": INTEGER}
    about = some(width=INTEGER, height=INTEGER, resolution=NUMBER)
    message = {"info": {"width": 2, "height": 2, "resolution": 0.5}, "data": [-1, 0, 50, 100]}
    name, read = drawn(some(info=about, data=cells), message)
    assert name == "foxglove_msgs/msg/Grid"
    assert (read["column_count"], read["cell_size"]) == (2, {"x": 0.5, "y": 0.5})
    assert (read["fields"][0]["type"], read["data"]) == (2, b"\xff\0\x32\x64")


def test_octets_in_an_array_are_cells_of_a_grid() -> None:
    schema = some(width=INTEGER, height=INTEGER, resolution=NUMBER, data=OCTETS)
    cells = array("B", [0, 1, 2, 255])
    _, read = drawn(schema, {"width": 2, "height": 2, "resolution": 0.5, "data": cells})
    assert (read["fields"][0]["type"], read["data"]) == (1, b"\0\1\2\xff")


@pytest.mark.parametrize("many", [False, True])
def test_transforms_are_transforms(many: bool) -> None:
    schema = some(transforms={"type": "array", "items": TRANSFORM}) if many else TRANSFORM
    name, read = drawn(schema, {"transforms": [TRANSFORMED]} if many else TRANSFORMED)
    assert name == "foxglove_msgs/msg/FrameTransforms"
    assert read["transforms"] == [
        {"timestamp": STAMP, "parent_frame_id": "map", "child_frame_id": "base", **MOVED}
    ]


def test_what_stands_further_in_is_found() -> None:
    schema = some(tm=TEXT, data=some(image=CAMERA_IMAGE))
    picture = {"tm": STAMP, "width": 1, "height": 1, "bpp": 8, "format": "", "pixels": b"1"}
    name, read = drawn(schema, {"data": {"image": picture}})
    assert (name, read["encoding"]) == ("foxglove_msgs/msg/RawImage", "mono8")


@pytest.mark.parametrize(
    "structure",
    [
        MessageStructure(True),
        MessageStructure(some(data=OCTETS)),
        MessageStructure(some(width=INTEGER, height=INTEGER, data=OCTETS)),
        MessageStructure(some(ranges=NUMBERS)),
        MessageStructure(some(points={"type": "array", "items": some(x=NUMBER, y=NUMBER)})),
        MessageStructure(some(format=TEXT, data=OCTETS), native_type="sensor_msgs/msg/X"),
    ],
)
def test_what_does_not_say_what_it_is_has_no_view(structure: MessageStructure) -> None:
    assert view_of(structure, "eye") is None


def test_other_readers_of_ros_read_the_definitions() -> None:
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    for schema, message in (
        (some(format=TEXT, data=OCTETS), {"format": "png", "data": b"abc"}),
        (some(points={"type": "array", "items": XYZ}), {"points": [POINT]}),
        (TRANSFORM, TRANSFORMED),
    ):
        codec = view_of(MessageStructure(schema), "eye")
        assert codec is not None
        types = typesys.get_types_from_msg(codec.schema, codec.schema_name)
        store.register({name: kind for name, kind in types.items() if name not in store.types})
        read = store.deserialize_cdr(codec.write(message), codec.schema_name)
        assert type(read).__name__.endswith(codec.schema_name.rpartition("/")[2])


def test_a_view_is_a_channel_beside_that_of_the_messages(serve: Serve) -> None:
    with Viewer(serve()) as viewer:
        assert viewer.channel("/shown")["schemaName"] == "uoarm/msg/Shown"
        assert viewer.channel("/shown/view")["schemaName"] == "foxglove_msgs/msg/CompressedImage"
        viewer.subscribe("/shown/view", 3)
        shown_script.put({"format": "png", "data": b"\x89PNG"})
        read = viewer.until(1)
        assert read["subscription"] == 3
        assert b"\x89PNG" in read["data"]
        shown_script.put({"format": "tar", "data": b"x"})
        assert "no picture" in viewer.until("status")["message"]
        viewer.send("subscribeConnectionGraph")
        graph = viewer.until("connectionGraphUpdate")
        assert {"name": "/shown/view", "publisherIds": ["shower"]} in graph["publishedTopics"]
