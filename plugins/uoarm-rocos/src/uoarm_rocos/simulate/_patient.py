"""A modelled person: pulse wave, heart rate, oxygen saturation and blood pressure over time.

The pulse wave is the sum of two Gaussian functions over one beat, the form wave and the reflected
wave, as in Tang, Chen, Allen, Alian, Menon, Ward, Elgendi: "Synthetic photoplethysmogram generation
using two Gaussian functions" (Scientific Reports 10, 13883, 2020). The heart rate swings with the
breath (respiratory sinus arrhythmia, about 0.25 Hz) and with the Mayer waves of the blood pressure
(about 0.1 Hz), the two bands that the ECG model of McSharry, Clifford, Tarassenko and Smith (IEEE
Trans. Biomedical Engineering 50, 289-294, 2003) has as well. Every number is a smooth function of
time alone: there are no dice, and the same second always looks the same.

The simulated devices that measure this person: pulse oximeters, which send the frames of their
models, and an A&D UA-767PBT, whose readings each wait to be acknowledged.
"""

from __future__ import annotations

import math
from collections import deque

from attrs import frozen

from uoarm_rocos.devices._blood_pressure import ACCEPTED, REFUSED, Measurement, ua767_frame
from uoarm_rocos.devices._oximeters import contec_frame, nonin1_frame, nonin2_packet

_BREATH_HZ, _MAYER_HZ = 0.25, 0.1
_BREATH_SWING, _MAYER_SWING = 3.0, 2.0
# Height, place in the beat (radians from -pi to pi) and width of each Gaussian.
_WAVES = ((0.82, -math.pi / 2, 0.6), (0.40, 0.0, 1.0))
_HEIGHT = 0.97
_BREATH_ON_WAVE = 0.08
_TURN = 2 * math.pi


@frozen
class VitalSigns:
    """One moment: beats a minute, per cent, height of the pulse wave from 0 to 1, mm Hg.

    Attributes:
        beat: how many beats have begun since time 0.
    """

    pulse: float
    spo2: float
    wave: float
    beat: int
    systolic: float
    diastolic: float

    @property
    def mean(self) -> float:
        """Mean arterial pressure by the rule of one third."""
        return self.diastolic + (self.systolic - self.diastolic) / 3


@frozen
class Person:
    """The person who is simulated: means over time.

    Attributes:
        pulse: beats a minute.
        spo2: per cent.
        apnoea: seconds from one pause of breath to the next, during which the saturation falls
            by up to six points and recovers; 0: never.
    """

    pulse: float = 72.0
    spo2: float = 97.0
    systolic: float = 118.0
    diastolic: float = 76.0
    apnoea: float = 0.0

    def at(self, time: float) -> VitalSigns:
        """Return the vital signs at a time in seconds."""
        breath, mayer = _TURN * _BREATH_HZ * time, _TURN * _MAYER_HZ * time
        beats = self._beats(time, breath, mayer)
        return VitalSigns(
            pulse=self.pulse + _BREATH_SWING * math.sin(breath) + _MAYER_SWING * math.sin(mayer),
            spo2=self.spo2 - self._desaturation(time),
            wave=_wave(beats, breath),
            beat=math.floor(beats),
            systolic=self.systolic + 4 * math.sin(mayer) + 2 * math.sin(breath),
            diastolic=self.diastolic + 2 * math.sin(mayer) + math.sin(breath),
        )

    def _beats(self, time: float, breath: float, mayer: float) -> float:
        """Return the integral of the heart rate, in beats."""
        swing = _BREATH_SWING * (1 - math.cos(breath)) / (_TURN * _BREATH_HZ)
        slow = _MAYER_SWING * (1 - math.cos(mayer)) / (_TURN * _MAYER_HZ)
        return (self.pulse * time + swing + slow) / 60

    def _desaturation(self, time: float) -> float:
        if not self.apnoea:
            return 0.0
        place = time % self.apnoea / self.apnoea
        return 6 * math.sin(math.pi * place) ** 4


def _wave(beats: float, breath: float) -> float:
    angle = (beats % 1) * _TURN - math.pi
    height = 0.0
    for size, middle, width in _WAVES:
        away = math.remainder(angle - middle, _TURN)
        height += size * math.exp(-(away**2) / (2 * width**2))
    height *= 1 + _BREATH_ON_WAVE * (math.sin(breath) - 1)
    return min(1.0, max(0.0, height / _HEIGHT))


FORMATS = ("contec", "nonin-1", "nonin-2")
_CONTEC_HZ, _NONIN_1_HZ, _NONIN_2_HZ = 60, 1, 75
_PACKET = 25
_BEEP_FRAMES = 6
_MOST_LATE = 1.0


@frozen
class Scenario:
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
        scenario: what happens to the finger.
    """

    def __init__(
        self, kind: str, person: Person | None = None, scenario: Scenario | None = None
    ) -> None:
        makers = {
            "contec": (_CONTEC_HZ, self._contec),
            "nonin-1": (_NONIN_1_HZ, self._nonin_1),
            "nonin-2": (_NONIN_2_HZ, self._nonin_2),
        }
        self._hertz, self._make = makers[kind]
        self._person = person or Person()
        self._scenario = scenario or Scenario()
        self._on: float | None = None
        self._count = 0
        self._beat, self._beeping = 0, 0
        self._packet: list[bytes] = []

    def begin(self, now: float) -> None:
        """Go on: an oximeter does not know its listeners."""
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
        state, vitals = self._scenario.state(time), self._person.at(time)
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
        state, vitals = self._scenario.state(time), self._person.at(time)
        if state != "good":
            return [nonin1_frame(flags=0x40 if state == "finger-out" else 0x20)]
        return [nonin1_frame(rate=round(vitals.pulse), spo2=round(vitals.spo2))]

    def _nonin_2(self, time: float) -> list[bytes]:
        if not self._packet:
            self._packet = self._nonin_2_packet(time)
        return [self._packet.pop(0)]

    def _nonin_2_packet(self, time: float) -> list[bytes]:
        state = self._scenario.state(time)
        if state == "finger-out":
            return nonin2_packet([0] * _PACKET, flags=0x40)
        times = [time + n / _NONIN_2_HZ for n in range(_PACKET)]
        wave = [round(self._person.at(value).wave * 255) for value in times]
        if state == "searching":
            return nonin2_packet(wave, flags=0x10)
        vitals = self._person.at(time)
        return nonin2_packet(wave, rate=round(vitals.pulse), spo2=round(vitals.spo2))


_AGAIN_SECONDS = 2.0
_MOST_KEPT = 40
_MOST_ANSWERS = 1000


class BloodPressureMonitor:
    """Measures every `interval` seconds; sends the oldest reading until it is accepted.

    Attributes:
        answers: what the host has answered, in order.
    """

    def __init__(self, person: Person | None = None, interval: float = 5.0) -> None:
        self.answers: deque[bytes] = deque(maxlen=_MOST_ANSWERS)
        self._person = person or Person()
        self._interval = interval
        self._on: float | None = None
        self._measured = 0
        self._kept: deque[bytes] = deque(maxlen=_MOST_KEPT)
        self._sent = -math.inf
        self._received = b""

    def begin(self, now: float) -> None:
        """Go on: readings that were not accepted are kept."""
        self._on = now if self._on is None else self._on
        self._sent = -math.inf

    def receive(self, data: bytes, now: float) -> list[bytes]:
        """Take an answer to the reading that was sent."""
        del now
        self._received = (self._received + data)[-64:]
        while True:
            places = {word: self._received.find(word) for word in (ACCEPTED, REFUSED)}
            known = {place: word for word, place in places.items() if place >= 0}
            if not known:
                return []
            first = min(known)
            word = known[first]
            self._received = self._received[first + len(word) :]
            self.answers.append(word)
            if word == ACCEPTED and self._kept:
                self._kept.popleft()
                self._sent = -math.inf

    def step(self, now: float) -> list[bytes]:
        """Measure when it is time, and send what waits."""
        assert self._on is not None
        if now - self._on >= (self._measured + 1) * self._interval:
            self._measured += 1
            self._kept.append(self._measure(now - self._on))
        if not self._kept or now - self._sent < _AGAIN_SECONDS:
            return []
        self._sent = now
        return [self._kept[0]]

    def _measure(self, time: float) -> bytes:
        vitals = self._person.at(time)
        numbers = (vitals.systolic, vitals.diastolic, vitals.mean, vitals.pulse)
        systolic, diastolic, mean, pulse = (round(number) for number in numbers)
        return ua767_frame(Measurement(systolic, diastolic, mean, pulse), serial=b"SIMULATED")
