"""The blood-pressure monitor as a device: a call waits for the next measurement."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm.model import Health
from uoarm_rocos._answer import Answer
from uoarm_rocos._catalogue import Api, Catalogue
from uoarm_rocos._device import Device
from uoarm_rocos._errors import LineError, WireError
from uoarm_rocos._fit import fit
from uoarm_rocos._line import Line
from uoarm_rocos._outage import Outage
from uoarm_rocos._profile import Changed, Timing
from uoarm_rocos._transport import Transport
from uoarm_rocos.devices._ua767 import ACCEPTED, REFUSED, Ua767Decoder, blood_pressure_catalogue

__all__ = ["Monitor"]

_MOST_CALLS = 100


class Monitor(Device):
    """Acknowledges a measurement only when a call takes it, so that the monitor keeps the others.

    The monitor is silent between measurements: it counts as there when its port is open.
    """

    def __init__(
        self, name: str, transport: Callable[[], Transport], timing: Timing, changed: Changed
    ) -> None:
        self._name = name
        self._timing = timing
        self._changed = changed
        self._decoder = Ua767Decoder()
        self._state = threading.Condition()
        self._open = False
        self._closed = False
        self._cause = "not connected yet"
        self._outage = Outage(timing.grace)
        self._waiting: list[Answer] = []
        self._line = Line(name, transport, self, timing.backoff)
        self._line.start()

    def catalogue(self, timeout: float) -> Catalogue:
        """Return the catalogue once the port is open."""
        with self._state:
            if not self._state.wait_for(lambda: self._open or self._closed, timeout):
                raise LineError(f"{self._name} is not there after {timeout:g} s: {self._cause}")
            self._check_open()
        return blood_pressure_catalogue()

    def call(self, api: Api, message: object, timeout: float) -> dict[str, Any]:
        """Wait for the next measurement."""
        began = time.monotonic()
        fit(api.input, message, f"request to {api.name}")
        self.catalogue(min(timeout, self._timing.wait))
        answer = Answer()
        with self._state:
            self._check_open()
            if len(self._waiting) >= _MOST_CALLS:
                text = f"{_MOST_CALLS} calls already wait for {self._name}"
                raise BridgeError(text, FailureReason.REFUSED)
            self._waiting.append(answer)
        if not answer.wait(max(0.0, timeout - (time.monotonic() - began))):
            with self._state:
                if answer in self._waiting:
                    self._waiting.remove(answer)
            text = f"{self._name}: nobody measured within {timeout:g} s"
            raise BridgeTimeoutError(text)
        return fit(api.output, answer.value(), f"reading of {self._name}")

    def stop(self) -> None:
        """Have the line end."""
        self._line.stop()

    def close(self) -> None:
        """Let go of the line; calls that wait fail."""
        with self._state:
            self._closed = True
            self._state.notify_all()
        self._line.close()
        self._fail(BridgeError(f"{self._name} was closed", FailureReason.CLOSED))

    def connected(self) -> None:
        """Begin with a new decoder."""
        self._decoder = Ua767Decoder()
        with self._state:
            self._open = True
            self._state.notify_all()
        self._outage.end()
        self._changed(Health.OK, "the port is open", {})

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
        """Nothing is due: the monitor speaks when somebody has measured."""

    def lost(self, cause: str) -> None:
        """Fail the calls that wait."""
        with self._state:
            self._open, self._cause = False, cause
        text = f"the line to {self._name} is lost: {cause}"
        news = self._outage.news(time.monotonic())
        if news is not None:
            self._changed(news, text, {})
        self._fail(LineError(text))

    def _check_open(self) -> None:
        if self._closed:
            raise BridgeError(f"{self._name} is closed", FailureReason.CLOSED)

    def _fail(self, error: BridgeError) -> None:
        with self._state:
            waiting, self._waiting = self._waiting, []
        for answer in waiting:
            answer.fail(error)
