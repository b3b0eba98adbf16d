"""The spare devices, read by plain Python: a Nonin oximeter and a second blood-pressure monitor.

They are other devices on other lines, so that a measurement never comes from a device that is
gone. The decoders are those of uoarm-rocos; lines, sessions and reconnection are not.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, TypedDict, cast

import serial
from typing_extensions import NotRequired
from uoarm_rocos.devices import UA767_ACCEPTED, UA767_REFUSED, Nonin1Decoder, Ua767Decoder

from healthbot_parts.messages import Pressure
from uoarm.local import Range

__all__ = ["Cuff", "Oximetry", "Question", "oximeter", "same"]

_PIECE = 64
_READ_SECONDS = 0.2
_SILENCE = 3.0
_LIMIT = 60.0


class Oximetry(TypedDict):
    """Pulse a minute and saturation in %, as far as they were measured.

    The structure is that of every oximeter of uoarm-rocos, with what a Nonin never sends: a spare
    takes over in mid-stream only where it promises the same.
    """

    quality: Literal["good", "weak", "artifact", "searching", "finger-out", "probe-error"]
    pulse: NotRequired[Annotated[int, Range(1, 510)]]
    spo2: NotRequired[Annotated[int, Range(1, 100)]]
    waveform: NotRequired[Annotated[float, Range(0, 1)]]
    beat: NotRequired[bool]
    signal: NotRequired[Annotated[int, Range(0, 15)]]


class Question(TypedDict):
    """Nothing is asked: the person starts the measurement at the monitor."""


def oximeter(url: str) -> Iterator[Oximetry]:
    """Yield what a Nonin oximeter in serial format 1 sends, once a second.

    Args:
        url: the path of a serial port.

    Raises:
        OSError: the port is not there, or nothing comes for three seconds.
    """
    decoder = Nonin1Decoder()
    with _opened(url, _SILENCE) as line:
        received = time.monotonic()
        while True:
            for message in decoder.feed(line.read(_PIECE)):
                received = time.monotonic()
                yield cast("Oximetry", message)
            if time.monotonic() - received > _SILENCE:
                raise OSError(f"the oximeter at {url} is silent for {_SILENCE:g} s")


def same(reading: Oximetry) -> Oximetry:
    """Hand a reading on: pulse and saturation are two functions of one clip and its one line."""
    return reading


class Cuff:
    """Waits for the next measurement of a UA-767PBT.

    Args:
        url: the path of a serial port.
    """

    def __init__(self, url: str) -> None:
        self._url = url

    def __call__(self, question: Question) -> Pressure:
        """Return the next measurement.

        Raises:
            OSError: the port is not there, or no measurement comes within a minute.
        """
        del question
        decoder = Ua767Decoder()
        end = time.monotonic() + _LIMIT
        with _opened(self._url, _LIMIT) as line:
            while time.monotonic() < end:
                for found in decoder.feed(line.read(_PIECE)):
                    if isinstance(found, dict):
                        line.write(UA767_ACCEPTED)
                        return _pressure(found)
                    line.write(UA767_REFUSED)
        raise OSError(f"no measurement came from {self._url} within {_LIMIT:g} s")


def _opened(url: str, seconds: float) -> Any:
    """Open a line for one reader alone; the one before may take until its next message to leave.

    Raises:
        OSError: the port is not there, or another process keeps it.
    """
    end = time.monotonic() + seconds
    while True:
        try:
            return serial.serial_for_url(url, 9600, timeout=_READ_SECONDS, exclusive=True)
        except serial.SerialException:
            if time.monotonic() > end or not Path(url).exists():
                raise
            time.sleep(_READ_SECONDS)


def _pressure(reading: dict[str, Any]) -> Pressure:
    names = ("systolic", "diastolic", "mean", "pulse", "battery")
    return cast("Pressure", {name: reading[name] for name in names})
