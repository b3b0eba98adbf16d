"""Runs a simulated device on its end of a line, with faults where they are asked for."""

from __future__ import annotations

import random
import threading
import time
from typing import Protocol

from attrs import frozen

from uoarm.errors import BridgeError
from uoarm_rocos.simulate._ends import End

__all__ = ["Faults", "Simulated", "run"]

_STEP_SECONDS = 0.005
_MEET_SECONDS = 0.2


@frozen
class Faults:
    """What goes wrong on the way to the host.

    Attributes:
        drop: chance for each frame to be lost.
        garble: chance for each frame to have one octet changed.
        delay: seconds by which every frame is late.
        disconnect: seconds after which the cable is pulled out, and put in again; None: never.
        seed: of the dice; the same seed gives the same faults.
    """

    drop: float = 0.0
    garble: float = 0.0
    delay: float = 0.0
    disconnect: float | None = None
    seed: int = 0


class Simulated(Protocol):
    """A device without any I/O: octets and a time in, frames out."""

    def begin(self, now: float) -> None:
        """A new host is there, or the line was opened."""

    def receive(self, data: bytes, now: float) -> list[bytes]:
        """Take octets of the host; return frames to send.

        Raises:
            BridgeError: the host breaks the protocol; it is cut off.
        """

    def step(self, now: float) -> list[bytes]:
        """Return the frames that are due."""


def run(device: Simulated, end: End, stop: threading.Event, faults: Faults | None = None) -> None:
    """Run a device until `stop` is set; then everything is closed."""
    way = _Way(end, faults or Faults())
    try:
        while not stop.is_set():
            if end.meet(_MEET_SECONDS):
                _serve(device, end, way, stop)
    finally:
        end.close()


def _serve(device: Simulated, end: End, way: _Way, stop: threading.Event) -> None:
    began = time.monotonic()
    device.begin(began)
    way.begin()
    while not stop.is_set():
        data = end.read(_STEP_SECONDS)
        now = time.monotonic()
        if data is None:
            return
        try:
            frames = device.receive(data, now) if data else []
        except BridgeError:
            end.cut()
            return
        way.send([*frames, *device.step(now)], now)
        if way.cut_due(now - began):
            end.cut()
            return


class _Way:
    """The way to the host, where things go wrong."""

    def __init__(self, end: End, faults: Faults) -> None:
        self._end = end
        self._faults = faults
        self._dice = random.Random(faults.seed)  # noqa: S311 - faults to be repeated, no secrets
        self._late: list[tuple[float, bytes]] = []

    def begin(self) -> None:
        """Forget what was on its way to the host before."""
        self._late.clear()

    def send(self, frames: list[bytes], now: float) -> None:
        """Send frames, and those whose delay is over."""
        for frame in frames:
            if self._dice.random() >= self._faults.drop:
                self._late.append((now + self._faults.delay, self._garbled(frame)))
        while self._late and self._late[0][0] <= now:
            self._end.write(self._late.pop(0)[1])

    def cut_due(self, elapsed: float) -> bool:
        """Say whether it is time to pull the cable out."""
        return self._faults.disconnect is not None and elapsed >= self._faults.disconnect

    def _garbled(self, frame: bytes) -> bytes:
        if self._dice.random() >= self._faults.garble:
            return frame
        place = self._dice.randrange(len(frame))
        return (
            frame[:place] + bytes([frame[place] ^ self._dice.randint(1, 255)]) + frame[place + 1 :]
        )
