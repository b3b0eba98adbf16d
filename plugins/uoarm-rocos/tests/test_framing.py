"""Frames come back whole however the octets are cut, and after any garbage."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from uoarm_rocos._framing import Framer, LengthFramer, StuffedFramer, WireError

PAGE = Path(__file__).parents[1] / "docs" / "profile.md"
MESSAGE = b'<heartbeat seq="0"/>'
payloads = st.lists(st.binary(min_size=1, max_size=60), max_size=6)


def fed(framer: Framer, octets: bytes, cuts: list[int]) -> list[bytes]:
    found, last = [], 0
    for cut in [*sorted(cut % (len(octets) + 1) for cut in cuts), len(octets)]:
        found += framer.feed(octets[last:cut])
        last = cut
    return found


@pytest.mark.parametrize("kind", [LengthFramer, StuffedFramer])
@given(sent=payloads, cuts=st.lists(st.integers(0, 1000), max_size=9))
def test_frames_come_back_however_they_are_cut(
    kind: type[LengthFramer | StuffedFramer], sent: list[bytes], cuts: list[int]
) -> None:
    octets = b"".join(kind().frame(chunk) for chunk in sent)
    assert fed(kind(), octets, cuts) == sent


@given(garbage=st.binary(max_size=80), sent=payloads)
def test_every_whole_frame_after_garbage_is_found(garbage: bytes, sent: list[bytes]) -> None:
    framer = StuffedFramer()
    octets = garbage + b"".join(framer.frame(chunk) for chunk in sent)
    assert framer.feed(octets)[-len(sent) :] == sent or not sent


@given(sent=st.binary(min_size=1, max_size=60), data=st.data())
def test_a_damaged_frame_is_never_taken_for_a_message(sent: bytes, data: st.DataObject) -> None:
    framer = StuffedFramer()
    octets = bytearray(framer.frame(sent))
    place = data.draw(st.integers(1, len(octets) - 2))
    octets[place] ^= data.draw(st.integers(1, 255))
    assert framer.feed(bytes(octets)) == []
    assert framer.discarded >= 1
    assert framer.feed(framer.frame(MESSAGE)) == [MESSAGE]


@given(st.binary(min_size=1, max_size=200))
def test_flow_control_octets_never_appear(message: bytes) -> None:
    inside = StuffedFramer().frame(message)[1:-1]
    assert not {0x7E, 0x11, 0x13} & set(inside)


def test_the_page_shows_the_frames() -> None:
    page = PAGE.read_text()
    shown = re.search(r"```\n(7E [0-9A-F ]+7E)\n```", page)
    assert shown
    assert StuffedFramer().frame(MESSAGE) == bytes.fromhex(shown[1])
    assert f"`{LengthFramer().frame(MESSAGE)[:4].hex(' ')}` followed by" in page


def test_a_flood_without_end_is_not_kept() -> None:
    framer = StuffedFramer(limit=100)
    for _ in range(1000):
        assert framer.feed(b"x" * 1000) == []
    assert len(framer._buffer) <= 208
    assert framer.feed(framer.frame(b"hello")) == [b"hello"]
    assert framer.discarded == 1


@pytest.mark.parametrize("length", [0, 101, 2**32 - 1])
def test_an_impossible_length_ends_the_line(length: int) -> None:
    framer = LengthFramer(limit=100)
    with pytest.raises(WireError, match="octets, expected 1 to 100"):
        framer.feed(length.to_bytes(4, "big") + b"x")
