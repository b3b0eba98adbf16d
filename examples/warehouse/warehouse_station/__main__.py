"""The station as a simulated device on a pseudo-terminal.

`python -m warehouse_station LINK PLACED` until interrupted. LINK becomes the serial port. PLACED is
the journal of orders: on the scale of a simulation a box weighs what its order says, and a little.
"""

from __future__ import annotations

import random
import signal
import sys
import threading
from pathlib import Path
from typing import Any, Final

from uoarm_rocos import StuffedFramer, load_catalogue
from uoarm_rocos.simulate import ProfileServer, PtyEnd, run
from warehouse_floor.layout import DOCKS
from warehouse_floor.link import FloorLink
from warehouse_orders.orders import read_lines

_LAMP_SECONDS: Final = 3.0
_FLOOR_SECONDS: Final = 1.0
_ERROR_KG: Final = 0.02


class Station:
    """What the device is and does.

    Args:
        floor: the simulator, which knows where the boxes are.
        placed: the journal from which their masses are.
    """

    def __init__(self, floor: FloorLink, placed: Path) -> None:
        self.catalogue = load_catalogue(Path(__file__).with_name("station.xml"))
        self._floor, self._placed = floor, placed
        self._masses: dict[str, float] = {}
        self._offset = 0
        self._colour, self._until = "off", 0.0

    def call(self, api: str, values: dict[str, Any], now: float) -> dict[str, Any]:
        """Weigh a box.

        Raises:
            ValueError: it is not at a dock.
        """
        del api, now
        box = values["box"]
        try:
            dock = self._floor.ask()["boxes"].get(box)
        except OSError as error:
            raise ValueError(f"the scale does not answer: {error}") from error
        if dock not in DOCKS:
            raise ValueError(f"box {box!r} is not at a dock")
        return {"dock": dock, "mass": round(self._mass(box), 3)}

    def sample(self, api: str, now: float) -> None:
        """Return nothing: no flow of this device has a period."""
        del api, now

    def events(self, now: float) -> list[tuple[str, dict[str, Any]]]:
        """Return nothing; let the lamp go out when it is time."""
        if now > self._until:
            self._show("off")
        return []

    def take(self, api: str, values: dict[str, Any], now: float) -> None:
        """Take a colour."""
        del api
        self._until = now + _LAMP_SECONDS
        self._show(values["colour"])

    def _show(self, colour: str) -> None:
        if colour != self._colour:
            self._colour = colour
            print(f"the lamp is {colour}", flush=True)

    def _mass(self, box: str) -> float:
        for entry, offset in read_lines(self._placed, self._offset):
            self._offset = offset
            self._masses.setdefault(entry["order"], entry["load"])
        error = random.Random(box).uniform(-_ERROR_KG, _ERROR_KG)  # noqa: S311 - no secret
        return max(0.0, self._masses.get(box, 0.0) + error)


def main() -> None:
    """Serve `LINK PLACED` until interrupted."""
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: threading.Thread(target=stop.set).start())
    end = PtyEnd(sys.argv[1])
    with FloorLink(seconds=_FLOOR_SECONDS) as floor:
        print("ready", flush=True)
        run(ProfileServer(Station(floor, Path(sys.argv[2])), StuffedFramer), end, stop)


if __name__ == "__main__":
    main()
