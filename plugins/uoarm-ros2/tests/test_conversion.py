"""Every type of test_msgs goes out and comes back whole, and what does not fit is named."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from messages import MESSAGE_TYPES, attributes, default_of, messages_of, plain, same
from rosidl_parser.definition import Array, BasicType, BoundedSequence, BoundedWString
from uoarm_ros2._conversion import codec_of, reader, writer
from uoarm_ros2._types import RecordType, import_type, shape_of, type_hash

from uoarm.errors import BridgeError, FailureReason, MessageError


def record(name: str) -> RecordType:
    return shape_of(import_type(name), name)


@pytest.mark.parametrize("name", MESSAGE_TYPES)
@settings(suppress_health_check=[HealthCheck.data_too_large, HealthCheck.too_slow])
@given(data=st.data())
def test_ros_2_reads_what_is_written_and_writes_what_is_read(
    name: str, data: st.DataObject
) -> None:
    shape = record(name)
    message = data.draw(messages_of(shape))
    native = writer(shape)(message)
    assert same(attributes(native), message)
    assert same(reader(shape)(native), message)


@pytest.mark.parametrize("name", [*MESSAGE_TYPES, "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu"])
def test_the_defaults_of_a_type_are_what_its_class_makes(name: str) -> None:
    shape = record(name)
    made: object = shape.native()
    assert same(reader(shape)(made), plain(attributes(made)))


def test_arrays_of_types_that_hold_arrays_of_types_survive() -> None:
    shape = record("test_msgs/msg/MultiNested")
    whole = plain(default_of(shape.native))
    arrays = {**whole["array_of_arrays"][0], "int64_values": [2**63 - 1, -(2**63), 0]}
    arrays["string_values"] = ["\N{SNOWMAN}", "", "x" * 1000]
    bounded = {**whole["array_of_bounded_sequences"][0], "float32_values": [math.inf, -0.0]}
    message = {
        **whole,
        "array_of_arrays": [arrays] * 3,
        "unbounded_sequence_of_arrays": [arrays, whole["array_of_arrays"][1]],
        "bounded_sequence_of_bounded_sequences": [bounded],
    }
    native = writer(shape)(message)
    assert same(attributes(native), message)
    assert same(reader(shape)(native), message)


def test_integers_and_numpy_scalars_are_taken_for_what_they_are() -> None:
    shape = record("test_msgs/msg/BasicTypes")
    given_values = {
        **default_of(shape.native),
        "float64_value": 3,
        "int8_value": np.int64(-5),
        "uint8_value": 7.0,
        "bool_value": np.bool_(1),
    }
    read = reader(shape)(writer(shape)(given_values))
    assert (read["float64_value"], read["int8_value"], read["uint8_value"]) == (3.0, -5, 7)
    assert read["bool_value"] is True


@pytest.mark.parametrize(
    "octets", [b"\0\xff", bytearray(b"\0\xff"), memoryview(b"\0\xff"), [0, 255]]
)
@pytest.mark.parametrize("field", ["uint8_values", "byte_values", "char_values"])
def test_octets_come_in_every_form(field: str, octets: object) -> None:
    shape = record("test_msgs/msg/UnboundedSequences")
    native = writer(shape)({**default_of(shape.native), field: octets})
    assert bytes(reader(shape)(native)[field]) == b"\0\xff"


class Odd:
    """As rosidl makes it of an `.idl` file."""

    __slots__ = ("_cs", "_letter", "_o", "_two", "_w")
    SLOT_TYPES = (
        BasicType("char"),
        BasicType("octet"),
        BoundedWString(4),
        BoundedSequence(BasicType("char"), 3),
        Array(BasicType("char"), 2),
    )

    @staticmethod
    def get_fields_and_field_types() -> dict[str, str]:
        return dict.fromkeys(("letter", "o", "w", "cs", "two"), "")


def test_a_character_of_an_idl_file_is_an_octet_and_in_python_a_text(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of a number in its place the generated code ends the process."""
    shape = shape_of(Odd, "odd_msgs/msg/Odd")
    digits = "eb2d4676546eb03c06d7df30df594c1f1c472bb4cb2ee2df0d40873b63bee6df"
    assert type_hash(shape) == f"RIHS01_{digits}", "as rosidl has it"
    message = {"letter": 65, "o": 1, "w": "ab", "cs": b"B", "two": b"CD"}
    monkeypatch.setattr("uoarm_ros2._conversion.deserialised", lambda octets, _: octets)
    write: Any = writer(shape)
    assert codec_of(shape).decode(write(message)) == message
    for field, value in (("letter", 128), ("letter", "A"), ("cs", b"\x80"), ("two", [1, 2, 3])):
        with pytest.raises(MessageError, match=rf"odd_msgs/msg/Odd: \$\.{field}"):
            write({**message, field: value})


def test_lengths_are_kept() -> None:
    arrays = record("test_msgs/msg/Arrays")
    whole = default_of(arrays.native)
    for field, value in (("bool_values", [True]), ("int32_values", [1, 2, 3, 4])):
        with pytest.raises(MessageError, match=rf"\$\.{field}: expected 3 elements"):
            writer(arrays)({**whole, field: value})
    with pytest.raises(MessageError, match=r"\$\.basic_types_values: expected 3 elements, got 0"):
        writer(arrays)({**whole, "basic_types_values": []})
    bounded = record("test_msgs/msg/BoundedSequences")
    whole = default_of(bounded.native)
    with pytest.raises(MessageError, match=r"\$\.uint8_values: expected at most 3 elements"):
        writer(bounded)({**whole, "uint8_values": b"1234"})


def test_text_is_bounded_in_code_units_and_has_no_nul() -> None:
    shape = record("test_msgs/msg/Strings")
    whole = default_of(shape.native)
    for text, words in (
        ("x" * 23, "at most 22"),
        ("\N{SNOWMAN}" * 8, "at most 22"),
        ("a\0b", "NUL"),
        ("\ud800", "cannot be written as utf-8"),
        (b"bytes", "a string"),
    ):
        with pytest.raises(MessageError, match=rf"\$\.bounded_string_value: .*{words}"):
            writer(shape)({**whole, "bounded_string_value": text})


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("no_such_msgs/msg/Nothing", "install ros-<distribution>-no-such-msgs"),
        ("std_msgs/msg/Strung", "has no msg 'Strung'"),
    ],
)
def test_a_type_that_is_not_there_says_what_to_install(name: str, words: str) -> None:
    with pytest.raises(BridgeError, match=words) as caught:
        import_type(name)
    assert caught.value.reason is FailureReason.NOT_FOUND


def test_a_package_that_is_broken_is_as_one_that_is_not_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So that its types may come from a folder of definitions, or from nodes."""
    for folder in ("awry_msgs", "awry_msgs/msg"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "__init__.py").touch()
    (tmp_path / "awry_msgs/msg/__init__.py").write_text("self.from = 0\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(BridgeError, match=r"'awry_msgs.msg' is broken: SyntaxError: ") as caught:
        import_type("awry_msgs/msg/Edge")
    assert caught.value.reason is FailureReason.NOT_FOUND
