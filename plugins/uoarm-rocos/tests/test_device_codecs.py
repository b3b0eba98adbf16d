"""The makers' own frames, octet by octet as documented, and whatever else a line may bring."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from uoarm_rocos._framing import WireError
from uoarm_rocos._structure import fit
from uoarm_rocos.devices._blood_pressure import (
    Measurement,
    Ua767Decoder,
    blood_pressure_catalogue,
    ua767_frame,
)
from uoarm_rocos.devices._oximeters import (
    MARK,
    ContecDecoder,
    MarkedFrames,
    Nonin1Decoder,
    Nonin2Decoder,
    OximeterDecoder,
    contec_frame,
    nonin1_frame,
    nonin2_packet,
    oximeter_catalogue,
)

DECODERS = [ContecDecoder, Nonin1Decoder, Nonin2Decoder]
OUTPUT = oximeter_catalogue("any", 1.0).apis["pulseOximetry"].output
READING = blood_pressure_catalogue().apis["bloodPressure"].output


@pytest.mark.parametrize(
    ("octets", "message"),
    [
        # sync + strength 5 | wave 64 | bar 7 | pulse 72 | SpO2 97
        (
            "85 40 07 48 61",
            {"quality": "good", "pulse": 72, "spo2": 97, "beat": False, "signal": 5},
        ),
        # beep | wave 127 | bit 7 of the pulse: 128 + 2 | SpO2 100
        (
            "C6 7F 4F 02 64",
            {"quality": "good", "pulse": 130, "spo2": 100, "beat": True, "signal": 6},
        ),
        # SpO2 dropping is no matter of quality
        (
            "A5 00 00 48 5A",
            {"quality": "good", "pulse": 72, "spo2": 90, "beat": False, "signal": 5},
        ),
        # finger out: whatever numbers stand there are none
        ("90 40 00 48 61", {"quality": "finger-out", "beat": False, "signal": 0}),
        # searching: the wave is measured, pulse and saturation are not
        ("83 20 20 48 61", {"quality": "searching", "beat": False, "signal": 3}),
        ("85 40 10 48 61", {"quality": "probe-error", "beat": False, "signal": 5}),
        # pulse 0 and saturation 0 or beyond 100 are no readings
        ("85 40 07 00 61", {"quality": "good", "spo2": 97, "beat": False, "signal": 5}),
        ("85 40 07 48 7F", {"quality": "good", "pulse": 72, "beat": False, "signal": 5}),
        ("85 40 00 00 00", {"quality": "searching", "beat": False, "signal": 5}),
    ],
)
def test_contec_frames(octets: str, message: dict[str, Any]) -> None:
    frame = bytes.fromhex(octets)
    (got,) = ContecDecoder().feed(frame)
    wave = got.pop("waveform", None)
    assert got == message
    assert wave == (None if message["quality"] in {"finger-out", "probe-error"} else frame[1] / 127)


@pytest.mark.parametrize(
    ("octets", "message"),
    [
        ("80 48 61", {"quality": "good", "pulse": 72, "spo2": 97}),
        ("81 04 62", {"quality": "good", "pulse": 132, "spo2": 98}),  # bit 7 of the rate
        ("83 7F 7F", {"quality": "searching"}),  # 511 and 127: no readings
        ("C0 48 61", {"quality": "probe-error"}),
        ("A0 48 61", {"quality": "searching"}),
        ("90 48 61", {"quality": "weak", "pulse": 72, "spo2": 97}),
        ("88 48 61", {"quality": "weak", "pulse": 72, "spo2": 97}),
        ("84 48 61", {"quality": "artifact", "pulse": 72, "spo2": 97}),
        ("83 7F 61", {"quality": "good", "spo2": 97}),
    ],
)
def test_nonin_format_1_frames(octets: str, message: dict[str, Any]) -> None:
    assert Nonin1Decoder().feed(bytes.fromhex(octets)) == [message]


def test_nonin_format_2_frames() -> None:
    decoder = Nonin2Decoder()
    # start, status with sync, wave, rate MSB, sum; then rate LSB; then saturation
    got = decoder.feed(bytes.fromhex("01 81 33 01 B6  01 80 66 04 EB  01 80 FF 61 E1"))
    assert [item["waveform"] for item in got] == [0.2, 0.4, 1.0]
    assert "pulse" not in got[1]  # the packet has not said it yet
    assert (got[2]["pulse"], got[2]["spo2"], got[2]["quality"]) == (132, 97, "good")


@pytest.mark.parametrize(
    ("flags", "quality"),
    [(0x40, "probe-error"), (0x08, "probe-error"), (0x10, "searching"), (0x20, "artifact"),
     (0x04, "weak"), (0x02, "weak"), (0x06, "good")],
)  # fmt: skip
def test_nonin_format_2_quality(flags: int, quality: str) -> None:
    decoder = Nonin2Decoder()
    decoder.feed(b"".join(nonin2_packet([9] * 25, rate=70, spo2=96)))
    last = decoder.feed(b"".join(nonin2_packet([9] * 25, rate=70, spo2=96, flags=flags)))[-1]
    assert last["quality"] == quality
    assert ("pulse" in last) == (quality not in {"probe-error", "searching"})


def test_a_nonin_packet_with_a_gap_gives_no_number_of_the_wrong_frame() -> None:
    decoder = Nonin2Decoder()
    frames = nonin2_packet([9] * 25, rate=70, spo2=96)
    del frames[1]
    frames.insert(1, b"\x00")  # the gap is seen by its octet
    got = decoder.feed(b"".join(frames))
    assert all("pulse" not in item for item in got)
    assert decoder.discarded == 1


@given(
    pulse=st.integers(1, 254),
    spo2=st.integers(1, 100),
    wave=st.integers(0, 127),
    strength=st.integers(0, 15),
    beep=st.booleans(),
)
def test_contec_round_trip(pulse: int, spo2: int, wave: int, strength: int, beep: bool) -> None:
    frame = contec_frame(pulse=pulse, spo2=spo2, wave=wave, strength=strength, beep=beep)
    (got,) = ContecDecoder().feed(frame)
    assert got == {
        "quality": "good", "pulse": pulse, "spo2": spo2, "waveform": wave / 127,
        "beat": beep, "signal": strength,
    }  # fmt: skip


@given(rate=st.integers(1, 510), spo2=st.integers(1, 100))
def test_nonin_round_trips(rate: int, spo2: int) -> None:
    assert Nonin1Decoder().feed(nonin1_frame(rate=rate, spo2=spo2)) == [
        {"quality": "good", "pulse": rate, "spo2": spo2}
    ]
    last = Nonin2Decoder().feed(b"".join(nonin2_packet([0] * 25, rate=rate, spo2=spo2)))[-1]
    assert (last["pulse"], last["spo2"]) == (rate, spo2)


@pytest.mark.parametrize("kind", DECODERS)
@given(data=st.binary(max_size=300), cuts=st.lists(st.integers(0, 300), max_size=5))
def test_any_octets_give_messages_that_fit_however_they_are_cut(
    kind: type[OximeterDecoder], data: bytes, cuts: list[int]
) -> None:
    whole = kind().feed(data)
    for message in whole:
        fit(OUTPUT, message, "message")
    decoder, pieces, last = kind(), [], 0
    for cut in [*sorted(cuts), len(data)]:
        pieces += decoder.feed(data[last:cut])
        last = min(cut, len(data))
    assert pieces == whole


@pytest.mark.parametrize("kind", DECODERS)
@given(garbage=st.binary(max_size=40))
def test_a_decoder_finds_its_frames_again_after_garbage(
    kind: type[OximeterDecoder], garbage: bytes
) -> None:
    frames = {
        ContecDecoder: [contec_frame(pulse=61, spo2=95, strength=4)] * 3,
        Nonin1Decoder: [nonin1_frame(rate=61, spo2=95)] * 3,
        Nonin2Decoder: nonin2_packet([7] * 25, rate=61, spo2=95) * 2,
    }
    got = kind().feed(garbage + b"".join(frames[kind]))[-1]
    assert (got["pulse"], got["spo2"]) == (61, 95)


@given(data=st.binary(max_size=60), size=st.integers(1, 7))
def test_every_octet_is_in_a_frame_or_counted(data: bytes, size: int) -> None:
    frames = MarkedFrames(size, bytes)
    found = frames.feed(data + bytes([MARK]) + bytes(size - 1))
    assert all(frame[0] & MARK and len(frame) == size for frame in found)
    assert not any(octet & MARK for frame in found for octet in frame[1:])
    assert size * len(found) + frames.discarded == len(data) + size


HEADER = struct.pack("<HIHB", 2, 10, 767, 0) + bytes(51)  # type, payload, device, flag, the rest


def test_the_monitors_reading_on_record() -> None:
    """The reading that the wiki shows: 105 over 76 mm Hg, pulse 65, mean 82."""
    assert len(HEADER) == 60
    assert Ua767Decoder().feed(HEADER + b"801D4C4152") == [
        {"systolic": 105, "diastolic": 76, "pulse": 65, "mean": 82, "battery": 0}
    ]


def test_the_monitors_header_is_read() -> None:
    header = bytearray(HEADER)
    header[9:16] = struct.pack("<H5B", 2026, 11, 21, 9, 5, 7)
    header[35:47] = b"5060200123\x00\x00"
    header[57] = 42
    (got,) = Ua767Decoder().feed(bytes(header) + b"801D4C4152")
    assert isinstance(got, dict)
    assert got["measured"] == "2026-11-21T09:05:07"
    assert (got["serialNumber"], got["battery"]) == ("5060200123", 42)


@pytest.mark.parametrize(
    "measured",
    [
        (2026, 13, 1, 0, 0, 0),
        (2026, 2, 30, 0, 0, 0),
        (2026, 1, 1, 24, 0, 0),
        (2026, 1, 1, 200, 200, 200),
        (65535, 1, 1, 0, 0, 0),
    ],
    ids=str,
)
def test_a_time_that_is_none_is_left_out(measured: tuple[int, int, int, int, int, int]) -> None:
    (got,) = Ua767Decoder().feed(ua767_frame(Measurement(120, 80, 93, 60, measured)))
    assert isinstance(got, dict)
    assert got["systolic"] == 120
    assert "measured" not in got


@pytest.mark.parametrize("payload", [b"811D4C4152", b"80XX4C4152", b"          ", b"801D4C415\x00"])
def test_a_payload_that_is_no_measurement_is_an_error(payload: bytes) -> None:
    (got,) = Ua767Decoder().feed(HEADER + payload)
    assert isinstance(got, WireError)


@given(
    low=st.integers(0, 255),
    difference=st.integers(0, 255),
    pulse=st.integers(0, 255),
    garbage=st.binary(max_size=90),
)
def test_readings_come_through_garbage(
    low: int, difference: int, pulse: int, garbage: bytes
) -> None:
    reading = Measurement(low + difference, low, low, pulse)
    got = Ua767Decoder().feed(garbage + ua767_frame(reading))
    assert got
    last = got[-1]
    assert isinstance(last, dict)
    assert (last["systolic"], last["diastolic"], last["pulse"]) == (low + difference, low, pulse)


@given(st.binary(max_size=400))
def test_any_octets_after_a_header_give_a_reading_that_fits_or_an_error(data: bytes) -> None:
    for got in Ua767Decoder().feed(HEADER[:8] + data):
        assert isinstance(got, WireError) or fit(READING, got, "reading")


@given(st.lists(st.binary(max_size=100), max_size=20))
def test_a_flood_is_not_kept(parts: list[bytes]) -> None:
    for decoder in (Ua767Decoder(), Nonin2Decoder()):
        for part in parts:
            decoder.feed(part)
            assert len(decoder._buffer) < 70
