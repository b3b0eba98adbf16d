"""Contec CMS50D+ (firmware before 4.6): five octets, sixty times a second.

Layout as the CMS50Dplus project on GitHub (atbrask) documents it; 19200 baud, 8 data bits, odd
parity, XON/XOFF.
"""

from __future__ import annotations

from typing import Any

from uoarm_rocos.devices._marked import MARK, MarkedFrames
from uoarm_rocos.devices._oximetry import reading

__all__ = ["PERIOD", "ContecDecoder", "contec_frame"]

PERIOD = 1 / 60
_SIZE = 5
_BEEP, _FINGER_OUT, _STRENGTH = 0x40, 0x10, 0x0F
_PULSE_BIT_7, _SEARCHING, _PROBE_ERROR = 0x40, 0x20, 0x10
_WAVE_MOST = 127
_NO_PULSE = {0, 255}


class ContecDecoder:
    """Makes messages of frames."""

    def __init__(self) -> None:
        self._frames = MarkedFrames(_SIZE)

    @property
    def discarded(self) -> int:
        """Octets that belonged to no frame."""
        return self._frames.discarded

    def feed(self, data: bytes) -> list[dict[str, Any]]:
        """Return the messages that are complete with these octets."""
        return [_message(frame) for frame in self._frames.feed(data)]


def _message(frame: bytes) -> dict[str, Any]:
    flags, wave, more, low, spo2 = frame
    pulse = (more & _PULSE_BIT_7) << 1 | low
    quality = "good"
    if more & _PROBE_ERROR:
        quality = "probe-error"
    elif flags & _FINGER_OUT:
        quality = "finger-out"
    elif more & _SEARCHING or (pulse in _NO_PULSE and not spo2):
        quality = "searching"
    return reading(
        quality,
        pulse=None if pulse in _NO_PULSE else pulse,
        spo2=spo2,
        waveform=wave / _WAVE_MOST,
        beat=bool(flags & _BEEP),
        signal=flags & _STRENGTH,
    )


def contec_frame(
    *,
    pulse: int = 0,
    spo2: int = 0,
    wave: int = 0,
    strength: int = 0,
    beep: bool = False,
    finger_out: bool = False,
    searching: bool = False,
) -> bytes:
    """Return the frame that a device sends, as the simulator needs it."""
    flags = MARK | strength & _STRENGTH | beep * _BEEP | finger_out * _FINGER_OUT
    bar = wave * _STRENGTH // _WAVE_MOST
    more = (pulse & 0x80) >> 1 | searching * _SEARCHING | bar
    return bytes([flags, wave & 0x7F, more, pulse & 0x7F, spo2 & 0x7F])
