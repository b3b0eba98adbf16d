"""Dynamic configuration: a vehicle of another release appears, and is used without a line for it.

    python examples/warehouse/experiments/appearing.py

The scene runs with its three vehicles and has orders. Then a fourth one is switched on that no
configuration names and that speaks release 3.0. Prints a table of what became of it.
"""

from __future__ import annotations

import asyncio
import sys
import time
from typing import Any

from experiment import Tables, options, progress, stage
from faults import Faults, keep_placing
from warehouse_scene.parts import NEWCOMER_HOME, newcomer

from uoarm.client import connect
from uoarm.errors import UoarmError

NAME = "transportGuest"
_SECONDS = 300.0


async def is_home_free(url: str) -> bool:
    """Return whether no vehicle is at the newcomer's home, or on the way there."""
    async with connect(url) as robot:
        async for picture in await robot.request("floor"):
            return all(NEWCOMER_HOME not in vehicle["way"] for vehicle in picture["vehicles"])
    return False


async def follow(url: str, begun: float) -> dict[str, float]:
    """Return when what happened first, in seconds since `begun`."""
    seen: dict[str, float] = {}
    try:
        await asyncio.wait_for(_watch(url, begun, seen), _SECONDS)
    except (asyncio.TimeoutError, UoarmError) as error:
        progress(f"it ended early: {error!r}")
    return seen


async def _watch(url: str, begun: float, seen: dict[str, float]) -> None:
    async with connect(url) as robot:
        async for picture in await robot.request("floor"):
            for what in _happened(picture):
                if what not in seen:
                    seen[what] = time.monotonic() - begun
                    progress(f"{seen[what]:6.1f} s  {what}")
            if "has done an order" in seen:
                return


def _happened(picture: dict[str, Any]) -> list[str]:
    is_present = any(vehicle["name"] == NAME for vehicle in picture["vehicles"])
    status = {order["status"] for order in picture["orders"] if order["vehicle"] == NAME}
    words = {"assigned": "has an order", "loaded": "carries a box", "done": "has done an order"}
    return [
        *(["is received by the application"] if is_present else []),
        *(text for word, text in words.items() if word in status),
    ]


def main() -> int:
    """Run it and print the table."""
    chosen = options(__doc__)
    tables = Tables(chosen.json)
    with stage() as scene:
        with keep_placing(Faults(scene)):
            time.sleep(30)
            while not asyncio.run(is_home_free(scene.places.robot_url)):
                time.sleep(1)
            begun = time.monotonic()
            scene.crew.start(newcomer(scene.places))
            seen = asyncio.run(follow(scene.places.robot_url, begun))
        truth = scene.link.ask()
    rows = [
        {"the newcomer": what, "seconds after it was switched on": round(seconds, 1)}
        for what, seconds in seen.items()
    ]
    tables.add(f"A vehicle without a name in the file; collisions: {truth['collisions']}", rows)
    tables.print()
    return 0 if "has done an order" in seen and not truth["collisions"] else 1


if __name__ == "__main__":
    sys.exit(main())
