"""What every pulse oximeter offers, whatever its frames look like."""

from __future__ import annotations

from typing import Any, Protocol

from uoarm_rocos._catalogue import Api, Catalogue, Kind
from uoarm_rocos._fields import BooleanField, IntegerField, Member, NumberField, StringField

__all__ = ["QUALITIES", "Decoder", "oximeter_catalogue", "reading"]

QUALITIES = ("good", "weak", "artifact", "searching", "finger-out", "probe-error")
_NO_NUMBERS = {"searching", "finger-out", "probe-error"}
_NO_WAVE = {"finger-out", "probe-error"}


class Decoder(Protocol):
    """Makes messages of a device's own frames; does no I/O."""

    @property
    def discarded(self) -> int:
        """Octets that belonged to no frame."""

    def feed(self, data: bytes) -> list[dict[str, Any]]:
        """Return the messages that are complete with these octets; never raises."""


def oximeter_catalogue(device: str, period: float) -> Catalogue:
    """Return the one flow of an oximeter, `pulseOximetry`."""
    output = {
        "quality": Member(StringField(QUALITIES)),
        "pulse": Member(IntegerField(1, 510, "/min"), required=False),
        "spo2": Member(IntegerField(1, 100, "%"), required=False),
        "waveform": Member(NumberField(0.0, 1.0), required=False),
        "beat": Member(BooleanField(), required=False),
        "signal": Member(IntegerField(0, 15), required=False),
    }
    text = "Pulse, oxygen saturation and pulse wave; what was not measured is left out."
    api = Api("pulseOximetry", Kind.FLOW, {}, output, period, text)
    return Catalogue(device, {api.name: api})


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
