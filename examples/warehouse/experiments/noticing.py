"""Dynamic monitoring: parts are killed one after the other; who is notified, and when it is back.

    python examples/warehouse/experiments/noticing.py

The application runs and keeps every vehicle and the lamp open; another client only watches. Each
part is killed as a crash would kill it, and started again. Prints a table.
"""

from __future__ import annotations

import asyncio
import sys
import time
from contextlib import suppress
from typing import Final

from experiment import Row, Stage, Tables, options, progress, stage
from warehouse_scene.parts import newcomer

from uoarm.client import RemoteRobot, connect
from uoarm.errors import UoarmError

# The part, the function that uses it, and what the names of its components have in them.
_PARTS: Final = {
    "amr": ("transportAmr", "amr"),
    "cart": ("transportCart", "cart"),
    "agv": ("transportAgv", "agv"),
    "visitor": ("transportGuest", "uest"),
    "station": ("lamp", "lamp"),
}
_LOOK: Final = 0.05
_LIMIT: Final = 60.0
_WINDOW: Final = 6.0

Notices = list[tuple[float, str, str]]


async def listen(robot: RemoteRobot, notices: Notices) -> None:
    """Note what the robot reports of its components and connections."""
    with suppress(UoarmError):
        async for event in robot.watch():
            notices.append((time.monotonic(), event.subject, event.change))


async def running(robot: RemoteRobot, function: str, *, limit: float) -> float | None:
    """Return after how many seconds a function is open and flows; None: not in time."""
    begun = time.monotonic()
    while time.monotonic() < begun + limit:
        connections = (await robot.status())["connections"]
        if any(c["function"] == function and c["state"] == "running" for c in connections):
            return time.monotonic() - begun
        await asyncio.sleep(_LOOK)
    return None


async def death(scene: Stage, robot: RemoteRobot, notices: Notices, part: str) -> Row:
    """Kill a part and start it again; return what became of it."""
    function, name = _PARTS[part]
    if await running(robot, function, limit=2 * _LIMIT) is None:
        return _row(part, function, None, "it was never open", None)
    killed = time.monotonic()
    scene.crew.kill(part)
    await asyncio.sleep(_WINDOW)
    after = [(at, f"{what} {how}") for at, what, how in notices if at > killed and name in what]
    noticed = after[0][0] - killed if after else None
    await asyncio.to_thread(scene.crew.start, scene.parts[part])
    back = await running(robot, function, limit=_LIMIT)
    return _row(part, function, noticed, "; ".join(dict.fromkeys(text for _, text in after)), back)


def _row(part: str, function: str, noticed: float | None, notices: str, back: float | None) -> Row:
    return {
        "killed": part,
        "seen through": function,
        "reported after": "never" if noticed is None else f"{noticed:.2f} s",
        "what a client that watches receives": notices,
        "open again after it was ready": "no" if back is None else f"{back:.1f} s",
    }


async def run(scene: Stage) -> list[Row]:
    """Kill everything once."""
    reports: Notices = []
    rows: list[Row] = []
    async with connect(scene.places.robot_url) as robot:
        listening = asyncio.create_task(listen(robot, reports))
        for part in _PARTS:
            rows.append(await death(scene, robot, reports, part))
            progress(rows[-1])
        listening.cancel()
        await asyncio.gather(listening, return_exceptions=True)
    return rows


def main() -> int:
    """Run it and print the table."""
    chosen = options(__doc__)
    tables = Tables(chosen.json)
    with stage() as scene:
        scene.parts["visitor"] = newcomer(scene.places)
        scene.crew.start(scene.parts["visitor"])
        rows = asyncio.run(run(scene))
    tables.add("Each part killed: who is notified, and when it is back", rows)
    tables.print()
    return 1 if any("never" in str(row.values()) for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
