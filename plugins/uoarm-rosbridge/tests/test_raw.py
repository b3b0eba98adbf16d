"""What `cbor-raw` brings: octets as ROS 1 and ROS 2 serialise them, read by the types of rosapi."""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from played import TALK, Played, asked, bridge_to, typedef
from ros import Serve, url
from tests.server.robot import script  # type: ignore[import-not-found]
from uoarm_rosbridge.client._channels import raw_reader
from uoarm_rosbridge.client._types import RosType, read_types, reader, structure_of
from websockets.sync.server import ServerConnection

from uoarm.cdr import Codec
from uoarm.errors import MessageError
from uoarm.model import Budget, Endpoint, Role
from uoarm.server.front_end import write_binary
from uoarm.testing import Collector

MOST = Budget(elements=1000)

INNER = typedef("x_msgs/Inner", small=("int16", -1), name=("string", -1))
FIELDS: dict[str, tuple[str, int]] = {
    "flag": ("bool", -1), "wide": ("float64", -1), "letter": ("uint8", -1), "text": ("string", -1),
    "long": ("int64", -1), "pixels": ("uint8", 0), "numbers": ("float32", 0), "three": ("int32", 3),
    "texts": ("string", 0), "inner": ("x_msgs/Inner", -1), "inners": ("x_msgs/Inner", 0),
    "flags": ("bool", 2), "last": ("uint16", -1),
}  # fmt: skip
ONE = read_types("x_msgs/All", [typedef("x_msgs/All", **FIELDS), INNER])
TWO = read_types("x_msgs/msg/All", [typedef("x_msgs/All", **FIELDS), INNER])
VALUE: dict[str, Any] = {
    "flag": True, "wide": 0.5, "letter": 7, "text": "Kia ora ä", "long": -5, "pixels": b"\0\xff\1",
    "numbers": [0.5, 1.5], "three": [1, 2, 3], "texts": ["a", ""],
    "inner": {"small": -2, "name": "in"}, "inners": [{"small": 1, "name": "x"}] * 2,
    "flags": [True, False], "last": 65535,
}  # fmt: skip


def packed(value: dict[str, Any]) -> bytes:
    """Return a message as ROS 1 has it, by hand."""

    def text(given: str) -> bytes:
        octets = given.encode()
        return struct.pack("<I", len(octets)) + octets

    def inner(given: dict[str, Any]) -> bytes:
        return struct.pack("<h", given["small"]) + text(given["name"])

    pixels, numbers = value["pixels"], value["numbers"]
    return b"".join(
        (
            struct.pack("<?dB", value["flag"], value["wide"], value["letter"]),
            text(value["text"]),
            struct.pack("<q", value["long"]),
            struct.pack("<I", len(pixels)),
            pixels,
            struct.pack(f"<I{len(numbers)}f", len(numbers), *numbers),
            struct.pack("<3i", *value["three"]),
            struct.pack("<I", len(value["texts"])),
            *map(text, value["texts"]),
            inner(value["inner"]),
            struct.pack("<I", len(value["inners"])),
            *map(inner, value["inners"]),
            struct.pack("<2?H", *value["flags"], value["last"]),
        )
    )


def framed(octets: bytes) -> dict[str, object]:
    return {"secs": 1, "nsecs": 2, "bytes": octets}


def listed(message: Any) -> Any:
    if isinstance(message, dict):
        return {name: listed(item) for name, item in message.items()}
    return message.tolist() if isinstance(message, np.ndarray) else message


def test_a_message_of_ros_1_is_read() -> None:
    assert listed(raw_reader(ONE, MOST)(framed(packed(VALUE)))) == VALUE


def test_a_message_of_ros_2_is_read_in_either_order_of_octets() -> None:
    """What this repository writes for its own clients was compared with Fast CDR."""
    octets = Codec(structure_of(TWO)).encode(VALUE)
    assert listed(raw_reader(TWO, MOST)(framed(octets))) == VALUE
    number = read_types("x_msgs/msg/N", [typedef("x_msgs/N", a=("uint8", -1), b=("float64", -1))])
    big = b"\0\0\0\0" + struct.pack(">B7xd", 1, 2.5)
    assert raw_reader(number, MOST)(framed(big)) == {"a": 1, "b": 2.5}


def test_a_wide_text_has_characters_of_four_octets() -> None:
    wide = read_types("x_msgs/msg/W", [typedef("x_msgs/W", text=("wstring", -1))])
    octets = b"\0\1\0\0" + struct.pack(
        "<I3I", 3, ord("ä"), *struct.unpack("<2H", "😀".encode("utf-16-le"))
    )
    assert raw_reader(wide, MOST)(framed(octets)) == {"text": "ä😀"}


@pytest.mark.parametrize(
    ("made", "octets", "why"),
    [
        (ONE, packed(VALUE)[:-1], "cannot be read"),
        (ONE, packed(VALUE) + b"x", "were expected"),
        (ONE, struct.pack("<?dBI", 1, 0.5, 1, 2**31), "cut short"),
        (TWO, b"\0\3\0\0", "is no header of plain CDR"),
        (TWO, b"\0", "is no header of plain CDR"),
    ],
)
def test_what_is_none_is_refused_in_words(made: RosType, octets: bytes, why: str) -> None:
    with pytest.raises(MessageError, match=why):
        raw_reader(made, MOST)(framed(octets))


@pytest.mark.parametrize("came", [None, {}, {"bytes": "x"}, [1], {"data": 1}])
def test_what_is_no_frame_is_refused(came: object) -> None:
    with pytest.raises(MessageError, match="expected the octets"):
        raw_reader(ONE, MOST)(came)


def test_lists_have_a_budget_before_they_are_made() -> None:
    empty = typedef("x_msgs/Empty")
    many = read_types("x_msgs/Many", [typedef("x_msgs/Many", all=("x_msgs/Empty", 0)), empty])
    with pytest.raises(MessageError, match="more elements than are allowed"):
        raw_reader(many, MOST)(framed(struct.pack("<I", 2**32 - 1)))
    texts = read_types("x_msgs/Texts", [typedef("x_msgs/Texts", all=("string", 0))])
    octets = struct.pack("<I", MOST.elements + 1) + bytes(4 * (MOST.elements + 1))
    with pytest.raises(MessageError, match="more elements than are allowed"):
        raw_reader(texts, MOST)(framed(octets))


@given(st.binary(max_size=200), st.sampled_from([ONE, TWO]), st.booleans())
def test_random_octets_are_read_or_refused_and_nothing_else(
    octets: bytes, made: RosType, head: bool
) -> None:
    try:
        raw_reader(made, MOST)(framed((b"\0\1\0\0" if head else b"") + octets))
    except MessageError:
        return


@given(st.integers(0, 120), st.binary(min_size=1, max_size=8))
def test_a_message_with_octets_of_another_is_read_or_refused(at: int, noise: bytes) -> None:
    octets = bytearray(packed(VALUE))
    octets[at : at + len(noise)] = noise
    try:
        raw_reader(ONE, MOST)(framed(bytes(octets)))
    except MessageError:
        return


def test_a_picture_comes_as_its_endpoint_asks(played: Played) -> None:
    raw, plain = Collector(), Collector()
    source = Endpoint("far", "raw", Role.OUTPUT, ("/chatter",), options={"compression": "cbor-raw"})
    text = struct.pack("<I", 7) + b"Kia ora"

    def on(socket: ServerConnection, fields: Any) -> None:
        if fields["op"] == "subscribe":
            assert fields["compression"] == "cbor-raw"
            message = {"op": "publish", "topic": "/chatter", "msg": framed(text)}
            socket.send(write_binary(message))

    played.on = on
    with bridge_to(played.url) as bridge:
        made = bridge.describe(source).message
        assert made is not None
        bridge.open_source(source, made, raw.deliver)
        assert raw.wait(1) == [{"data": "Kia ora"}]
        # A server sends a topic to a client in one form: another source takes what that one has.
        bridge.open_source(TALK, made, plain.deliver)
        message = {"op": "publish", "topic": "/chatter", "msg": framed(text)}
        played.sockets[-1].send(write_binary(message))
        assert plain.wait(1) == [{"data": "Kia ora"}]


@pytest.mark.parametrize(
    ("name", "fields", "wanted"),
    [
        ("x_msgs/msg/T", {"a": ("double", 0), "b": ("octet", -1)}, "none"),
        ("x_msgs/T", {"a": ("float64", 0), "b": ("byte", -1), "c": ("time", -1)}, "cbor"),
        ("x_msgs/msg/T", {"a": ("double", 9)}, "none"),  # of NavSatFix, Imu and Odometry
        ("x_msgs/T", {"a": ("float64", 9)}, "none"),
        ("x_msgs/T", {"a": ("uint8", 16)}, "none"),
        ("x_msgs/T", {"a": ("duration", 0)}, "none"),
        ("x_msgs/msg/T", {"a": ("wstring", -1)}, "none"),
        ("x_msgs/msg/T", {"a": ("x_msgs/Inner", 2), "b": ("string", 0)}, "cbor"),
        ("x_msgs/msg/T", {"a": ("x_msgs/Fixed", 0)}, "none"),
    ],
)
def test_what_rosbridge_suite_does_not_write_as_cbor_is_asked_for_as_json(
    played: Played, name: str, fields: dict[str, tuple[str, int]], wanted: str
) -> None:
    """It sends nothing of such a type, and does not say so."""
    fixed = typedef("x_msgs/Fixed", a=("float", 2))
    played.answers["topic_type"] = {"type": name}
    played.answers["message_details"] = {"typedefs": [typedef("x_msgs/T", **fields), INNER, fixed]}
    with bridge_to(played.url) as bridge:
        made = bridge.describe(TALK).message
        assert made is not None
        bridge.open_source(TALK, made, print)
    assert [fields["compression"] for fields in asked(played, "subscribe")] == [wanted]


def test_large_integers_beside_small_ones_are_integers() -> None:
    made = read_types("x_msgs/U", [typedef("x_msgs/U", a=("uint64", 0))])
    message: Any = reader(made)({"a": [0, 2**64 - 1, 2**53 + 1]})
    assert message["a"].tolist() == [0, 2**64 - 1, 2**53 + 1]
    for wrong in ([-1, 2**64 - 1], [2**64], [0.5]):
        with pytest.raises(MessageError, match="uint64"):
            reader(made)({"a": wrong})


def test_a_function_of_our_own_server_comes_raw(serve: Serve) -> None:
    collector = Collector()
    source = Endpoint("far", "picture", Role.OUTPUT, ("/uoarm/picture",))
    pixels = bytes(range(256)) * 100
    with bridge_to(url(serve()), compression="cbor-raw") as bridge:
        made = bridge.describe(source).message
        assert made is not None
        bridge.open_source(source, made, collector.deliver)
        script.put({"width": 256, "data": pixels})
        assert collector.wait(1) == [{"width": 256, "data": pixels}]


def test_not_a_number_stays_what_it_is() -> None:
    made = read_types("x_msgs/F", [typedef("x_msgs/F", a=("float32", -1), b=("float64", -1))])
    message: Any = raw_reader(made, MOST)(framed(struct.pack("<fd", math.nan, math.inf)))
    assert math.isnan(message["a"])
    assert message["b"] == math.inf
