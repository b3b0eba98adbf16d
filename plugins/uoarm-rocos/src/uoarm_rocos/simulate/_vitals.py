"""A modelled person: pulse wave, heart rate, oxygen saturation and blood pressure over time.

The pulse wave is the sum of two Gaussian functions over one beat, the form wave and the reflected
wave, as in Tang, Chen, Allen, Alian, Menon, Ward, Elgendi: "Synthetic photoplethysmogram generation
using two Gaussian functions" (Scientific Reports 10, 13883, 2020). The heart rate swings with the
breath (respiratory sinus arrhythmia, about 0.25 Hz) and with the Mayer waves of the blood pressure
(about 0.1 Hz), the two bands that the ECG model of McSharry, Clifford, Tarassenko and Smith (IEEE
Trans. Biomedical Engineering 50, 289-294, 2003) has as well. Every number is a smooth function of
time alone: there are no dice, and the same second always looks the same.
"""

from __future__ import annotations

import math

from attrs import frozen

__all__ = ["Person", "Vitals"]

_BREATH_HZ, _MAYER_HZ = 0.25, 0.1
_BREATH_SWING, _MAYER_SWING = 3.0, 2.0
# Height, place in the beat (radians from -pi to pi) and width of each Gaussian.
_WAVES = ((0.82, -math.pi / 2, 0.6), (0.40, 0.0, 1.0))
_HEIGHT = 0.97
_BREATH_ON_WAVE = 0.08
_TURN = 2 * math.pi


@frozen
class Vitals:
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
    """Who is simulated: means over time.

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

    def at(self, time: float) -> Vitals:
        """Return the vital signs at a time in seconds."""
        breath, mayer = _TURN * _BREATH_HZ * time, _TURN * _MAYER_HZ * time
        beats = self._beats(time, breath, mayer)
        return Vitals(
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
