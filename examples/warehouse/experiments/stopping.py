"""Safety: each part is killed while vehicles drive; how long until each stands, and what goes on.

    python examples/warehouse/experiments/stopping.py

The times are those of the simulator, which knows where the bodies are. Prints a table.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Final

from faults import EXAMPLE, VEHICLES, Faults, done_orders, keep_placing
from healthbot_scene.crew import Crew
from warehouse_floor.link import FloorLink
from warehouse_scene.parts import make_places, parts_of

_LOOK: Final = 0.02
_WATCH: Final = 6.0
_SETTLE: Final = 8.0
_DRIVES: Final = 0.4
_STANDS: Final = 0.02
_LIMIT: Final = 180.0
_LIBRARIES: Final = {
    "host of the ROS 2 bridge": "librcl.so",
    "host of the OpenRTM bridge": "_omnipy",
}
_AFFECTED: Final = {
    "orders": VEHICLES,
    "robot": VEHICLES,
    "broker": ("agv",),
    "amr": ("amr",),
    "cart": ("cart",),
    "agv": ("agv",),
    "host of the ROS 2 bridge": ("amr",),
    "host of the OpenRTM bridge": ("cart",),
}


def host_of(robot: int, library: str) -> int:
    """Return the process of `uoarm serve` in which a bridge with this library runs.

    Raises:
        LookupError: there is none.
    """
    children = Path(f"/proc/{robot}/task").glob("*/children")
    for pid in {int(word) for each in children for word in each.read_text().split()}:
        if library in Path(f"/proc/{pid}/maps").read_text():
            return pid
    raise LookupError(f"no process of the robot has loaded {library}")


def until(true: Callable[[], bool], seconds: float) -> bool:
    """Wait; return whether it came to be."""
    end = time.monotonic() + seconds
    while not true():
        if time.monotonic() > end:
            return False
        time.sleep(_LOOK)
    return True


def is_more_done(faults: Faults, than: int) -> bool:
    """Return whether more orders are done than were."""
    return len(done_orders(faults.places)) > than


def kill(faults: Faults, what: str) -> None:
    """End a part as a crash would."""
    if what in _LIBRARIES:
        robot = faults.crew["robot"].process.pid
        os.kill(host_of(robot, _LIBRARIES[what]), signal.SIGKILL)
    else:
        faults.crew.kill(what)


def stops(faults: Faults, what: str) -> list[tuple[str, str]]:
    """Kill a part while the vehicles that it concerns drive; return what each of them did."""

    def speeds() -> dict[str, float]:
        bodies = faults.link.ask()["bodies"]
        return {name: one["speed"] for name, one in bodies.items()}

    driving: list[str] = []

    def drives() -> bool:
        now = speeds()
        driving[:] = [name for name in _AFFECTED[what] if now.get(name, 0.0) > _DRIVES]
        return bool(driving)

    if not until(drives, _LIMIT):
        return [(", ".join(_AFFECTED[what]), "never drove")]
    kill(faults, what)
    killed = time.monotonic()
    stood: dict[str, float] = {}
    while time.monotonic() < killed + _WATCH:
        for name, speed in speeds().items():
            if name in driving and name not in stood and speed < _STANDS:
                stood[name] = time.monotonic() - killed
        time.sleep(_LOOK)
    return [(name, f"{stood[name]:.2f} s" if name in stood else "goes on") for name in driving]


def main() -> int:
    """Kill everything once and print the table."""
    before = os.getloadavg()[0]
    rows = []
    with tempfile.TemporaryDirectory(prefix="warehouse-") as folder:
        places = make_places(Path(folder))
        parts = parts_of(places, places.write_robot(EXAMPLE / "robot.yaml"))
        with Crew(places.run, places.environment()) as crew, FloorLink(places.floor) as link:
            crew.start_all(parts, lambda _: None)
            faults = Faults(crew, places, {part.name: part for part in parts}, link)
            with keep_placing(faults):
                for what in _AFFECTED:
                    before_done = len(done_orders(places))
                    found = stops(faults, what)
                    if what in faults.parts:
                        crew.start(faults.parts[what])
                    begun = time.monotonic()
                    goes_on = until(partial(is_more_done, faults, before_done), _LIMIT)
                    after = f"{time.monotonic() - begun:.0f} s" if goes_on else "none"
                    rows += [(what, name, stood, after) for name, stood in found]
                    print("| " + " | ".join(rows[-1]) + " |", flush=True)
                    time.sleep(_SETTLE)
            truth = link.ask()
    print(f"\nload {before:.1f} to {os.getloadavg()[0]:.1f}; collisions {truth['collisions']}\n")
    print("| killed | vehicle | stands after | next order done, after the part is back |")
    print("| --- | --- | --- | --- |")
    for row in rows:
        print("| " + " | ".join(row) + " |")
    return 1 if truth["collisions"] or truth["unauthorised"] else 0


if __name__ == "__main__":
    sys.exit(main())
