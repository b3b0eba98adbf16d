"""Messages as CBOR and back; hostile CBOR is refused, whatever it is."""

from __future__ import annotations

import contextlib
import math
import re
import sys
from array import array
from collections import OrderedDict
from datetime import date, datetime, timezone
from decimal import Decimal
from enum import Enum
from fractions import Fraction
from ipaddress import (
    IPv4Address,
    IPv4Interface,
    IPv4Network,
    IPv6Address,
    IPv6Interface,
    IPv6Network,
)
from typing import Any
from uuid import UUID

import cbor2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.structures import Quits

from uoarm._wire import _binary
from uoarm._wire._binary import (
    _CUT_TAG,
    _ENCODERS,
    LARGEST,
    _encode_other,
    decoding_octets,
    read_binary,
    scan_cbor,
    write_binary,
)
from uoarm.errors import ControlMessageError, MessageError
from uoarm.model import Budget, BudgetUse
from uoarm.testing import Background

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


def read(data: bytes, depth: int = 64) -> Any:
    return read_binary(data, BudgetUse(Budget(depth=depth)))


@given(values)
def test_what_is_written_is_read_back(value: object) -> None:
    assert read(write_binary(value)) == value


class Text(str):
    __slots__ = ()


class Kind(Enum):
    A = 1


OTHERS = (
    array("f", [1.0]),
    memoryview(b"ab"),
    bytearray(b"ab"),
    np.arange(3),
    np.float32(1.5),
    np.float64(1.5),
    np.bool_(True),
    Text("a"),
    (1, 2),
    float("nan"),
    2**70,
    "\ud800",
    datetime(2026, 1, 1, tzinfo=timezone.utc),
    UUID(int=1),
    Kind.A,
    {1: 2},
    OrderedDict({None: 1}),
    {1, 2},
    frozenset("a"),
    Decimal(1),
    Fraction(1, 2),
    1j,
    np.ones(2, complex),
    date(2026, 1, 1),
    re.compile("a"),
    *(make("127.0.0.1") for make in (IPv4Address, IPv4Network, IPv4Interface)),
    *(make("::1") for make in (IPv6Address, IPv6Network, IPv6Interface)),
    cbor2.undefined,
    cbor2.CBORSimpleValue(5),
    cbor2.CBORTag(0, 1),
    object(),
)


@given(st.recursive(values | st.sampled_from(OTHERS), lambda inner: st.lists(inner, max_size=4)))
def test_what_is_written_quickly_is_what_all_encoders_write(value: Any) -> None:
    def write(*, quickly: bool) -> bytes | None:
        try:
            if quickly:
                return write_binary({"value": value})
            return cbor2.dumps({"value": value}, encoders=_ENCODERS, default=_encode_other)
        except (MessageError, cbor2.CBOREncodeError, ValueError):
            return None

    assert write(quickly=True) == write(quickly=False)


@pytest.mark.parametrize("value", OTHERS, ids=lambda value: type(value).__name__)
@pytest.mark.parametrize("beside", ["", b"a" * 5_000], ids=["small", "large"])
def test_what_a_client_cannot_read_is_not_written(value: object, beside: object) -> None:
    for message in ([value], {"value": {"value": value}, "beside": beside}):
        with contextlib.suppress(MessageError):
            read(write_binary(message))
    if isinstance(value, dict):
        with pytest.raises(MessageError, match="names must be strings"):
            write_binary({**value, "beside": beside})


@pytest.mark.parametrize("code", list("bBhHiIqQfd"))
def test_numeric_arrays_stay_arrays(code: str) -> None:
    numbers = array(code, [1, 2, 100])
    got = read(write_binary({"x": numbers}))["x"]
    assert isinstance(got, array)
    assert got == numbers


@pytest.mark.parametrize("kind", ["<f4", ">f4", "<f8", ">i2", "<u4", "<i8", "<f2", ">f2"])
def test_numpy_of_both_byte_orders_keeps_its_values(kind: str) -> None:
    numbers = np.array([1, 2, 100], dtype=kind)
    assert list(read(write_binary(numbers))) == [1, 2, 100]


def test_known_bytes_of_a_typed_array() -> None:
    # d8 56: tag 86, float64 little-endian; 48: 8 octets; 1.0
    assert write_binary(array("d", [1.0])).hex() == "d85648000000000000f03f"
    # d8 52: tag 82, float64 big-endian
    assert list(read(bytes.fromhex("d852483ff0000000000000"), depth=8)) == [1.0]


def test_rows_are_a_matrix() -> None:
    matrix = np.arange(6, dtype="f4").reshape(2, 3)
    assert read(write_binary(matrix), depth=8) == [[0, 1, 2], [3, 4, 5]]
    assert read(write_binary(np.uint8([[1, 2]])), depth=8) == [[1, 2]]  # type: ignore[arg-type] # numpy takes it


@pytest.mark.parametrize("shape", [(0, 4), (3, 0), (0, 0), (2, 0, 3), (0, 2, 3)])
@pytest.mark.parametrize("kind", ["u1", "f4", "?"])
def test_rows_of_which_there_are_none(shape: tuple[int, ...], kind: str) -> None:
    nothing = np.zeros(shape, kind)
    assert read(write_binary(nothing)) == nothing.tolist()


@pytest.mark.parametrize("kind", ["u1", "f4", ">i2", "u8"])
def test_rows_may_come_as_an_array_of_numpy(kind: str) -> None:
    cube = np.arange(24).reshape(2, 3, 4).astype(kind)
    for sent in (cube, cube[:0], np.asfortranarray(cube)):
        data = write_binary({"cube": sent, "flat": np.ones(1, "u1")})
        got = read_binary(data, BudgetUse(Budget(elements=20)), with_numpy=True)
        assert np.array_equal(got["cube"], sent)
        assert got["flat"] == b"\1"
        assert got["cube"].dtype == sent.dtype.newbyteorder("=")
        assert not got["cube"].flags.writeable


def test_a_picture_of_numpy_is_one_value() -> None:
    data = write_binary(np.zeros((480, 640, 3), "u1"))
    got = read_binary(data, spending := BudgetUse(Budget(elements=20)), with_numpy=True)
    assert got.shape == (480, 640, 3)
    assert spending.elements == 1


def test_a_picture_is_octets_without_numpy_where_lists_would_be_too_much(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    picture = np.ones((1080, 1920, 3), np.uint8)
    data = write_binary({"picture": picture, "depth": picture.astype("f4")})
    monkeypatch.setitem(sys.modules, "numpy", None)
    got = read_binary(data, BudgetUse(LARGEST), with_numpy=True)
    assert got["picture"] == picture.tobytes()
    assert got["depth"] == array("f", [1.0]) * picture.size


def test_rows_are_lists_without_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    data = write_binary(np.arange(6, dtype="f4").reshape(2, 3))
    monkeypatch.setitem(sys.modules, "numpy", None)
    got = read_binary(data, BudgetUse(Budget()), with_numpy=True)
    assert got == [[0, 1, 2], [3, 4, 5]]


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
        read(data)


@given(st.binary(max_size=60))
def test_any_bytes_are_read_or_refused(data: bytes) -> None:
    with contextlib.suppress(ControlMessageError):
        read(data, depth=16)


OURS = cbor2.CBORTag(_CUT_TAG, 0)
ARRAYS: dict[Any, Any] = {array: _ENCODERS[array]}


@given(
    st.binary(max_size=60)
    | st.recursive(
        values | st.sampled_from([OURS, array("f", [1.0, 2.0]), np.arange(3)]),
        lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.binary(), inner, max_size=2),
    ).map(lambda value: cbor2.dumps(value, encoders=ARRAYS, default=_encode_other))
)
def test_octets_that_are_cut_out_change_nothing(data: bytes) -> None:
    found = []
    for least in (1, 1000):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(_binary, "_CUT_OCTETS", 0)
            patch.setattr(_binary, "_CUT_LEAST", least)
            spending = BudgetUse(Budget())
            try:
                found.append((read_binary(data, spending), spending.elements))
            except ControlMessageError:
                found.append((None, 0))
    assert repr(found[0]) == repr(found[1])


def test_large_octets_are_cut_out_of_data_of_either_kind() -> None:
    picture = bytes(range(256)) * 3600
    message = {"a": [picture, picture[:5000]], "b": {"c": array("f", [1.0] * 30_000)}, "d": 1}
    data = write_binary(message)
    assert read(data) == message
    assert read_binary(bytearray(data), BudgetUse(Budget())) == message
    with pytest.raises(ControlMessageError, match=f"message of {len(data):,} bytes"):
        read(data + b"1")
    with pytest.raises(ControlMessageError):
        read(data[:-1])


def test_octets_in_few_items_are_quick_to_read_and_many_items_are_not() -> None:
    assert decoding_octets(write_binary({"a": bytes(1_000_000)})) < 8192
    for slow in ([0] * 9000, ["text"] * 9000, {str(number): 0 for number in range(9000)}):
        data = write_binary(slow)
        assert decoding_octets(data) == len(data) > 8192


def nested(levels: int, innermost: Any = None) -> Any:
    value = innermost
    for _ in range(levels):
        value = [value]
    return value


class Odd(list[Any]):
    """A list that is written as one, and that the quick writer does not look into."""


@pytest.mark.parametrize("beside", ["", b"a" * 5_000], ids=["small", "large"])
@pytest.mark.parametrize(
    ("value", "why"),
    [
        (nested(510), "nest"),
        (nested(600), "nest"),
        (Odd(nested(600)), "nest"),
        (nested(300, b"ab"), "nest"),
        (2**3073, "3,072 bits"),
        ([np.ones(2), -(2**3073)], "3,072 bits"),
        (OrderedDict(wide=2**3073), "3,072 bits"),
        (lambda: list(range(2_000_000)), "values"),  # made as it is needed, not by each worker
        (lambda: [{"a": 1}] * 700_000, "values"),
        (np.zeros(2_000_000, bool), "values"),
        (lambda: bytes(LARGEST.octets), "bytes"),
    ],
    ids=lambda item: item if isinstance(item, str) else type(item).__name__,
)
def test_what_is_too_much_for_a_client_is_not_written(
    value: object, why: str, beside: object
) -> None:
    made = value() if callable(value) else value
    with pytest.raises(MessageError, match=why):
        write_binary({"value": {"value": made}, "beside": beside})


@pytest.mark.parametrize(
    "value",
    [
        nested(240, b"ab"),
        Odd(nested(240)),
        2**3072 - 1,
        lambda: list(range(1_900_000)),
        np.zeros((3_000_000, 2), "u1"),
        lambda: np.ones(3_000_000, "f2"),
        np.ones((1,) * 40),
        lambda: [np.ones(2), *["abcd"] * 900_000],
    ],
    ids=lambda item: type(item).__name__,
)
@pytest.mark.parametrize("beside", ["", b"a" * 5_000], ids=["small", "large"])
def test_what_a_client_takes_is_written(value: object, beside: object) -> None:
    made = value() if callable(value) else value
    data = write_binary({"value": {"value": made}, "beside": beside})
    read_binary(data, BudgetUse(LARGEST), with_numpy=True)


def test_large_parts_are_deeper_than_a_client_takes() -> None:
    value: dict[str, Any] = {"value": bytes(5_000)}
    for _ in range(300):
        value = {"value": value, "beside": nested(250)}
    with pytest.raises(MessageError, match="nest"):
        write_binary(value)


def test_what_has_no_form_is_refused_by_name() -> None:
    with pytest.raises(MessageError, match="object"):
        write_binary({"x": object()})


@pytest.mark.parametrize("kind", [SystemExit, RuntimeError])
def test_what_raises_as_it_is_written_is_refused(kind: type[BaseException]) -> None:
    writes = Background(lambda: write_binary({"x": math.nan, "y": Quits(kind)}))
    with pytest.raises(MessageError, match=kind.__name__):
        writes.result()


def rows(sizes: list[int], items: bytes = b"\x81\x01") -> bytes:
    return b"\xd8\x28\x82" + cbor2.dumps(sizes) + items


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (rows([1] * 9), "9 dimensions; 1 to 8"),
        (rows([1] * 60_000), "60,000 dimensions"),
        (rows([2**63 - 1] * 8), "from 1 to the 1 items"),
        (rows([2**40, 2**40], b"\xd8\x40\x42ab"), "from 1 to the 2 items"),
        (rows([3, 3, 3], b"\xd8\x40\x44abcd"), "do not hold the 4 items"),
        (rows([]), "0 dimensions"),
        (rows([-1]), "whole numbers"),
        (rows([0]), "whole numbers"),
        (rows([3, 0], b"\x80"), "from 1 to the 0 items"),
        (rows([0, -1], b"\x80"), "from 1 to the 0 items"),
        (b"\xd8\x28\x82\x81\xfb" + bytes(8) + b"\x81\x01", "whole numbers"),
        (b"\xd8\x28\x82\x81\xf5\x81\x01", "whole numbers"),
        (b"\xd8\x28\x82\x01\x81\x01", "sizes and items"),
        (b"\xd8\x28\x82\x81\x01\xa1\x61a\x01", "sizes and items"),
    ],
    ids=lambda item: item[:30] if isinstance(item, str) else "",
)
def test_dimensions_are_asked_about_before_rows_are_made(data: bytes, says: str) -> None:
    for with_numpy in (False, True):
        with pytest.raises(ControlMessageError, match=says) as caught:
            read_binary(data, BudgetUse(Budget()), with_numpy=with_numpy)
        assert len(str(caught.value)) < 200


def test_a_picture_that_is_too_large_in_rows_is_refused_with_what_to_do() -> None:
    picture = write_binary(np.zeros((480, 640, 3), np.uint8))
    says = "500,000 values, as each of an array of 3 dimensions counts: send one without dimensions"
    with pytest.raises(ControlMessageError, match=says):
        read_binary(picture, BudgetUse(Budget(elements=500_000)))
    assert read_binary(picture, BudgetUse(Budget(elements=500_000)), with_numpy=True).shape[2] == 3


def test_what_dimensions_make_counts_as_depth() -> None:
    deep = rows([1] * 8)
    for _ in range(7):
        deep = rows([1] * 8, b"\x81" + deep)
    assert read(deep, depth=64)
    with pytest.raises(ControlMessageError, match="63 levels"):
        read(deep, depth=63)


@pytest.mark.parametrize(
    "data",
    [
        rows([1000, 1], b"\xd8\x40\x59\x03\xe8" + bytes(1000)),
        b"\xd8\x54\x59\x07\xd0" + bytes(2000),
        b"\x99\x03\xe8" + b"\x80" * 1000,
        b"\xb9\x03\xe8" + b"".join(cbor2.dumps(f"{index}") + b"\x01" for index in range(1000)),
        b"\x9f" + b"\x01" * 1000 + b"\xff",
        b"\x99\x03\xe8" + b"\x62ab" * 1000,
        b"\x99\x03\xe8" + b"\xd8\x40\x41a" * 1000,
        b"\x99\x03\xe8" + b"\xfb\x00\x00\x00\x00\x00\x00\x00\x00" * 1000,
    ],
    ids=lambda data: data[:6].hex(),
)
def test_elements_are_counted(data: bytes) -> None:
    with pytest.raises(ControlMessageError, match="more than 999 values"):
        read_binary(data, BudgetUse(Budget(elements=999)))
    read_binary(data, BudgetUse(Budget(elements=4000)))


@given(values, st.integers(1, 40))
def test_the_scan_counts_no_less_than_there_is(value: object, elements: int) -> None:
    spending = BudgetUse(Budget(elements=10_000))
    read_binary(write_binary(value), spending)
    scanned = BudgetUse(Budget(elements=10_000))
    scan_cbor(write_binary(value), scanned)
    assert scanned.elements >= spending.elements
    if scanned.elements > elements:
        with pytest.raises(ControlMessageError, match="more than"):
            scan_cbor(write_binary(value), BudgetUse(Budget(elements=elements)))


@given(st.binary(max_size=60))
def test_any_bytes_have_a_scan(data: bytes) -> None:
    with contextlib.suppress(ControlMessageError):
        scan_cbor(data, BudgetUse(Budget(elements=20)))


def test_integers_are_bounded_before_they_are_made() -> None:
    assert read(b"\xc2\x59\x01\x80" + b"\xff" * 384) == 2**3072 - 1
    assert read(b"\xc3\x41\x01") == -2
    for tag in (b"\xc2", b"\xc3"):
        with pytest.raises(ControlMessageError, match="3,072 bits"):
            read(tag + b"\x59\x01\x81" + b"\xff" * 385)
    with pytest.raises(ControlMessageError):
        read(b"\xc2\x01")
