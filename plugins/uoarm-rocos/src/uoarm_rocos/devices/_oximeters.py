"""Pulse oximeters: what all of them offer, and the decoder of each maker's frames.

A frame has one size, and its first octet alone has the highest bit set.

- Contec CMS50D+ (firmware before 4.6): five octets, sixty times a second. Layout as the CMS50Dplus
  project on GitHub (atbrask) documents it; 19200 baud, 8 data bits, odd parity, XON/XOFF.
- Nonin serial formats 1 (three octets a second) and 2 (75 frames of five octets a second). Layouts
  as Nonin's OEM documents have them; 9600 baud, 8 data bits, no parity.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Generic, Protocol, TypeVar

from uoarm.bridge import ChannelMonitor, Delivery, on_failure
from uoarm_rocos._catalogue import (
    Api,
    ApiKind,
    BooleanField,
    DeviceCatalogue,
    IntegerField,
    NamedField,
    NumberField,
    StringField,
)
from uoarm_rocos._channels import QueuedReceiver, delivery_queue
from uoarm_rocos._device import LineDevice, ReportHealth
from uoarm_rocos._health import flow_monitor
from uoarm_rocos._line import DeviceLine
from uoarm_rocos._options import Timing
from uoarm_rocos._transport import LineTransport

QUALITIES = ("good", "weak", "artifact", "searching", "finger-out", "probe-error")
_NO_NUMBERS = {"searching", "finger-out", "probe-error"}
_NO_WAVE = {"finger-out", "probe-error"}


class OximeterDecoder(Protocol):
    """Makes messages of a device's own frames; does no I/O."""

    @property
    def discarded(self) -> int:
        """Octets that belonged to no frame."""

    def feed(self, data: bytes) -> list[dict[str, Any]]:
        """Return the messages that are complete with these octets; never raises."""


def oximeter_catalogue(device: str, period: float) -> DeviceCatalogue:
    """Return the one flow of an oximeter, `pulseOximetry`."""
    output = {
        "quality": NamedField(StringField(QUALITIES)),
        "pulse": NamedField(IntegerField(1, 510, "/min"), required=False),
        "spo2": NamedField(IntegerField(1, 100, "%"), required=False),
        "waveform": NamedField(NumberField(0.0, 1.0), required=False),
        "beat": NamedField(BooleanField(), required=False),
        "signal": NamedField(IntegerField(0, 15), required=False),
    }
    text = "Pulse, oxygen saturation and pulse wave; what was not measured is left out."
    api = Api("pulseOximetry", ApiKind.FLOW, {}, output, period, text)
    return DeviceCatalogue(device, {api.name: api})


def reading(
    quality: str,
    *,
    pulse: int | None,
    spo2: int | None,
    waveform: float | None = None,
    **more: object,
) -> dict[str, Any]:
    """Return a message; numbers are left out where the quality says there can be none."""
    message: dict[str, Any] = {"quality": quality}
    if quality not in _NO_NUMBERS:
        if pulse is not None:
            message["pulse"] = pulse
        if spo2 is not None and 0 < spo2 <= 100:  # noqa: PLR2004 - per cent
            message["spo2"] = spo2
    if waveform is not None and quality not in _NO_WAVE:
        message["waveform"] = waveform
    message.update(more)
    return message


T = TypeVar("T")
MARK = 0x80


class MarkedFrames(Generic[T]):
    """Finds frames by their mark; a frame that the next mark cuts short is thrown away.

    Args:
        size: octets of a frame.
        read: makes of a frame what `feed` returns.

    Attributes:
        discarded: octets that belonged to no frame.
    """

    def __init__(self, size: int, read: Callable[[bytes], T]) -> None:
        self.discarded = 0
        self._size, self._read = size, read
        self._frame = bytearray()

    def feed(self, data: bytes) -> list[T]:
        """Return what the frames are that are complete with these octets."""
        found = []
        for octet in data:
            if octet & MARK:
                self.discarded += len(self._frame)
                self._frame = bytearray([octet])
            elif self._frame:
                self._frame.append(octet)
            else:
                self.discarded += 1
            if len(self._frame) == self._size:
                found.append(self._read(bytes(self._frame)))
                self._frame = bytearray()
        return found


CONTEC_PERIOD = 1 / 60
_CONTEC_SIZE = 5
_BEEP, _FINGER_OUT, _STRENGTH = 0x40, 0x10, 0x0F
_PULSE_BIT_7, _SEARCHING, _PROBE_ERROR = 0x40, 0x20, 0x10
_CONTEC_WAVE_MOST = 127
_NO_PULSE = {0, 255}


class ContecDecoder(MarkedFrames[dict[str, Any]]):
    """Makes messages of frames."""

    def __init__(self) -> None:
        super().__init__(_CONTEC_SIZE, _contec_message)


def _contec_message(frame: bytes) -> dict[str, Any]:
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
        waveform=wave / _CONTEC_WAVE_MOST,
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
    bar = wave * _STRENGTH // _CONTEC_WAVE_MOST
    more = (pulse & 0x80) >> 1 | searching * _SEARCHING | bar
    return bytes([flags, wave & 0x7F, more, pulse & 0x7F, spo2 & 0x7F])


NONIN_1_PERIOD = 1.0
NONIN_2_PERIOD = 1 / 75
_NO_RATE, _NO_SPO2 = 511, 127
_SYNC = 0x80

_SIZE_1 = 3
_SIZE_2 = 5
_PACKET = 25
_START = 0x01
_NONIN_WAVE_MOST = 255


class Nonin1Decoder(MarkedFrames[dict[str, Any]]):
    """Makes messages of frames; each says everything."""

    def __init__(self) -> None:
        super().__init__(_SIZE_1, _message_1)


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
        return _nonin_reading(quality, self._rate, self._spo2, wave / _NONIN_WAVE_MOST)


def _message_1(frame: bytes) -> dict[str, Any]:
    status, low, spo2 = frame
    return _nonin_reading(_quality_1(status), (status & 3) << 7 | low, spo2, None)


def _nonin_reading(quality: str, rate: int, spo2: int, wave: float | None) -> dict[str, Any]:
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


_PERIODS = 5
_LEAST_SILENCE = 1.0
_ADVICE = "is the device on, and this its port?"


class StreamDevice(LineDevice):
    """Counts as there once a whole frame has come, and as silent when none comes any more.

    Args:
        name: for threads and errors.
        catalogue: with its one flow.
        decoder: makes a decoder for each new connection.
        transport: makes an unopened transport.
        timing: limits.
    """

    def __init__(
        self,
        name: str,
        catalogue: DeviceCatalogue,
        decoder: Callable[[], OximeterDecoder],
        transport: Callable[[], LineTransport],
        timing: Timing,
    ) -> None:
        super().__init__(name)
        self._catalogue = catalogue
        self._make_decoder = decoder
        self._decoder = decoder()
        # Octets of no frame: of connections before this one, and of this one up to its last frame.
        self._discarded_before = self._discarded_then = 0
        self._timing = timing
        (self._api,) = catalogue.apis.values()
        self._patience = max(_PERIODS * (self._api.period or 0.0), _LEAST_SILENCE)
        self._last = time.monotonic()
        self._flows: tuple[_StreamFlow, ...] = ()
        self._deliveries = delivery_queue(name)
        self._line = DeviceLine(name, transport, self, timing.backoff)
        with on_failure(self._deliveries.close):  # the system gives no more threads
            self._line.start()

    def catalogue(self, timeout: float) -> DeviceCatalogue:
        """Return the catalogue once the device sends."""
        self._await(timeout)
        return self._catalogue

    def open_output(
        self, api: Api, deliver: Delivery, report: ReportHealth, timeout: float
    ) -> _StreamFlow:
        """Give messages to one more receiver."""
        self.catalogue(timeout)
        what = f"flow {api.name} of {self.name}"
        monitor = flow_monitor(what, api.period, self._timing.grace, report)
        monitor.connected()
        flow = _StreamFlow(deliver, monitor, self)
        with self._state:
            self._flows = (*self._flows, flow)
        return flow

    def leave(self, flow: _StreamFlow) -> None:
        """Give this receiver nothing more."""
        with self._state:
            self._flows = tuple(
                stream_flow for stream_flow in self._flows if stream_flow is not flow
            )

    def facts(self) -> Mapping[str, object]:
        """Return how many octets belonged to no frame."""
        return {"discarded": self._discarded_before + self._decoder.discarded}

    def _ended(self) -> None:
        self._deliveries.close()

    def connected(self) -> None:
        """Begin with a new decoder."""
        self._discarded_before += self._decoder.discarded
        self._decoder, self._discarded_then = self._make_decoder(), 0
        self._note_no_frame()
        self._last = time.monotonic()

    def received(self, data: bytes) -> None:
        """Decode and hand on."""
        messages = self._decoder.feed(data)
        if not messages:
            if not self._is_there:
                self._note_no_frame()
            return
        self._last, self._discarded_then = time.monotonic(), self._decoder.discarded
        if not self._is_there:
            with self._state:
                self._is_there = True
                self._state.notify_all()
            for flow in self._flows:
                flow.monitor.connected()
        for message in messages:
            for flow in self._flows:
                flow.monitor.passed()
                self._deliveries.put((flow.receiver, message, len(data)))

    def tick(self, now: float) -> None:
        """Notice silence."""
        silent = now - self._last
        if silent > self._patience:
            self._missing(f"no frame from {self.name} for {silent:.1f} s: {self._advice}")

    def lost(self, cause: str) -> None:
        """Notice that the line is gone; called again at each attempt to open it."""
        text = f"the line to {self.name} is lost: {cause}"
        for flow in self._flows:
            flow.monitor.connected(0, text)
        self._missing(text)

    def _missing(self, cause: str) -> None:
        self._cause = cause
        with self._state:
            self._is_there = False
        for flow in self._flows:
            flow.monitor.tick(f": {self._advice}")

    def _note_no_frame(self) -> None:
        self._cause = f"the line is open, but no frame came: {self._advice}"

    @property
    def _advice(self) -> str:
        came = self._decoder.discarded - self._discarded_then
        if not came:
            return _ADVICE
        return f"{came:,} octets came that are no frame: are its `driver`, `url` and `baud` right?"


class _StreamFlow:
    """One receiver of a device's messages."""

    def __init__(
        self,
        deliver: Callable[[Any], None],
        monitor: ChannelMonitor,
        device: StreamDevice,
    ) -> None:
        self.receiver = QueuedReceiver(deliver)
        self.monitor = monitor
        self._device = device

    def facts(self) -> Mapping[str, object]:
        """Return the device's counters and what this receiver was too slow for."""
        lost = {"lost_on_link": self.receiver.dropped}
        return {**self._device.facts(), **lost, **self.monitor.facts()}

    def close(self) -> None:
        """End; no other delivery begins."""
        self.monitor.close()
        self.receiver.close()
        self._device.leave(self)
