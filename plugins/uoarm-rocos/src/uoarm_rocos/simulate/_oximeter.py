"""Simulated pulse oximeters that send the frames of their models."""

from __future__ import annotations

from attrs import frozen

from uoarm_rocos.devices._contec import contec_frame
from uoarm_rocos.devices._nonin import nonin1_frame, nonin2_packet
from uoarm_rocos.simulate._vitals import Person

__all__ = ["FORMATS", "Oximeter", "Story"]

FORMATS = ("contec", "nonin-1", "nonin-2")
_CONTEC_HZ, _NONIN_1_HZ, _NONIN_2_HZ = 60, 1, 75
_PACKET = 25
_BEEP_FRAMES = 6
_MOST_LATE = 1.0


@frozen
class Story:
    """What happens to the finger, in seconds after the device is switched on.

    Attributes:
        finger_in: when the finger is put in; before, the device says so and measures nothing.
        found: how long the device then searches for the pulse.
        finger_out: when the finger is taken out again; None: never.
    """

    finger_in: float = 0.0
    found: float = 3.0
    finger_out: float | None = None

    def state(self, time: float) -> str:
        """Return `finger-out`, `searching` or `good`."""
        gone = self.finger_out is not None and time >= self.finger_out
        if gone or time < self.finger_in:
            return "finger-out"
        return "searching" if time < self.finger_in + self.found else "good"


class Oximeter:
    """One oximeter, on since it was made.

    Args:
        kind: one of `FORMATS`.
        person: whose finger it is.
        story: what happens to the finger.
    """

    def __init__(self, kind: str, person: Person | None = None, story: Story | None = None) -> None:
        makers = {
            "contec": (_CONTEC_HZ, self._contec),
            "nonin-1": (_NONIN_1_HZ, self._nonin_1),
            "nonin-2": (_NONIN_2_HZ, self._nonin_2),
        }
        self._hertz, self._make = makers[kind]
        self._person = person or Person()
        self._story = story or Story()
        self._on: float | None = None
        self._count = 0
        self._beat, self._beeping = 0, 0
        self._packet: list[bytes] = []

    def begin(self, now: float) -> None:
        """Go on: an oximeter does not know who listens."""
        self._on = now if self._on is None else self._on

    def receive(self, data: bytes, now: float) -> list[bytes]:
        """Ignore what the host says."""
        del data, now
        return []

    def step(self, now: float) -> list[bytes]:
        """Return the frames that are due; after a pause of the program those are skipped."""
        assert self._on is not None
        due = int((now - self._on) * self._hertz)
        self._count = max(self._count, due - int(_MOST_LATE * self._hertz))
        frames = []
        while self._count < due:
            frames += self._make(self._count / self._hertz)
            self._count += 1
        return frames

    def _contec(self, time: float) -> list[bytes]:
        state, vitals = self._story.state(time), self._person.at(time)
        if state == "finger-out":
            return [contec_frame(finger_out=True)]
        wave = round(vitals.wave * 127)
        if state == "searching":
            return [contec_frame(searching=True, wave=wave, strength=3)]
        if vitals.beat != self._beat:
            self._beat, self._beeping = vitals.beat, _BEEP_FRAMES
        self._beeping = max(0, self._beeping - 1)
        return [
            contec_frame(
                pulse=round(vitals.pulse),
                spo2=round(vitals.spo2),
                wave=wave,
                strength=6,
                beep=self._beeping > 0,
            )
        ]

    def _nonin_1(self, time: float) -> list[bytes]:
        state, vitals = self._story.state(time), self._person.at(time)
        if state != "good":
            return [nonin1_frame(flags=0x40 if state == "finger-out" else 0x20)]
        return [nonin1_frame(rate=round(vitals.pulse), spo2=round(vitals.spo2))]

    def _nonin_2(self, time: float) -> list[bytes]:
        if not self._packet:
            self._packet = self._nonin_2_packet(time)
        return [self._packet.pop(0)]

    def _nonin_2_packet(self, time: float) -> list[bytes]:
        state = self._story.state(time)
        if state == "finger-out":
            return nonin2_packet([0] * _PACKET, flags=0x40)
        times = [time + n / _NONIN_2_HZ for n in range(_PACKET)]
        wave = [round(self._person.at(value).wave * 255) for value in times]
        if state == "searching":
            return nonin2_packet(wave, flags=0x10)
        vitals = self._person.at(time)
        return nonin2_packet(wave, rate=round(vitals.pulse), spo2=round(vitals.spo2))
