"""The parts of a small HealthBot, in plain Python; nothing here is a medical device."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Annotated, TypedDict

from uoarm.local import Range


class Text(TypedDict):
    """What is said."""

    text: str


class HeartRate(TypedDict):
    """What the clip at the finger measures."""

    rate: int
    spo2: int


class Cuff(TypedDict):
    """How far the cuff is pumped up, in mmHg."""

    pressure: Annotated[float, Range(100, 200)]


class Pressure(TypedDict):
    """What the cuff measures, in mmHg."""

    systolic: int
    diastolic: int


def show(line: str) -> None:
    """Print a line; that what reads it has ended is for the program to notice, and no fault."""
    with suppress(BrokenPipeError):
        print(line, flush=True)


def say(request: Text) -> Text:
    """Say a text."""
    show(f"robot: {request['text']}")
    return request


def measure_heart() -> Iterator[HeartRate]:
    """Measure four times a second."""
    while True:
        yield {"rate": 72, "spo2": 98}
        time.sleep(0.25)


def measure(request: Cuff) -> Pressure:
    """Pump the cuff up, and measure."""
    show(f"cuff: pumped up to {request['pressure']:g} mmHg")
    return {"systolic": 124, "diastolic": 81}
