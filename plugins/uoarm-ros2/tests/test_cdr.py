"""Serialised messages are read as rclpy reads them, and written as it writes them."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from messages import MESSAGE_TYPES, messages_of, plain, same
from rclpy.serialization import deserialize_message, serialize_message
from uoarm_ros2._cdr import cdr_reader, cdr_writer
from uoarm_ros2._conversion import reader, writer
from uoarm_ros2._types import RecordType, import_type, shape_of

from uoarm.errors import MessageError

TYPES = [
    *MESSAGE_TYPES,
    "test_msgs/msg/MultiNested",
    "nav_msgs/msg/Odometry",
    "sensor_msgs/msg/Imu",
]


def record(name: str) -> RecordType:
    return shape_of(import_type(name), name)


def kinds(value: Any) -> Any:
    """The types of everything in a message."""
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
    assert same(cdr_reader(shape)(octets), message)


@pytest.mark.parametrize("name", MESSAGE_TYPES)
@settings(max_examples=10, suppress_health_check=[HealthCheck.data_too_large, HealthCheck.too_slow])
@given(data=st.data())
def test_rclpy_reads_what_is_serialised(name: str, data: st.DataObject) -> None:
    shape = record(name)
    message = data.draw(messages_of(shape))
    octets = cdr_writer(shape)(writer(shape)(message))
    native: Any = deserialize_message(octets, shape.native)
    assert same(reader(shape)(native), message)


@pytest.mark.parametrize("name", TYPES)
def test_a_message_has_the_kinds_of_value_that_reading_by_rclpy_gives(name: str) -> None:
    shape = record(name)
    native: Any = shape.native()
    read, wanted = cdr_reader(shape)(bytes(serialize_message(native))), reader(shape)(native)
    assert same(read, plain(wanted))
    assert kinds(read) == kinds(wanted)


def test_numbers_of_the_other_byte_order_are_read() -> None:
    values = [float(number) for number in range(7 + 36)]
    octets = b"\0\0\0\0" + struct.pack(">43d", *values)
    message: Any = cdr_reader(record("geometry_msgs/msg/PoseWithCovariance"))(octets)
    assert message["pose"]["position"] == {"x": 0.0, "y": 1.0, "z": 2.0}
    assert message["covariance"].tolist() == values[7:]
    assert message["covariance"].dtype.isnative


@pytest.mark.parametrize(
    "name",
    ["test_msgs/msg/UnboundedSequences", "test_msgs/msg/Nested", "sensor_msgs/msg/Imu"],
)
def test_what_is_cut_short_is_refused_wherever_it_is_cut(name: str) -> None:
    shape = record(name)
    octets = cdr_writer(shape)(shape.native())
    for end in range(4, len(octets)):
        with pytest.raises(MessageError, match=r"cut short|cannot be read"):
            cdr_reader(shape)(octets[:end])


def test_a_count_that_no_message_of_this_size_has_is_refused_before_work() -> None:
    shape = record("test_msgs/msg/UnboundedSequences")
    octets = b"\0\1\0\0" + b"\xff" * 64
    with pytest.raises(MessageError, match="too many elements: 4294967295"):
        cdr_reader(shape)(octets)


def test_an_unknown_encoding_is_named() -> None:
    with pytest.raises(MessageError, match=r"unknown way, b'\\x00\\x07'"):
        cdr_reader(record("std_msgs/msg/Int64"))(b"\0\7\0\0" + bytes(8))
