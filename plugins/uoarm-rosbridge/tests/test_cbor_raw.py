"""`compression: cbor-raw`: messages of any framework, serialised as ROS 2 serialises them.

That ROS 2 itself reads them is shown by the tests of uoarm-ros2.
"""

from __future__ import annotations

import struct
import sys
import time
from typing import Any

import pytest
from ros import Enter
from tests.server.robot import script  # type: ignore[import-not-found]
from tests.server.talk import opened  # type: ignore[import-not-found]

from uoarm import RobotManager
from uoarm.model import MessageStructure

HEADER = b"\0\1\0\0" if sys.byteorder == "little" else b"\0\0\0\0"


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
    assert all("$" in report["msg"] for report in reports[:-1])
    assert reports[-1]["msg"]["bytes"] == HEADER + struct.pack("=q", 5)
