"""Every message comes back as it left; every broken frame is refused."""

from __future__ import annotations

import contextlib
import math
import sys
import tracemalloc
from array import array
from types import ModuleType

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.hostile import misbehaviour
from tests.structures import Quits
from tests.sweeps import for_all

from uoarm._host.transport import codec
from uoarm._host.transport.codec import pack, unpack
from uoarm.errors import MessageError
from uoarm.testing import Background

_leaves = (
    st.none()
    | st.booleans()
    | st.integers(-(2**80), 2**80)
    | st.floats(allow_nan=False)
    | st.text(st.characters())
    | st.binary()
)
_messages = st.recursive(
    _leaves, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner), max_leaves=20
)


@given(_messages)
def test_a_message_comes_back_as_it_left(message: object) -> None:
    assert unpack(pack(message)) == message


def test_half_of_a_surrogate_pair_passes() -> None:
    assert unpack(pack({"text": "\ud800"})) == {"text": "\ud800"}


def test_what_is_not_a_number_stays_so() -> None:
    assert math.isnan(unpack(pack({"x": math.nan}))["x"])


@for_all("kind", ["?", "i1", "u1", "<i2", ">u2", "<i4", "<u8", "<f2", ">f4", "<f8"])
@for_all("shape", [(0,), (5,), (3, 2), (2, 0, 3), ()])
def test_numeric_arrays_keep_type_shape_and_values(kind: str, shape: tuple[int, ...]) -> None:
    sent = (np.arange(math.prod(shape)) % 2).astype(kind).reshape(shape)
    got = unpack(pack({"a": sent, "b": [sent, "text"]}))
    for item in (got["a"], got["b"][0]):
        assert item.dtype == sent.dtype
        assert item.shape == sent.shape
        assert (item == sent).all()


def test_a_strided_array_is_sent_as_it_reads() -> None:
    sent = np.arange(20).reshape(4, 5)[::2, ::-1]
    assert (unpack(pack(sent)) == sent).all()


@pytest.mark.parametrize("code", "bBhHiIlLqQfd")
def test_arrays_keep_type_and_values(code: str) -> None:
    got = unpack(pack([array(code, [1, 2, 3]), "after"]))
    assert got[0].tolist() == [1, 2, 3]
    assert got[0].itemsize == array(code).itemsize
    assert got[1] == "after"


def test_numbers_of_numpy_become_plain() -> None:
    got = unpack(pack([np.int64(3), np.float32(0.5), np.bool_(True)]))
    assert got == [3, 0.5, True]
    assert [type(item) for item in got] == [int, float, bool]


@pytest.mark.parametrize("code", "bBhHiIqQfd")
def test_without_numpy_a_flat_buffer_arrives_as_an_array(
    code: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    frame = pack(array(code, [1, 2]))
    monkeypatch.setitem(sys.modules, "numpy", None)
    got = unpack(frame)
    assert isinstance(got, array)
    assert got.tolist() == [1, 2]


def test_without_numpy_other_shapes_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    frame = pack(np.zeros((2, 2)))
    monkeypatch.setitem(sys.modules, "numpy", None)
    with pytest.raises(MessageError, match="needs numpy"):
        unpack(frame)


@pytest.mark.parametrize("value", [object(), {1, 2}, np.array(["a"]), np.array([object()]), 1j])
def test_other_values_are_refused_by_name(value: object) -> None:
    with pytest.raises(MessageError, match=f"cannot carry a {type(value).__name__}"):
        pack({"x": value})


def test_a_value_is_refused_by_name_while_another_thread_imports_numpy(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "numpy", ModuleType("numpy"))
    with pytest.raises(MessageError, match="cannot carry a set"):
        pack({"x": {1, 2}})


def test_a_message_nested_too_deep_is_refused() -> None:
    message: object = []
    for _ in range(5000):
        message = [message]
    with pytest.raises(MessageError, match="cannot be written"):
        pack(message)


@pytest.mark.parametrize("kind", [SystemExit, RuntimeError])
def test_what_raises_as_it_is_written_is_refused(kind: type[BaseException]) -> None:
    writes = Background(lambda: pack({"x": math.nan, "y": Quits(kind)}))
    with pytest.raises(MessageError, match=kind.__name__):
        writes.result()


def test_every_cut_of_a_frame_is_refused() -> None:
    frame = pack({"a": np.arange(10), "b": b"octets", "c": "text"})
    for end in range(len(frame)):
        if end % 8 or end < len(frame) - 8:
            with pytest.raises(MessageError):
                unpack(frame[:end])


@given(st.binary(max_size=64))
def test_noise_is_read_or_refused_and_nothing_else(noise: bytes) -> None:
    with contextlib.suppress(MessageError):
        unpack(noise)


def framed(tree: bytes, *buffers: bytes) -> bytes:
    frame = len(tree).to_bytes(4, "little") + tree
    return b"".join(chunk + bytes(-len(chunk) % 8) for chunk in (frame, *buffers))


def buffer(kind: object, shape: object, size: object) -> bytes:
    packed: bytes = msgpack.packb(msgpack.ExtType(1, msgpack.packb((kind, shape, size))))
    return packed


@pytest.mark.parametrize(
    ("kind", "shape", "says"),
    [
        ("<08", [1], "unknown type '<08'"),
        ("08", [1], "unknown type"),
        ("i4, {", [1], "unknown type"),
        ("<M8", [1], "unknown type"),
        ("V8", [1], "unknown type"),
        ("1f8", [1], "unknown type"),
        ("<f8" * 50_000, [1], "unknown type"),
        (7, [1], "unknown type"),
        ("<f8", [1] * 33, "more than 32 dimensions"),
        ("<f8", 1, "dimensions"),
        ("<f8", [-1], "no list of sizes"),
        ("<f8", ["1"], "no list of sizes"),
        ("<f8", [True], "no list of sizes"),
        ("<f8", [2**63] * 32, "does not fit"),
        ("<f8", [2], "does not fit"),
        ("<f8", [0], "does not fit"),
    ],
)
def test_what_is_said_of_a_buffer_is_not_believed(kind: object, shape: object, says: str) -> None:
    with pytest.raises(MessageError, match=says) as caught:
        unpack(framed(buffer(kind, shape, 8), bytes(8)))
    assert len(str(caught.value)) < 200
    assert unpack(framed(buffer("<f8", [1], 8), bytes(8))) == [0.0]


@pytest.mark.parametrize(
    "head", [b"\xdc\xff\xff", b"\xdd\x00\x10\x00\x00", b"\xdf\x00\x10\x00\x00"]
)
@pytest.mark.parametrize("texts", [0, 1000])
def test_lists_are_not_made_as_long_as_they_claim(head: bytes, texts: int) -> None:
    """Also behind many heads that are harmless."""
    claims = b"\xdc\x03\xe8" + b"\xa1a" * texts + head * 500 + bytes(1_100_000)
    tracemalloc.start()
    try:
        with pytest.raises(MessageError, match="claims to hold"):
            unpack(framed(claims))
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()


LONG = st.recursive(
    st.integers(-(2**40), 2**40)
    | st.integers(-40, 140)
    | st.floats()
    | st.text()
    | st.binary()
    | st.just(2**80),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
)


EACH_HEAD: dict[str, object] = {
    **{f"integer {n}": n for n in (0, 127, -1, -32, -33, -200, -40_000, -(2**33))},
    **{f"integer {n}": n for n in (200, 40_000, 2**20, 2**33, 2**80, 2**130, -(2**300))},
    **{f"text of {n}": "a" * n for n in (0, 1, 31, 32, 300, 70_000)},
    **{f"{n} octets": b"\xdd" * n for n in (0, 1, 300, 70_000)},
    **{f"list of {n}": [1] * n for n in (0, 15, 16)},
    **{f"map of {n}": dict.fromkeys(map(str, range(n)), 1) for n in (0, 15, 16)},
    **{f"buffer of {n}": array("d", [1.5] * n) for n in (0, 1, 40_000)},
    "float": 1.5,
    "true": True,
    "null": None,
}


@pytest.mark.parametrize("value", EACH_HEAD.values(), ids=EACH_HEAD.keys())
def test_what_stands_behind_every_kind_of_head_is_found(value: object) -> None:
    """Else octets that look like long lists would be taken for them."""
    looks = b"\xdd\xdf" * 4000
    frame = pack([[value] * 7, looks])
    size = int.from_bytes(frame[:4], "little")
    assert codec._walk(frame, 4, 4 + size, size, 0, size)[1] == 4 + size
    unpack(frame)


@given(LONG, st.integers(0, 3))
def test_no_true_claim_is_refused(message: object, copies: int) -> None:
    """Also among octets that look like the heads of long lists."""
    looks = b"\xdd\xdf" * 4000
    unpack(pack([message, looks, [[message] * 20] * 20 * copies]))
    unpack(pack({"looks": looks, "values": [float("nan"), 1.5] * 3000, "m": {"a": message}}))


def test_what_a_value_does_itself_is_a_refusal() -> None:
    assert not misbehaviour(lambda value: unpack(pack(value)))
    assert not misbehaviour(lambda value: unpack(pack({"x": [value]})))
