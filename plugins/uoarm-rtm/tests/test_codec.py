"""CDR: known bytes, round trips of every type, agreement with omniORB, and hostile input."""

from __future__ import annotations

import contextlib
import json
import tracemalloc
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import omniORB
import pytest
from _uoarm_rtm_stubs import RTC
from hypothesis import given
from hypothesis import strategies as st
from messages import messages
from plain import plain
from uoarm_rtm._orb import Orb
from uoarm_rtm._shape import BIG, LITTLE, CdrCodec
from uoarm_rtm._types import Types

from uoarm.cdr import ByteOrder
from uoarm.errors import BridgeError, MessageError

HERE = Path(__file__).parent
VECTORS = json.loads((HERE / "cdr_vectors.json").read_text())["vectors"]
ODD = ["Mixed", "Bounded", "Grid", "Weather", "Deep", "Unions", "Wide"]
# omniORB 4.3.3 writes wchar and cannot read what it wrote (MARSHAL_MessageTooLong).
NOT_FOR_OMNIORB = ["RTC/TimedWChar", "RTC/TimedWCharSeq", "Odd/Wide"]
ORDERS = {"little": LITTLE, "big": BIG}


@pytest.fixture(scope="module", autouse=True)
def orb() -> Iterator[None]:
    """An ORB, without which omniORB does not marshal."""
    held = Orb("127.0.0.1", 2.0)
    yield
    held.close()


@lru_cache
def types() -> Types:
    return Types([str(HERE / "types.idl")])


def every_type() -> list[str]:
    text = "".join(
        path.read_text() for path in sorted((HERE / "../src/uoarm_rtm/idl").glob("*Data*.idl"))
    )
    names = [word.split()[1] for word in text.split("\n") if word.strip().startswith("struct ")]
    return [f"RTC/{name}" for name in names] + [f"Odd/{name}" for name in ODD]


def type_code(name: str) -> Any:
    return omniORB.tcInternal.createTypeCode(types().descriptor(name))


def codec(name: str) -> CdrCodec:
    return types().codec(name)


@pytest.mark.parametrize("vector", VECTORS, ids=lambda item: f"{item['type']}-{item['endian']}")
def test_known_bytes_are_written_and_read(vector: dict[str, Any]) -> None:
    known = codec(vector["type"])
    data = bytes.fromhex(vector["hex"])
    order = ORDERS[vector["endian"]]
    assert known.encode(vector["value"], order).hex() == vector["hex"]
    assert plain(known.decode(data, order)) == plain(vector["value"])
    dirty = bytearray(data)
    for offset in vector["padding"]:
        dirty[offset] = 0xAA
    assert plain(known.decode(bytes(dirty), order)) == plain(vector["value"])


def test_all_types_are_there() -> None:
    assert len(every_type()) == 26 + 56 + 44 + len(ODD)


@pytest.mark.parametrize("name", every_type())
def test_every_type_survives_a_round_trip_and_omniorb_agrees(name: str) -> None:
    known = codec(name)
    code = type_code(name)

    @given(messages(known.shape))
    def check(message: Any) -> None:
        wanted = plain(message)
        for order in ORDERS.values():
            data = known.encode(message, order)
            assert plain(known.decode(data, order)) == wanted
            if name in NOT_FOR_OMNIORB:
                continue
            is_little = order == LITTLE
            native = omniORB.cdrUnmarshal(code, data, is_little)
            rewritten = omniORB.cdrMarshal(code, native, is_little)
            assert plain(known.decode(rewritten, order)) == wanted

    check()


@pytest.mark.parametrize(
    "name", ["RTC/TimedPose3D", "RTC/RangeData", "Odd/Unions", "Odd/Deep", "Odd/Wide"]
)
def test_no_shorter_and_no_longer_buffer_is_read(name: str) -> None:
    known = codec(name)

    @given(messages(known.shape), st.data())
    def check(message: Any, data: Any) -> None:
        whole = known.encode(message)
        cut = data.draw(st.integers(0, len(whole) - 1))
        with pytest.raises(MessageError, match="cannot be read"):
            known.decode(whole[:cut])
        with pytest.raises(MessageError, match="cannot be read"):
            known.decode(whole + b"\0")

    check()


@pytest.mark.parametrize("name", every_type())
def test_any_bytes_are_read_or_refused_with_a_path(name: str) -> None:
    known = codec(name)

    @given(st.binary(max_size=300), st.sampled_from([LITTLE, BIG]))
    def check(data: bytes, order: ByteOrder) -> None:
        try:
            message = known.decode(data, order)
        except MessageError as error:
            assert "cannot be read: $" in str(error)
        else:
            assert plain(known.decode(known.encode(message, order), order)) == plain(message)

    check()


def test_wide_characters_are_written_as_omniorb_writes_them() -> None:
    stamped = RTC.TimedWChar(RTC.Time(1, 2), "é")
    for order in ORDERS.values():
        data = omniORB.cdrMarshal(type_code("TimedWChar"), stamped, order == LITTLE)
        message = {"tm": {"sec": 1, "nsec": 2}, "data": "é"}
        assert codec("TimedWChar").encode(message, order) == data
        assert codec("TimedWChar").decode(data, order) == message


def test_wrong_lengths_allocate_nothing() -> None:
    for name in every_type():
        for order in ORDERS.values():
            for fill in (b"\xff", b"\x7f", b"\x01", b"\x10"):
                data = fill * 4096
                tracemalloc.start()
                with contextlib.suppress(MessageError):
                    codec(name).decode(data, order)
                peak = tracemalloc.get_traced_memory()[1]
                tracemalloc.stop()
                assert peak < 1_500_000, (name, order, fill)


TM = {"tm": {"sec": 1, "nsec": 2}}


@pytest.mark.parametrize(
    ("name", "message", "words"),
    [
        ("TimedLong", {**TM, "data": 2**31}, r"\$\.data: expected -2147483648"),
        ("TimedFloat", {**TM, "data": 1e39}, r"\$\.data: expected at most 3.4e38"),
        ("TimedBoolean", {**TM, "data": 1}, r"\$\.data: expected true or false"),
        ("TimedLongSeq", {**TM, "data": b"ab"}, r"\$\.data: expected an array of long"),
        (
            "TimedLongSeq",
            {**TM, "data": np.array([1.5])},
            r"\$\.data\[0\]: expected an integer \(long\), got 1.5",
        ),
        ("TimedStringSeq", {**TM, "data": ["a", 5]}, r"\$\.data\[1\]: expected"),
        ("GripperState", {**TM, "status": "OPEN"}, r"\$\.status: expected one of"),
        (
            "Odd/Bounded",
            {"few": [1, 2, 3, 4], "word": "", "words": []},
            r"\$\.few: expected at most 3",
        ),
        (
            "Odd/Bounded",
            {"few": [], "word": "12345", "words": []},
            r"\$\.word: expected at most 4 char",
        ),
        ("Odd/ByMood", {"switch": "SAD", "rest": 1.0}, r"switch: expected one of CALM, ANGRY"),
        ("Odd/ByNumber", {"switch": 1, "small": 256}, r"\$\.small: expected 0 to 255"),
    ],
)
def test_a_message_that_does_not_fit_names_the_field(name: str, message: Any, words: str) -> None:
    with pytest.raises(MessageError, match=words):
        codec(name).encode(message)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("Odd/Holder", r"Holder\.what: any has no structure"),
        ("Odd/Node", "Node.*: it contains itself"),
        ("RTC/TimedLnog", "did you mean 'RTC/TimedLong'"),
        ("ConnectorProfile", "an object reference means nothing outside CORBA"),
    ],
)
def test_types_without_a_structure_are_refused_with_the_reason(name: str, words: str) -> None:
    with pytest.raises(BridgeError, match=words):
        codec(name)


def test_texts_of_another_encoding_are_an_error_or_are_asked_for() -> None:
    message = {**TM, "data": "é"}
    latin = Types(encoding="latin-1").codec("TimedString")
    assert latin.decode(latin.encode(message)) == message
    with pytest.raises(MessageError, match=r"\$\.data: not a text in utf-8"):
        codec("TimedString").decode(latin.encode(message))
    with pytest.raises(MessageError, match="cannot be written as latin-1"):
        latin.encode({**message, "data": "€"})


@pytest.mark.parametrize(
    "name",
    ["IDL:RTC/TimedLong:1.0", "RTC::TimedLong", "::RTC::TimedLong", "TimedLong", "RTC/TimedLong",
     "IDL:omg.org/RTC/TimedLong:1.0", "IDL:RTC/TimedLong"],
)  # fmt: skip
def test_a_type_is_known_by_every_way_of_writing_it(name: str) -> None:
    assert types().descriptor(name)[2] == "IDL:RTC/TimedLong:1.0"
    assert types().same(name, "IDL:RTC/TimedLong:1.0")
    assert not types().same(name, "IDL:RTC/TimedULong:1.0")
