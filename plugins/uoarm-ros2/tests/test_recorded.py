"""What is recorded of ROS 2 are the octets that came, which its own tools read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from endpoints import INT64, Start
from mcap.reader import make_reader
from rclpy.serialization import serialize_message
from robots import robot
from std_msgs.msg import Int64

from uoarm.cdr import Codec
from uoarm.model import Message, QueuePolicy
from uoarm.testing import patience, wait

NUMBERS = f"""
  numbers:
    components:
      - {{name: numbers, bridge: ros, output: {{endpoint: [/numbers, {INT64}],
         options: {{qos: {{history: keep_all}}}}}}}}
"""


def test_the_octets_are_those_that_came(
    peer: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    encoded: list[Any] = []
    encode = Codec.encode

    def counted(codec: Codec, message: Message, *more: Any) -> bytes:
        encoded.append(message)
        return encode(codec, message, *more)

    talker, path = peer("talker"), tmp_path / "run.mcap"
    talker.do("advertise", topic="/numbers", history="keep_all")
    queue = QueuePolicy(length=1000, policy="block", timeout=patience())
    with (
        robot(NUMBERS) as manager,
        manager.record("numbers", path=path, queue=queue) as recording,
    ):
        monkeypatch.setattr(Codec, "encode", counted)
        talker.do("publish", topic="/numbers", count=100)
        wait(lambda: recording.status().channels[0].recorded == 100, "not all came")
    assert not encoded
    with path.open("rb") as file:
        found = [
            (schema.name, message.data)
            for schema, _, message in make_reader(file).iter_messages(topics="/numbers")
            if schema is not None
        ]
    assert found == [
        ("std_msgs/msg/Int64", serialize_message(Int64(data=n))) for n in range(1, 101)
    ]
    rosbags = pytest.importorskip("rosbags.highlevel")
    with rosbags.AnyReader([path]) as reader:
        connections = [item for item in reader.connections if item.topic == "/numbers"]
        read = [
            reader.deserialize(data, connection.msgtype).data
            for connection, _, data in reader.messages(connections)
        ]
    assert read == list(range(1, 101))
