"""Compatibility: the application, unchanged, with the vehicle of each framework alone.

    python examples/warehouse/experiments/alone.py

The scene's robot file is cut down to one vehicle: its functions, and the bridges that they use. The
other vehicles' programs are not started. Prints a table.
"""

from __future__ import annotations

import asyncio
import sys
import time
from typing import Any, Final

from experiment import FRAMEWORKS, VEHICLES, Row, Tables, options, progress, stage
from warehouse_scene.placing import place_and_wait

_ORDERS: Final = 3
_HEAVY: Final = 10.0  # kg, which even the cart carries
_SECONDS: Final = 400.0


def cut_down(robot: dict[str, Any], vehicle: str) -> dict[str, Any]:
    """Return a robot file's content without the other vehicles, and without bridges unused then."""
    others = (*(text for text in VEHICLES if text != vehicle), "guest")
    functions = {
        name: function
        for name, function in robot["functions"].items()
        if not any(other in name.lower() for other in others)
    }
    used = {part["bridge"] for function in functions.values() for part in function["components"]}
    bridges = {name: bridge for name, bridge in robot["bridges"].items() if name in used}
    return {**robot, "bridges": bridges, "functions": functions}


def with_one(vehicle: str) -> Row:
    """Have orders carried out by one vehicle; return a row of the table."""
    others = [name for name in VEHICLES if name != vehicle]
    used: dict[str, Any] = {}

    def change(robot: dict[str, Any]) -> dict[str, Any]:
        used.update(cut_down(robot, vehicle))
        return used

    with stage(others, change) as scene:
        begun = time.monotonic()
        url = scene.places.robot_url
        is_done = asyncio.run(place_and_wait(url, _ORDERS, _SECONDS, progress, heavy=_HEAVY))
        seconds = time.monotonic() - begun
        truth = scene.link.ask()
    delivered = sum(truth["deliveries"].values())
    return {
        "framework": FRAMEWORKS[vehicle],
        "bridges": ", ".join(used["bridges"]),
        "functions": len(used["functions"]),
        "boxes delivered and weighed": f"{delivered} of {_ORDERS}{'' if is_done else ', not all'}",
        "seconds": round(seconds),
        "metres": round(truth["metres"]),
        "collisions": truth["collisions"],
        "moves without a live command": truth["unauthorised"],
    }


def main() -> int:
    """Run each and print the table."""
    chosen = options(__doc__)
    tables = Tables(chosen.json)
    rows = [with_one(vehicle) for vehicle in VEHICLES]
    tables.add("Each framework alone", rows)
    tables.print()
    wanted = f"{_ORDERS} of {_ORDERS}"
    return 0 if all(row["boxes delivered and weighed"] == wanted for row in rows) else 1


if __name__ == "__main__":
    sys.exit(main())
