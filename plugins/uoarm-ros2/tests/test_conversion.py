"""Every type of test_msgs goes out and comes back whole, and what does not fit is named."""

from __future__ import annotations

import math
from array import array
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from messages import MESSAGE_TYPES, messages_of, plain, same
from rclpy.serialization import deserialize_message, serialize_message
from rosidl_parser.definition import Array, BasicType, BoundedSequence, BoundedWString
from tests.hostile import misbehaviour  # type: ignore[import-not-found]
from uoarm_ros2._conversion import reader, writer
from uoarm_ros2._types import RecordType, import_type, shape_of, type_hash

from uoarm.errors import BridgeError, FailureReason, MessageError


def record(name: str) -> RecordType:
    return shape_of(import_type(name), name)


@pytest.mark.parametrize("name", MESSAGE_TYPES)
@settings(suppress_health_check=[HealthCheck.data_too_large, HealthCheck.too_slow])
@given(data=st.data())
def test_a_message_survives_the_wire_and_back(name: str, data: st.DataObject) -> None:
    shape = record(name)
    message = data.draw(messages_of(shape))
    native: Any = deserialize_message(serialize_message(writer(shape)(message)), shape.native)
    assert same(reader(shape)(native), message)


@pytest.mark.parametrize("name", MESSAGE_TYPES)
def test_the_defaults_of_a_type_are_what_its_class_makes(name: str) -> None:
    shape = record(name)
    made: object = shape.native()
    ours = writer(shape)(reader(shape)(made))
    assert same(reader(shape)(ours), plain(reader(shape)(made)))
    # What is on the wire cannot be compared: between fields and at its end Fast CDR aligns, and
    # leaves there what memory held.
    wires = [serialize_message(native) for native in (ours, made)]
    received = [reader(shape)(deserialize_message(wire, shape.native)) for wire in wires]
    assert same(*map(plain, received))
    assert len(wires[0]) == len(wires[1])


def test_arrays_of_types_that_hold_arrays_of_types_survive() -> None:
    shape = record("test_msgs/msg/MultiNested")
    whole = reader(shape)(shape.native())
    arrays = {**whole["array_of_arrays"][0], "int64_values": [2**63 - 1, -(2**63), 0]}
    arrays["string_values"] = ["\N{SNOWMAN}", "", "x" * 1000]
    bounded = {**whole["array_of_bounded_sequences"][0], "float32_values": [math.inf, -0.0]}
    message = {
        **whole,
        "array_of_arrays": [arrays] * 3,
        "unbounded_sequence_of_arrays": [arrays, whole["array_of_arrays"][1]],
        "bounded_sequence_of_bounded_sequences": [bounded],
    }
    native: Any = deserialize_message(serialize_message(writer(shape)(message)), shape.native)
    read = reader(shape)(native)
    assert same(read["array_of_arrays"], [plain(arrays)] * 3)
    assert same(read["unbounded_sequence_of_arrays"][0], plain(arrays))
    assert same(read["bounded_sequence_of_bounded_sequences"], [plain(bounded)])


def test_buffers_pass_without_a_copy() -> None:
    image = record("sensor_msgs/msg/Image")
    native: Any = image.native()
    native.data = bytes(range(12))
    read = reader(image)(native)
    assert isinstance(read["data"], memoryview)
    assert read["data"].readonly
    assert read["data"].obj is native.data
    ranges = np.arange(3, dtype=np.float32)
    scan = reader(record("sensor_msgs/msg/LaserScan"))(import_type("sensor_msgs/msg/LaserScan")())
    written: Any = writer(record("sensor_msgs/msg/LaserScan"))({**scan, "ranges": ranges})
    assert written._ranges is ranges


BASIC: dict[str, object] = {
    "bool_value": False,
    "byte_value": 0,
    "char_value": 0,
    "float32_value": 0.0,
    "float64_value": 0.0,
    **{f"{sign}int{bits}_value": 0 for bits in (8, 16, 32, 64) for sign in ("", "u")},
}


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        *[
            (f"{sign}int{bits}_value", value, "expected")
            for bits in (8, 16, 32, 64)
            for sign, low, high in (("", -(2 ** (bits - 1)), 2 ** (bits - 1)), ("u", 0, 2**bits))
            for value in (low - 1, high)
        ],
        ("byte_value", 256, "0 to 255"),
        ("char_value", -1, "0 to 255"),
        ("int8_value", True, "an integer"),
        ("int8_value", 1.5, "an integer"),
        ("int8_value", "1", "an integer"),
        ("int8_value", None, "an integer"),
        ("bool_value", 1, "true or false"),
        ("float32_value", 3.5e38, "float32"),
        ("float32_value", "1", "a number"),
        ("float64_value", True, "a number"),
        ("float64_value", 10**400, "a number"),
    ],
)
def test_a_value_out_of_range_is_named(field: str, value: object, words: str) -> None:
    with pytest.raises(MessageError, match=f"field {field}: .*{words}"):
        writer(record("test_msgs/msg/BasicTypes"))({**BASIC, field: value})


@pytest.mark.parametrize("value", [2**63 - 1, -(2**63)])
def test_sixty_four_bits_are_exact(value: int) -> None:
    shape = record("test_msgs/msg/BasicTypes")
    written: object = writer(shape)({**BASIC, "int64_value": value})
    native: Any = deserialize_message(serialize_message(written), shape.native)
    assert reader(shape)(native)["int64_value"] == value


@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan])
def test_what_is_no_number_passes_as_a_float(value: float) -> None:
    shape = record("test_msgs/msg/BasicTypes")
    written: object = writer(shape)({**BASIC, "float32_value": value, "float64_value": value})
    native: Any = deserialize_message(serialize_message(written), shape.native)
    read = reader(shape)(native)
    assert same(read["float32_value"], value)
    assert same(read["float64_value"], value)


def test_integers_and_numpy_scalars_are_taken_for_what_they_are() -> None:
    shape = record("test_msgs/msg/BasicTypes")
    given_values = {
        **BASIC,
        "float64_value": 3,
        "int8_value": np.int64(-5),
        "uint8_value": 7.0,
        "bool_value": np.bool_(1),
    }
    read = reader(shape)(writer(shape)(given_values))
    assert (read["float64_value"], read["int8_value"], read["uint8_value"]) == (3.0, -5, 7)
    assert read["bool_value"] is True


def _unbounded(**fields: object) -> dict[str, object]:
    shape = record("test_msgs/msg/UnboundedSequences")
    return {**reader(shape)(shape.native()), **fields}


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("uint8_values", [0, 256], r"\[1\]: expected 0 to 255"),
        ("uint8_values", np.array([0, 256]), r"\[1\]: expected 0 to 255"),
        ("int16_values", np.array([0.5]), "an array of float64"),
        ("float32_values", [1.0, 1e39], r"\[1\]: expected"),
        ("float32_values", np.array([math.nan, math.inf, -1e39]), r"\[2\]: expected"),
        ("float64_values", [1.0, "2"], r"\[1\]: expected a number"),
        ("float64_values", b"12345678", "got octets"),
        ("float64_values", np.zeros((2, 2)), "one dimension"),
        ("float64_values", 5, "an array"),
        ("int64_values", [2**63], r"\[0\]: expected"),
        ("bool_values", [True, 1], r"\[1\]: expected true or false"),
        ("string_values", ["a", 5], r"\[1\]: expected a string"),
        ("string_values", "text", "an array"),
        ("byte_values", [1, -1], r"\[1\]: expected"),
        ("basic_types_values", [BASIC, {**BASIC, "int8_value": 500}], r"\[1\].int8_value: expec"),
        ("basic_types_values", [{}], r"\[0\].bool_value: missing"),
        ("basic_types_values", {}, "an array of objects"),
    ],
)
def test_an_unfit_element_is_named(field: str, value: object, words: str) -> None:
    with pytest.raises(MessageError, match=f"field {field}.*{words}"):
        writer(record("test_msgs/msg/UnboundedSequences"))(_unbounded(**{field: value}))


@pytest.mark.parametrize(
    ("given_value", "numbers"),
    [
        ([1, 2], [1, 2]),
        ((1, 2), [1, 2]),
        (array("h", [1, 2]), [1, 2]),
        (memoryview(array("h", [1, 2])), [1, 2]),
        (np.array([1, 2], ">i4"), [1, 2]),
        (np.array([1, 9, 2, 9], np.int16)[::2], [1, 2]),
        (array("q", [1, 2]), [1, 2]),
        ([], []),
        (memoryview(array("h")), []),
    ],
)
def test_any_array_of_fitting_numbers_is_taken(given_value: object, numbers: list[int]) -> None:
    shape = record("test_msgs/msg/UnboundedSequences")
    written: object = writer(shape)(_unbounded(int16_values=given_value))
    native: Any = deserialize_message(serialize_message(written), shape.native)
    assert list(native.int16_values) == numbers


@pytest.mark.parametrize(
    "octets", [b"\0\xff", bytearray(b"\0\xff"), memoryview(b"\0\xff"), [0, 255]]
)
@pytest.mark.parametrize("field", ["uint8_values", "byte_values", "char_values"])
def test_octets_come_in_every_form(field: str, octets: object) -> None:
    shape = record("test_msgs/msg/UnboundedSequences")
    written: object = writer(shape)(_unbounded(**{field: octets}))
    native: Any = deserialize_message(serialize_message(written), shape.native)
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


def test_a_character_of_an_idl_file_is_an_octet_and_in_python_a_text() -> None:
    """Of a number in its place the generated code ends the process."""
    shape = shape_of(Odd, "odd_msgs/msg/Odd")
    digits = "eb2d4676546eb03c06d7df30df594c1f1c472bb4cb2ee2df0d40873b63bee6df"
    assert type_hash(shape) == f"RIHS01_{digits}", "as rosidl has it"
    message = {"letter": 65, "o": 1, "w": "ab", "cs": b"B", "two": b"CD"}
    native: Any = writer(shape)(message)
    assert (native._letter, native._cs, native._two) == ("A", ["B"], ["C", "D"])
    assert reader(shape)(native) == message
    for field, value in (("letter", 128), ("letter", "A"), ("cs", b"\x80"), ("two", [1, 2, 3])):
        with pytest.raises(MessageError, match=f"field {field}"):
            writer(shape)({**message, field: value})


def test_lengths_are_kept() -> None:
    arrays = record("test_msgs/msg/Arrays")
    whole = reader(arrays)(arrays.native())
    for field, value in (("bool_values", [True]), ("int32_values", [1, 2, 3, 4])):
        with pytest.raises(MessageError, match=f"field {field}: expected 3 elements"):
            writer(arrays)({**whole, field: value})
    with pytest.raises(MessageError, match="field basic_types_values: expected 3 elements, got 0"):
        writer(arrays)({**whole, "basic_types_values": []})
    bounded = record("test_msgs/msg/BoundedSequences")
    whole = reader(bounded)(bounded.native())
    with pytest.raises(MessageError, match="field uint8_values: expected at most 3 elements"):
        writer(bounded)({**whole, "uint8_values": b"1234"})


def test_text_is_bounded_in_code_units_and_has_no_nul() -> None:
    shape = record("test_msgs/msg/Strings")
    whole = reader(shape)(shape.native())
    for text, words in (
        ("x" * 23, "at most 22"),
        ("\N{SNOWMAN}" * 8, "at most 22 utf-8 code units, got 24"),
        ("a\0b", "NUL"),
        ("\ud800", "whole characters"),
        (b"bytes", "a string"),
    ):
        with pytest.raises(MessageError, match=f"field bounded_string_value: .*{words}"):
            writer(shape)({**whole, "bounded_string_value": text})


@pytest.mark.parametrize("message", [None, 5, "text", [], {"data": "x", "more": 1}, {}])
def test_anything_but_the_message_is_refused(message: object) -> None:
    with pytest.raises(MessageError, match="std_msgs/msg/String: field"):
        writer(record("std_msgs/msg/String"))(message)


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


@pytest.mark.parametrize(
    ("kind", "field"),
    [
        ("test_msgs/msg/BasicTypes", "bool_value"),
        ("test_msgs/msg/BasicTypes", "int64_value"),
        ("test_msgs/msg/BasicTypes", "float32_value"),
        ("test_msgs/msg/UnboundedSequences", "float64_values"),
        ("test_msgs/msg/UnboundedSequences", "uint8_values"),
        ("test_msgs/msg/UnboundedSequences", "string_values"),
        ("test_msgs/msg/UnboundedSequences", "bool_values"),
        ("test_msgs/msg/UnboundedSequences", "constants_values"),
    ],
)
def test_what_a_value_does_itself_is_a_refusal(kind: str, field: str) -> None:
    write, given = writer(record(kind)), BASIC if "Basic" in kind else _unbounded()
    assert not misbehaviour(lambda value: serialize_message(write({**given, field: value})))


def test_what_raises_is_named_with_its_place() -> None:
    class Wrong(dict[str, Any]):
        def __getitem__(self, key: str) -> Any:
            raise GeneratorExit("of mine")

    given = _unbounded(basic_types_values=[Wrong(BASIC)])
    place = r"field basic_types_values\[0\]: GeneratorExit: of mine"
    with pytest.raises(MessageError, match=place):
        writer(record("test_msgs/msg/UnboundedSequences"))(given)
