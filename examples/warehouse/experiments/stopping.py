"""Safety: each part is killed while vehicles drive; how long until each stands, and what goes on.

    python examples/warehouse/experiments/stopping.py

The times are those of the simulator, which knows where the bodies are. Prints a table.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Final

from experiment import VEHICLES, Tables, options, progress, stage
from faults import Faults, done_orders, keep_placing
from healthbot_scene.crew import host_of
from warehouse_scene.parts import newcomer

_LOOK: Final = 0.02
_WATCH: Final = 6.0
_SETTLE: Final = 8.0
_DRIVES: Final = 0.4
_STANDS: Final = 0.02
_LIMIT: Final = 180.0
_HEAD: Final = ("killed", "vehicle", "stands after", "next order done, after the part is back")
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
    "visitor": ("visitor",),
    "host of the ROS 2 bridge": ("amr",),
    "host of the OpenRTM bridge": ("cart",),
}


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
    return len(done_orders(faults.stage.places)) > than


def kill(faults: Faults, what: str) -> None:
    """End a part as a crash would."""
    if what in _LIBRARIES:
        robot = faults.stage.crew["robot"].process.pid
        os.kill(host_of(robot, _LIBRARIES[what]), signal.SIGKILL)
    else:
        faults.stage.crew.kill(what)


def stops(faults: Faults, what: str) -> list[tuple[str, str]]:
    """Kill a part while the vehicles that it concerns drive; return what each of them did."""

    def speeds() -> dict[str, float]:
        bodies = faults.stage.link.ask()["bodies"]
        return {name: body["speed"] for name, body in bodies.items()}

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
    chosen = options(__doc__)
    tables = Tables(chosen.json)
    rows: list[dict[str, object]] = []
    with stage() as scene:
        scene.parts["visitor"] = newcomer(scene.places)
        scene.crew.start(scene.parts["visitor"])
        faults = Faults(scene)
        with keep_placing(faults):
            for what in _AFFECTED:
                before_done = len(done_orders(scene.places))
                found = stops(faults, what)
                if what in scene.parts:
                    scene.crew.start(scene.parts[what])
                begun = time.monotonic()
                goes_on = until(partial(is_more_done, faults, before_done), _LIMIT)
                after = f"{time.monotonic() - begun:.0f} s" if goes_on else "none"
                for name, stood in found:
                    cells = (what, name, stood, after)
                    rows.append(dict(zip(_HEAD, cells, strict=True)))
                    progress(cells)
                time.sleep(_SETTLE)
        truth = scene.link.ask()
    counted = f"collisions {truth['collisions']}, unauthorised moves {truth['unauthorised']}"
    tables.add(f"Each part killed while vehicles drive; {counted}", rows)
    tables.print()
    return 1 if truth["collisions"] or truth["unauthorised"] else 0


if __name__ == "__main__":
    sys.exit(main())
