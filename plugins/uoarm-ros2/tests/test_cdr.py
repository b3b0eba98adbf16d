"""Serialised messages are read as rclpy reads them, and written as it writes them."""

from __future__ import annotations

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
