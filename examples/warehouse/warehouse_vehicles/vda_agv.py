"""An automated vehicle that speaks VDA 5050 over MQTT; it drives from node to node of its order.

It goes on to the last released node when its connection breaks, as the standard has it.
"""

from __future__ import annotations

import signal
import sys
import threading
import time
from typing import Final

from uoarm_vda5050.vehicle import Act, Drive, Task, Vehicle
from warehouse_floor.bodies import Sense, Triple
from warehouse_floor.link import Base
from warehouse_floor.navigator import STAND, drive_along

_SECONDS: Final = 0.05
_NEAR: Final = 0.2
_LIVE: Final = 0.5  # an order that is under way is a live command
_MANUFACTURER: Final = "uoa"


class Agv:
    """The vehicle.

    Args:
        name: its serial number.
        home: where it stands at first.
        url: of the broker.
        release: of the standard.
    """

    def __init__(self, name: str, home: str, url: str, release: str) -> None:
        self._base = Base(name, home)
        self._vehicle = Vehicle(
            url, _MANUFACTURER, name, release=release, actions=("pick", "drop"),
            state_seconds=0.2, visualization_seconds=0,
        )  # fmt: skip
        self._carry: str | None = None

    def run(self, stop: threading.Event) -> None:
        """Drive and report until a signal comes."""
        with self._vehicle as vehicle:
            print("ready", flush=True)
            velocity = STAND
            sense: Sense | None = None
            while not stop.wait(_SECONDS):
                task = vehicle.task
                until = time.monotonic() + _LIVE if task is not None else float("-inf")
                load = sense.load if sense is not None else ""
                carry = load if self._carry is None else self._carry
                sense = self._base.drive(velocity if task is not None else STAND, until, carry)
                velocity = STAND if sense is None else self._next(sense, task)
                if sense is not None:
                    self._report(sense)
        self._base.close()

    def _next(self, sense: Sense, task: Task | None) -> Triple:
        """Do a step of what is to be done, and return how the base shall move."""
        self._carry = None
        if isinstance(task, Act):
            box = str(task.parameters["loadId"]) if task.action_type == "pick" else ""
            if sense.load == box:
                self._vehicle.finished(task)
            else:
                self._carry = box
        elif isinstance(task, Drive) and sense.is_localised:
            if (
                task.x is None
                or task.y is None
                or (sense.x - task.x) ** 2 + (sense.y - task.y) ** 2 < _NEAR**2
            ):
                self._vehicle.reached(task)
            else:
                pose = (sense.x, sense.y, sense.heading)
                return drive_along([(task.x, task.y)], 0, pose, sideways=False).velocity
        return STAND

    def _report(self, sense: Sense) -> None:
        vehicle = self._vehicle
        if sense.is_blocked:
            vehicle.raise_error("blockedPath", "something stands in the way")
        else:
            vehicle.clear_error("blockedPath")
        vehicle.set(
            position=(sense.x, sense.y, sense.heading, "floor"),
            velocity=(sense.speed, 0.0, 0.0),
            driving=sense.speed > 0,
            battery=sense.battery,
            loads=[{"loadId": sense.load}] if sense.load else [],
            localized=sense.is_localised,
        )


def main() -> None:
    """Run `NAME HOME BROKER RELEASE` until interrupted."""
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    Agv(*sys.argv[1:5]).run(stop)


if __name__ == "__main__":
    main()
