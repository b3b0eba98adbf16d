"""A simulated A&D UA-767PBT: somebody measures now and then, and each reading waits for its yes."""

from __future__ import annotations

import math
from collections import deque

from uoarm_rocos.devices._ua767 import ACCEPTED, REFUSED, Measurement, ua767_frame
from uoarm_rocos.simulate._vitals import Person

__all__ = ["BloodPressureMonitor"]

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
        self._heard = b""

    def begin(self, now: float) -> None:
        """Go on: readings that were not accepted are kept."""
        self._on = now if self._on is None else self._on
        self._sent = -math.inf

    def receive(self, data: bytes, now: float) -> list[bytes]:
        """Take an answer to the reading that was sent."""
        del now
        self._heard = (self._heard + data)[-64:]
        while True:
            places = {word: self._heard.find(word) for word in (ACCEPTED, REFUSED)}
            known = {place: word for word, place in places.items() if place >= 0}
            if not known:
                return []
            first = min(known)
            word = known[first]
            self._heard = self._heard[first + len(word) :]
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
