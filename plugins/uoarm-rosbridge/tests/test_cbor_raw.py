"""`compression: cbor-raw`: messages of any framework, serialised as ROS 2 serialises them.

That ROS 2 itself reads them is shown by the tests of uoarm-ros2.
"""

from __future__ import annotations

import json
import struct
import sys
import time
from array import array
from typing import Any

import pytest
from components import script
from ros import Enter, opened

from uoarm import RobotManager
from uoarm.cdr import serialiser
from uoarm.errors import MessageError
from uoarm.model import MessageStructure, from_json, to_json

HEADER = b"\0\1\0\0" if sys.byteorder == "little" else b"\0\0\0\0"
BYTE = {"type": "integer", "minimum": 0, "maximum": 255}


def structure(**fields: object) -> MessageStructure:
    closed = {"required": list(fields), "additionalProperties": False}
    return MessageStructure({"type": "object", "properties": fields, **closed})


def numbers(native: str, **more: object) -> dict[str, object]:
    kind = "number" if native.startswith("float") else "integer"
    return {"type": "array", "items": {"type": kind, "x-native-type": native}, **more}


def test_a_plain_python_picture_serialised(enter: Enter, robot: RobotManager) -> None:
    client = enter()
    before = time.time()
    client.send(op="subscribe", topic="/uoarm/picture", compression="cbor-raw")
    opened(robot, 1)
    for data in (b"\1\2\3", bytes(5000), bytes(200_000)):
        script.put({"width": -2, "data": data})
    small, *large = client.messages(3)
    assert small["bytes"] == HEADER + struct.pack("=qI3B", -2, 3, 1, 2, 3)
    for report, size in zip(large, (5000, 200_000), strict=True):
        assert report["bytes"] == HEADER + struct.pack("=qI", -2, size) + bytes(size)
    assert before - 1 <= small["secs"] + small["nsecs"] / 1e9 <= time.time() + 1
    assert set(small) == {"secs", "nsecs", "bytes"}


def test_clients_of_every_compression_beside_one_another(enter: Enter, robot: RobotManager) -> None:
    clients = {form: enter() for form in ("none", "cbor", "cbor-raw")}
    for form, client in clients.items():
        client.send(op="subscribe", topic="/uoarm/picture", compression=form)
        client.call("/rosapi/has_param", {"name": "x"})
    opened(robot, 1)
    script.put({"width": 1, "data": b"\7"})
    got = {form: client.messages(1)[0] for form, client in clients.items()}
    assert got["none"] == {"width": 1, "data": "Bw=="}
    assert got["cbor"] == {"width": 1, "data": b"\7"}
    assert got["cbor-raw"]["bytes"][-1:] == b"\7"


@pytest.mark.parametrize(
    ("topic", "said"),
    [
        ("/uoarm/navigate/feedback", "has no fixed layout (fields may be absent or added)"),
        ("/between/clients", "messages between clients have no stated structure"),
    ],
)
def test_what_has_no_layout_is_refused_and_nothing_stays_open(
    enter: Enter, robot: RobotManager, topic: str, said: str
) -> None:
    client = enter()
    text = client.refused(op="subscribe", id="s", topic=topic, compression="cbor-raw")
    assert said in text
    assert "ask for cbor instead of cbor-raw" in text
    opened(robot, 0)
    client.send(op="subscribe", topic=topic, compression="cbor")
    if topic.startswith("/uoarm"):
        opened(robot, 1)


def test_a_message_that_does_not_fit_is_reported_once(enter: Enter, robot: RobotManager) -> None:
    client = enter()
    client.send(op="subscribe", topic="/uoarm/numbers", compression="cbor-raw")
    opened(robot, 1)
    script.put({"value": "lie"}, {"value": "lie"}, {"other": 1}, {"value": 2**70}, {"value": 5})
    reports: list[Any] = []
    while not reports or reports[-1]["op"] == "status":
        reports.append(client.receive())
    assert all("does not fit its structure" in report["msg"] for report in reports[:-1])
    assert reports[-1]["msg"]["bytes"] == HEADER + struct.pack("=q", 5)


def test_alignment_is_counted_from_after_the_header() -> None:
    kinds = {
        "flag": {"type": "boolean"},
        "wide": {"type": "number"},
        "text": {"type": "string"},
        "short": {"type": "integer", "x-native-type": "int16"},
        "many": numbers("float64"),
        "none": numbers("float64"),
        "last": BYTE,
    }
    message = {
        "flag": True, "wide": 0.5, "text": "é", "short": -2, "many": [1.5], "none": [], "last": 9,
    }  # fmt: skip
    expected = struct.pack("=?7xd", True, 0.5)
    expected += struct.pack("=I3sxhxx", 3, b"\xc3\xa9\0", -2)
    expected += struct.pack("=IdIB", 1, 1.5, 0, 9)
    assert b"".join(serialiser(structure(**kinds))(message)) == HEADER + expected


def test_what_is_packed_together_is_aligned_as_one_by_one() -> None:
    """Across records, after what has no fixed length, and after arrays that have one."""
    wide, short = {"type": "number"}, {"type": "integer", "x-native-type": "int16"}
    pair = structure(short=short, wide=wide).schema
    kinds = {
        "first": BYTE,
        "pair": pair,
        "nothing": structure().schema,
        "both": numbers("int16", minItems=2, maxItems=2),
        "behind": wide,
        "pairs": {"type": "array", "items": pair},
        'it\'s "{0}"\n': short,
    }
    two = {"short": 2, "wide": 2.5}
    message = {
        "first": 1, "pair": two, "nothing": {}, "both": [3, 4], "behind": 6.5,
        "pairs": [two, two], "it's \"{0}\"\n": 7,
    }  # fmt: skip
    expected = struct.pack("=Bxh4xd", 1, 2, 2.5) + struct.pack("=Bx2hxxd", 0, 3, 4, 6.5)
    expected += struct.pack("=Ihxxdh6xdh", 2, 2, 2.5, 2, 2.5, 7)
    assert b"".join(serialiser(structure(**kinds))(message)) == HEADER + expected


def test_fields_keep_their_order_on_the_way_from_a_host() -> None:
    made = structure(zebra=BYTE, ape={"type": "boolean"})
    sent = json.dumps(to_json(made))
    back = from_json(json.loads(sent), MessageStructure)
    assert b"".join(serialiser(back)({"ape": True, "zebra": 7})) == HEADER + b"\7\1"


@pytest.mark.parametrize(
    "given",
    [
        [1, 2, 3],
        (1, 2, 3),
        array("i", [1, 2, 3]),
        array("q", [1, 2, 3]),
        array("I", [1, 2, 3]),
        memoryview(array("i", [1, 9, 2, 9, 3, 9]))[::2],
        b"\1\2\3",
    ],
    ids=["list", "tuple", "same", "wider", "unsigned", "strided", "octets"],
)
def test_numbers_come_in_any_buffer(given: object) -> None:
    serialise = serialiser(structure(values=numbers("int32")))
    assert b"".join(serialise({"values": given})) == HEADER + struct.pack("=I3i", 3, 1, 2, 3)


def test_long_arrays_are_not_copied_and_what_follows_is_aligned() -> None:
    kinds = {
        "flag": {"type": "boolean"},
        "pixels": {"type": "array", "items": BYTE},
        "wide": {"type": "number"},
        "points": numbers("float64"),
        "last": numbers("int32"),
    }
    pixels, points = bytearray(100_001), array("d", [0.5] * 10_000)
    message = {"flag": True, "pixels": pixels, "wide": 1.5, "points": points, "last": [7]}
    parts = serialiser(structure(**kinds))(message)
    expected = struct.pack("=?3xI", True, 100_001) + bytes(100_001) + bytes(7)
    expected += struct.pack("=dI4x", 1.5, 10_000) + points.tobytes() + struct.pack("=Ii", 1, 7)
    assert b"".join(parts) == HEADER + expected
    whose = [part.obj for part in parts if isinstance(part, memoryview)]
    assert all(buffer is given for buffer, given in zip(whose, (pixels, points), strict=True))


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        (numbers("int8"), [200]),
        (numbers("int32"), "123"),
        (numbers("uint16", minItems=2, maxItems=2), [1]),
        (numbers("float32"), ["1.5"]),
        ({"type": "string"}, 5),
        ({"type": "string"}, "\ud800"),
        ({"type": "array", "items": {"type": "string"}}, None),
        (BYTE, 256),
        (BYTE, 1.5),
    ],
)
def test_what_does_not_fit_is_never_wrapped(kind: dict[str, object], value: object) -> None:
    with pytest.raises(MessageError, match="does not fit"):
        serialiser(structure(value=kind))({"value": value})


def nested(depth: int) -> MessageStructure:
    made = structure(value=BYTE)
    for _ in range(depth):
        made = structure(value=made.schema)
    return made


@pytest.mark.parametrize(
    ("schema", "said"),
    [
        (True, "the message has no fixed layout"),
        ({"type": "array", "items": BYTE}, "no single type"),
        ({"oneOf": [{"type": "object"}]}, "no single type"),
        (structure(x=True).schema, r"message\.x has no fixed"),
        (structure(x={"type": ["string", "null"]}).schema, r"message\.x has no fixed"),
        (structure(x={"type": "array"}).schema, "no single type that ROS has"),
        (structure(x={"type": "array", "items": numbers("int8")}).schema, "elements"),
        (structure(x={"type": "array", "prefixItems": [BYTE], "items": BYTE}).schema, "elements"),
        ({**nested(1).schema, "required": []}, "absent or added"),  # type: ignore[dict-item] # a mapping
        (nested(70).schema, "has no fixed layout"),
    ],
)
def test_a_structure_without_a_layout_is_named(schema: Any, said: str) -> None:
    with pytest.raises(MessageError, match=said):
        serialiser(MessageStructure(schema))
