"""Serialised messages are read as rclpy reads them, and written as it writes them."""

from __future__ import annotations

import struct
from array import array
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from messages import MESSAGE_TYPES, messages_of, plain, same
from rclpy.serialization import deserialize_message, serialize_message
from uoarm_ros2._conversion import reader, writer
from uoarm_ros2._schema import structure_of
from uoarm_ros2._types import RecordType, import_type, shape_of

from uoarm.cdr import Codec
from uoarm.errors import MessageError

TYPES = [
    *MESSAGE_TYPES,
    "test_msgs/msg/MultiNested",
    "nav_msgs/msg/Odometry",
    "sensor_msgs/msg/Imu",
]


def record(name: str) -> RecordType:
    return shape_of(import_type(name), name)


def codec(name: str) -> Codec:
    return Codec(structure_of(record(name)))


def kinds(value: Any) -> Any:
    """The types of everything in a message; buffers of numbers are of one type."""
    if isinstance(value, bytes | array | memoryview | np.ndarray):
        return memoryview
    if isinstance(value, dict):
        return {key: kinds(item) for key, item in value.items()}
    return [kinds(item) for item in value] if isinstance(value, list) else type(value)


@pytest.mark.parametrize("name", MESSAGE_TYPES)
@settings(max_examples=10, suppress_health_check=[HealthCheck.data_too_large, HealthCheck.too_slow])
@given(data=st.data())
def test_what_rclpy_serialises_is_read(name: str, data: st.DataObject) -> None:
    shape = record(name)
    message = data.draw(messages_of(shape))
    octets = bytes(serialize_message(writer(shape)(message)))
    assert same(codec(name).decode(octets), message)


@pytest.mark.parametrize("name", MESSAGE_TYPES)
@settings(max_examples=10, suppress_health_check=[HealthCheck.data_too_large, HealthCheck.too_slow])
@given(data=st.data())
def test_rclpy_reads_what_is_serialised(name: str, data: st.DataObject) -> None:
    shape = record(name)
    message = data.draw(messages_of(shape))
    octets = codec(name).encode(message)
    native: Any = deserialize_message(octets, shape.native)
    assert same(reader(shape)(native), message)


@pytest.mark.parametrize("name", TYPES)
def test_a_message_has_the_kinds_of_value_that_reading_by_rclpy_gives(name: str) -> None:
    shape = record(name)
    native: Any = shape.native()
    read, wanted = codec(name).decode(bytes(serialize_message(native))), reader(shape)(native)
    assert same(read, plain(wanted))
    assert kinds(read) == kinds(wanted)


def test_numbers_of_the_other_byte_order_are_read() -> None:
    values = [float(number) for number in range(7 + 36)]
    octets = b"\0\0\0\0" + struct.pack(">43d", *values)
    message: Any = codec("geometry_msgs/msg/PoseWithCovariance").decode(octets)
    assert message["pose"]["position"] == {"x": 0.0, "y": 1.0, "z": 2.0}
    assert message["covariance"].tolist() == values[7:]
    assert message["covariance"].dtype.isnative


@pytest.mark.parametrize(
    "name",
    ["test_msgs/msg/UnboundedSequences", "test_msgs/msg/Nested", "sensor_msgs/msg/Imu"],
)
def test_what_is_cut_short_is_refused_wherever_it_is_cut(name: str) -> None:
    octets = codec(name).encode(reader(record(name))(record(name).native()))
    for end in range(4, len(octets)):
        with pytest.raises(MessageError, match=r"cut short|cannot be read"):
            codec(name).decode(octets[:end])


def test_a_count_that_no_message_of_this_size_has_is_refused_before_work() -> None:
    octets = b"\0\1\0\0" + b"\xff" * 64
    with pytest.raises(MessageError, match="4,294,967,295 octets should follow"):
        codec("test_msgs/msg/UnboundedSequences").decode(octets)
