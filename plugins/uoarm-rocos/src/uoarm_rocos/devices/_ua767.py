"""A&D UA-767PBT blood-pressure monitor: a header of 60 octets and a reading of ten hex digits.

Layout as the wiki of Seneca CDOT documents it. The monitor sends a reading and waits for `PWA1`
(accepted) or `PWA0` (not understood).
"""

from __future__ import annotations

import re
import struct
from typing import Any

from attrs import frozen

from uoarm_rocos._catalogue import Api, Catalogue, Kind
from uoarm_rocos._errors import WireError
from uoarm_rocos._fields import IntegerField, Member, StringField

__all__ = [
    "ACCEPTED",
    "REFUSED",
    "Measurement",
    "Ua767Decoder",
    "blood_pressure_catalogue",
    "ua767_frame",
]

ACCEPTED, REFUSED = b"PWA1", b"PWA0"
_HEADER = 60
_PAYLOAD = 10
# Type 2, ten octets of payload, device 767: how a frame begins.
_BEGIN = struct.pack("<HIH", 2, _PAYLOAD, 767)
_MEASURED = 9
_TIME = struct.Struct("<H5B")
_SERIAL = slice(35, 47)
_BATTERY = 57
_READING = re.compile(rb"80([0-9A-Fa-f]{2})([0-9A-Fa-f]{2})([0-9A-Fa-f]{2})([0-9A-Fa-f]{2})")
_MOST = 255
_LEAST_YEAR = 2000


def blood_pressure_catalogue() -> Catalogue:
    """Return the one service of the monitor, `bloodPressure`."""
    pressure = IntegerField(0, 2 * _MOST, "mm[Hg]")
    output = {
        "systolic": Member(pressure),
        "diastolic": Member(IntegerField(0, _MOST, "mm[Hg]")),
        "mean": Member(IntegerField(0, _MOST, "mm[Hg]")),
        "pulse": Member(IntegerField(0, _MOST, "/min")),
        "measured": Member(StringField(max_length=19), required=False),
        "serialNumber": Member(StringField(max_length=12), required=False),
        "battery": Member(IntegerField(0, _MOST)),
    }
    text = "Waits for the next measurement: the person starts it at the monitor."
    api = Api("bloodPressure", Kind.SERVICE, {}, output, None, text)
    return Catalogue("A&D UA-767PBT", {api.name: api})


class Ua767Decoder:
    """Finds frames by their first eight octets."""

    def __init__(self) -> None:
        self.discarded = 0
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[dict[str, Any] | WireError]:
        """Return a reading, or what is wrong with it, for each frame that is complete."""
        self._buffer += data
        found: list[dict[str, Any] | WireError] = []
        while True:
            start = self._buffer.find(_BEGIN)
            if start < 0:
                start = max(0, len(self._buffer) - len(_BEGIN) + 1)
            self.discarded += start
            del self._buffer[:start]
            if len(self._buffer) < _HEADER + _PAYLOAD:
                return found
            frame = bytes(self._buffer[: _HEADER + _PAYLOAD])
            del self._buffer[: _HEADER + _PAYLOAD]
            found.append(_read(frame))


def _read(frame: bytes) -> dict[str, Any] | WireError:
    payload = frame[_HEADER:]
    digits = _READING.fullmatch(payload)
    if digits is None:
        return WireError(
            f"the monitor sent no measurement: expected 80 and 8 digits, got {payload!r}"
        )
    difference, diastolic, pulse, mean = (int(group, 16) for group in digits.groups())
    reading: dict[str, Any] = {
        "systolic": diastolic + difference,
        "diastolic": diastolic,
        "mean": mean,
        "pulse": pulse,
        "battery": frame[_BATTERY],
    }
    year, month, day, hour, minute, second = _TIME.unpack_from(frame, _MEASURED)
    if year >= _LEAST_YEAR and month and day:  # the monitor's clock has been set
        reading["measured"] = f"{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}"[
            :19
        ]
    serial = frame[_SERIAL].rstrip(b"\x00 ")
    if serial and serial.isascii() and serial.decode("ascii").isprintable():
        reading["serialNumber"] = serial.decode("ascii")
    return reading


@frozen
class Measurement:
    """A reading to be sent; `measured` is year, month, day, hour, minute, second."""

    systolic: int
    diastolic: int
    mean: int
    pulse: int
    measured: tuple[int, int, int, int, int, int] = (0, 0, 0, 0, 0, 0)


def ua767_frame(reading: Measurement, *, serial: bytes = b"", battery: int = 0) -> bytes:
    """Return the frame that the monitor sends, as the simulator needs it."""
    header = bytearray(_HEADER)
    header[: len(_BEGIN)] = _BEGIN
    _TIME.pack_into(header, _MEASURED, *reading.measured)
    _TIME.pack_into(header, 16, *reading.measured)
    header[_SERIAL] = serial[:12].ljust(12, b"\x00")
    header[_BATTERY] = battery
    difference = reading.systolic - reading.diastolic
    numbers = (difference, reading.diastolic, reading.pulse, reading.mean)
    return bytes(header) + b"80" + b"".join(b"%02X" % number for number in numbers)
