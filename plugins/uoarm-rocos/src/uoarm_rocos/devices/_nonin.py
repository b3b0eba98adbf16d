"""Nonin serial formats 1 (three octets a second) and 2 (75 frames of five octets a second).

Layouts as Nonin's OEM documents have them; 9600 baud, 8 data bits, no parity.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from uoarm_rocos.devices._marked import MARK, MarkedFrames
from uoarm_rocos.devices._oximetry import reading

__all__ = [
    "PERIOD_1",
    "PERIOD_2",
    "Nonin1Decoder",
    "Nonin2Decoder",
    "nonin1_frame",
    "nonin2_packet",
]

PERIOD_1 = 1.0
PERIOD_2 = 1 / 75
_NO_RATE, _NO_SPO2 = 511, 127
_SYNC = 0x80

_SIZE_1 = 3
_SIZE_2 = 5
_PACKET = 25
_START = 0x01
_WAVE_MOST = 255


class Nonin1Decoder:
    """Makes messages of frames; each says everything."""

    def __init__(self) -> None:
        self._frames = MarkedFrames(_SIZE_1)

    @property
    def discarded(self) -> int:
        """Octets that belonged to no frame."""
        return self._frames.discarded

    def feed(self, data: bytes) -> list[dict[str, Any]]:
        """Return the messages that are complete with these octets."""
        return [_message_1(*frame) for frame in self._frames.feed(data)]


class Nonin2Decoder:
    """Finds frames by start octet and checksum; rate and saturation come once a packet."""

    def __init__(self) -> None:
        self.discarded = 0
        self._buffer = bytearray()
        self._place = 0
        self._high = 0
        self._rate = _NO_RATE
        self._low = 0
        self._spo2 = _NO_SPO2

    def feed(self, data: bytes) -> list[dict[str, Any]]:
        """Return the messages that are complete with these octets."""
        self._buffer += data
        found, start = [], 0
        while len(self._buffer) - start >= _SIZE_2:
            frame = self._buffer[start : start + _SIZE_2]
            if frame[0] == _START and frame[1] & _SYNC and sum(frame[:4]) & 0xFF == frame[4]:
                found.append(self._take(bytes(frame)))
                start += _SIZE_2
            else:
                self._lose()
                start += 1
        del self._buffer[:start]
        return found

    def _lose(self) -> None:
        """A gap: what belongs to which frame is unknown until the next packet."""
        self.discarded += 1
        self._place = 0

    def _take(self, frame: bytes) -> dict[str, Any]:
        _, status, wave, data, _ = frame
        if status & 1:
            self._place = 1
        elif 0 < self._place < _PACKET:
            self._place += 1
        else:
            self._place = 0
        if self._place == 1:
            self._high = data
        elif self._place == 2:  # noqa: PLR2004 - the second frame
            self._low = data
        elif self._place == 3:  # noqa: PLR2004 - the third frame
            self._rate = (self._high & 3) << 7 | self._low & 0x7F
            self._spo2 = data & 0x7F
        quality = _quality_2(status)
        if quality in {"searching", "probe-error"}:
            self._rate, self._spo2 = _NO_RATE, _NO_SPO2
        return _reading(quality, self._rate, self._spo2, wave / _WAVE_MOST)


def _message_1(status: int, low: int, spo2: int) -> dict[str, Any]:
    return _reading(_quality_1(status), (status & 3) << 7 | low, spo2, None)


def _reading(quality: str, rate: int, spo2: int, wave: float | None) -> dict[str, Any]:
    known_rate, known_spo2 = rate not in {0, _NO_RATE}, spo2 != _NO_SPO2
    if not known_rate and not known_spo2 and quality in {"good", "weak"}:
        quality = "searching"
    return reading(
        quality,
        pulse=rate if known_rate else None,
        spo2=spo2 if known_spo2 else None,
        waveform=wave,
    )


def _quality_1(status: int) -> str:
    known = ((0x40, "probe-error"), (0x20, "searching"), (0x04, "artifact"), (0x18, "weak"))
    return _first(status, known)


def _quality_2(status: int) -> str:
    if status & 0x06 == 0x06:  # noqa: PLR2004 - red and yellow together are green
        status &= ~0x06
    known = ((0x48, "probe-error"), (0x10, "searching"), (0x20, "artifact"), (0x06, "weak"))
    return _first(status, known)


def _first(status: int, known: Iterable[tuple[int, str]]) -> str:
    return next((name for mask, name in known if status & mask), "good")


def nonin1_frame(*, rate: int = _NO_RATE, spo2: int = _NO_SPO2, flags: int = 0) -> bytes:
    """Return a frame of format 1, as the simulator needs it."""
    return bytes([MARK | flags | rate >> 7 & 3, rate & 0x7F, spo2 & 0x7F])


def nonin2_packet(
    wave: list[int], *, rate: int = _NO_RATE, spo2: int = _NO_SPO2, flags: int = 0
) -> list[bytes]:
    """Return the 25 frames of a packet of format 2, as the simulator needs them."""
    data = [rate >> 7 & 3, rate & 0x7F, spo2 & 0x7F] + [0] * (_PACKET - 3)
    frames = []
    for place, (level, octet) in enumerate(zip(wave, data, strict=True)):
        first = bytes([_START, _SYNC | flags | (place == 0), level & 0xFF, octet])
        frames.append(first + bytes([sum(first) & 0xFF]))
    return frames
