"""A&D UA-767PBT blood-pressure monitor: a header of 60 octets and a reading of ten hex digits.

Layout as the wiki of Seneca CDOT documents it. The monitor sends a reading and waits for `PWA1`
(accepted) or `PWA0` (not understood).

The blood-pressure monitor as a device: a call waits for the next measurement.
"""

from __future__ import annotations

import re
import struct
import time
from collections.abc import Callable
from contextlib import suppress
from datetime import datetime
from typing import Any

from attrs import frozen

from uoarm.bridge import Disconnection, HealthReason
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm.model import Health
from uoarm_rocos._catalogue import (
    Api,
    ApiKind,
    DeviceCatalogue,
    IntegerField,
    NamedField,
    StringField,
)
from uoarm_rocos._device import LineDevice, PendingReply
from uoarm_rocos._framing import LineError, WireError
from uoarm_rocos._line import DeviceLine
from uoarm_rocos._options import Timing
from uoarm_rocos._profile import Changed
from uoarm_rocos._structure import fit, fit_given
from uoarm_rocos._transport import LineTransport

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


def blood_pressure_catalogue() -> DeviceCatalogue:
    """Return the one service of the monitor, `bloodPressure`."""
    pressure = IntegerField(0, 2 * _MOST, "mm[Hg]")
    output = {
        "systolic": NamedField(pressure),
        "diastolic": NamedField(IntegerField(0, _MOST, "mm[Hg]")),
        "mean": NamedField(IntegerField(0, _MOST, "mm[Hg]")),
        "pulse": NamedField(IntegerField(0, _MOST, "/min")),
        "measured": NamedField(StringField(max_length=19), required=False),
        "serialNumber": NamedField(StringField(max_length=12), required=False),
        "battery": NamedField(IntegerField(0, _MOST)),
    }
    text = "Waits for the next measurement: the person starts it at the monitor."
    api = Api("bloodPressure", ApiKind.SERVICE, {}, output, None, text)
    return DeviceCatalogue("A&D UA-767PBT", {api.name: api})


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
    year, *others = _TIME.unpack_from(frame, _MEASURED)
    if year >= _LEAST_YEAR:  # the monitor's clock has been set
        with suppress(ValueError):  # octets that are no time
            reading["measured"] = datetime(year, *others).isoformat()  # noqa: DTZ001 - it has none
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


_MOST_CALLS = 100


class Monitor(LineDevice):
    """Acknowledges a measurement only when a call takes it, so that the monitor keeps the others.

    The monitor is silent between measurements: it counts as there when its port is open.
    """

    def __init__(
        self, name: str, transport: Callable[[], LineTransport], timing: Timing, changed: Changed
    ) -> None:
        super().__init__(name)
        self._timing = timing
        self._changed = changed
        self._decoder = Ua767Decoder()
        self._disconnection = Disconnection(timing.grace)
        # Changed in `_state`: a reading is acknowledged only while a call waits for it.
        self._waiting: list[PendingReply] = []
        self._line = DeviceLine(name, transport, self, timing.backoff)
        self._line.start()

    def catalogue(self, timeout: float) -> DeviceCatalogue:
        """Return the catalogue once the port is open."""
        self._await(timeout)
        return blood_pressure_catalogue()

    def call(self, api: Api, message: object, timeout: float) -> dict[str, Any]:
        """Wait for the next measurement."""
        began = time.monotonic()
        fit_given(api.input, message, f"request to {api.name}")
        self.catalogue(min(timeout, self._timing.wait))
        answer = PendingReply()
        with self._state:
            self._check_open()
            if len(self._waiting) >= _MOST_CALLS:
                text = f"{_MOST_CALLS} calls already wait for {self.name}"
                raise BridgeError(text, FailureReason.REFUSED)
            self._waiting.append(answer)
        if not answer.wait(max(0.0, timeout - (time.monotonic() - began))):
            with self._state:
                is_over = answer in self._waiting
                if is_over:
                    self._waiting.remove(answer)
            if is_over:
                raise BridgeTimeoutError(f"{self.name}: no measurement within {timeout:g} s")
            answer.wait(-1)  # it was acknowledged meanwhile: the monitor keeps it no more
        return fit(api.output, answer.value(), f"reading of {self.name}")

    def _ended(self) -> None:
        self._fail(BridgeError(f"{self.name} was closed", FailureReason.CLOSED))

    def connected(self) -> None:
        """Begin with a new decoder."""
        self._decoder = Ua767Decoder()
        with self._state:
            self._is_there = True
            self._state.notify_all()
        self._disconnection.up()
        self._changed(Health.OK, "the port is open", None)

    def received(self, data: bytes) -> None:
        """Answer each frame: accepted when a call takes it, refused when it is no reading."""
        for reading in self._decoder.feed(data):
            if isinstance(reading, WireError):
                self._line.send(REFUSED)
                continue
            with self._state:
                if self._waiting:
                    self._line.send(ACCEPTED)
                waiting, self._waiting = self._waiting, []
            for answer in waiting:
                answer.give(reading)

    def tick(self, now: float) -> None:
        """Nothing is due: the monitor speaks after a measurement."""

    def lost(self, cause: str) -> None:
        """Fail the calls that wait."""
        with self._state:
            self._is_there, self._cause = False, cause
        text = f"the line to {self.name} is lost: {cause}"
        health = self._disconnection.down(time.monotonic(), final=False)
        if health is not None:
            self._changed(health, f"{HealthReason.DISCONNECTED.value}: {text}", None)
        self._fail(LineError(text))

    def _fail(self, error: BridgeError) -> None:
        with self._state:
            waiting, self._waiting = self._waiting, []
        for answer in waiting:
            answer.fail(error)
