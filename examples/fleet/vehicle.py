"""A simulated vehicle: it carries boxes along a line, and says where it is."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from typing import TypedDict

NAME = os.environ.get("VEHICLE", "vehicle")
METRES_A_SECOND = 4.0


class Order(TypedDict):
    """Carry a box."""

    box: str
    metres: float


class Delivered(TypedDict):
    """A box that has arrived."""

    box: str
    vehicle: str


class State(TypedDict):
    """How a vehicle is."""

    vehicle: str
    metres: float
    free: bool


class _Vehicle:
    def __init__(self) -> None:
        self.metres = 0.0
        self.work = threading.Lock()


_VEHICLE = _Vehicle()


def transport(order: Order) -> Delivered:
    """Drive, one box at a time."""
    with _VEHICLE.work:
        end = _VEHICLE.metres + order["metres"]
        while _VEHICLE.metres < end:
            _VEHICLE.metres = min(end, _VEHICLE.metres + METRES_A_SECOND / 20)
            time.sleep(0.05)
    return {"box": order["box"], "vehicle": NAME}


def state() -> Iterator[State]:
    """Say ten times a second how it is."""
    while True:
        yield {"vehicle": NAME, "metres": _VEHICLE.metres, "free": not _VEHICLE.work.locked()}
        time.sleep(0.1)
