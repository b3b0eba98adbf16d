"""Messages as CBOR and back; hostile CBOR is refused, whatever it is."""

from __future__ import annotations

import contextlib
from array import array
from typing import Any

import cbor2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from uoarm.errors import ControlMessageError, MessageError
from uoarm.wire._binary import read_binary, write_binary

values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**80), 2**80)
    | st.floats(allow_nan=False)
    | st.text(max_size=10)
    | st.binary(max_size=10),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4)
    ),
    max_leaves=12,
)


@given(values)
def test_what_is_written_is_read_back(value: object) -> None:
    assert read_binary(write_binary(value), depth=64) == value


@pytest.mark.parametrize("code", list("bBhHiIqQfd"))
def test_numeric_arrays_stay_arrays(code: str) -> None:
    numbers = array(code, [1, 2, 100])
    read = read_binary(write_binary({"x": numbers}), depth=64)["x"]
    assert isinstance(read, array)
    assert read == numbers


@pytest.mark.parametrize("kind", ["<f4", ">f4", "<f8", ">i2", "<u4", "<i8", "<f2", ">f2"])
def test_numpy_of_both_byte_orders_keeps_its_values(kind: str) -> None:
    numbers = np.array([1, 2, 100], dtype=kind)
    assert list(read_binary(write_binary(numbers), depth=64)) == [1, 2, 100]


def test_known_bytes_of_a_typed_array() -> None:
    # d8 56: tag 86, float64 little-endian; 48: 8 octets; 1.0
    assert write_binary(array("d", [1.0])).hex() == "d85648000000000000f03f"
    # d8 52: tag 82, float64 big-endian
    assert list(read_binary(bytes.fromhex("d852483ff0000000000000"), depth=8)) == [1.0]


def test_rows_are_a_matrix() -> None:
    matrix = np.arange(6, dtype="f4").reshape(2, 3)
    assert read_binary(write_binary(matrix), depth=8) == [[0, 1, 2], [3, 4, 5]]
    assert read_binary(write_binary(np.uint8([[1, 2]])), depth=8) == [[1, 2]]  # type: ignore[arg-type] # numpy takes it


@pytest.mark.parametrize("size", [0, 23, 24, 255, 256, 4096, 65535, 65536, 70000])
def test_large_octets_are_written_as_the_encoder_writes_them(size: int) -> None:
    message: dict[str, Any] = {"head": {"a": 1, "d": bytes(size)}, "data": bytes(size), "n": [1.5]}
    assert write_binary(message) == cbor2.dumps(message)
    for view in (memoryview(bytes(size)), memoryview(bytes(2 * size))[::2]):
        assert write_binary({**message, "data": view}) == cbor2.dumps(message)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x01\x02",
        b"\x81" * 5000 + b"\x01",
        b"\xd8\x56" * 3000 + b"\x40",
        b"\x9b" + b"\xff" * 8,
        b"\x5b\x00\x00\x00\xff" + b"\xff" * 4,
        bytes.fromhex("a2616101616102"),
        bytes.fromhex("a10102"),
        bytes.fromhex("a1416102"),
        b"\xf7",
        b"\xe0",
        bytes.fromhex("d81c81d81d00"),
        bytes.fromhex("d85643000000"),
        bytes.fromhex("d82882820203820102"),
        bytes.fromhex("d82801"),
        cbor2.dumps(cbor2.CBORTag(0, "2020-01-01T00:00:00Z")),
        cbor2.dumps(cbor2.CBORTag(1234, 5)),
        cbor2.dumps({1, 2}),
        b"\xc2\x59\xff\xff" + b"\xff" * 65535,
    ],
    ids=lambda data: data[:12].hex(),
)
def test_what_no_message_has_is_refused(data: bytes) -> None:
    with pytest.raises(ControlMessageError):
        read_binary(data, depth=64)


@given(st.binary(max_size=60))
def test_any_bytes_are_read_or_refused(data: bytes) -> None:
    with contextlib.suppress(ControlMessageError):
        read_binary(data, depth=16)


def test_what_has_no_form_is_refused_by_name() -> None:
    with pytest.raises(MessageError, match="object"):
        write_binary({"x": object()})
