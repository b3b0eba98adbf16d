"""Latency: from the order of a client to the vehicle that begins to move for it.

    python examples/warehouse/experiments/ordering.py

A client places an order whenever a vehicle stands without one, and notes when its call has
returned, when the application has given the order to a vehicle, and when that vehicle's body moves
in the simulator. Only vehicles that stood are counted; those whose way others held, by themselves.
Prints a table.
"""

from __future__ import annotations

import asyncio
import itertools
import sys
import time
from collections.abc import Iterator
from typing import Any, Final

from attrs import define, field
from experiment import FRAMEWORKS, Row, Tables, figures, options, progress, stage
from warehouse_floor.link import FloorLink
from warehouse_scene.placing import orders

from uoarm.client import RemoteRobot, connect

_LOOK: Final = 0.005
_MOVED: Final = 0.002
_STILL: Final = 0.6
_RESERVED: Final = 2.0  # more than the second in which it must surely stand first
_LIMIT: Final = 30.0
_MINUTES: Final = 20.0


@define
class Measured:
    """Seconds from each order.

    Attributes:
        returned: until its call returned.
        assigned: until the client saw that a vehicle has it.
        moved: until that vehicle moved, by vehicle, where its way was free.
        waited: the same where others held its way at first.
    """

    returned: list[float] = field(factory=list)
    assigned: list[float] = field(factory=list)
    moved: dict[str, list[float]] = field(factory=lambda: {name: [] for name in FRAMEWORKS})
    waited: list[float] = field(factory=list)

    @property
    def count(self) -> int:
        """How many vehicles were seen to move at once."""
        return sum(map(len, self.moved.values()))


class Watched:
    """Where the bodies are and since when, and what the application shows."""

    def __init__(self, link: FloorLink) -> None:
        self._link = link
        self._pose: dict[str, tuple[float, ...]] = {}
        self._since: dict[str, float] = {}
        self._began: dict[str, float] = {}
        self.picture: dict[str, Any] = {"vehicles": [], "orders": []}

    async def look(self) -> None:
        """Go on until cancelled."""
        while True:
            for name, body in self._link.ask()["bodies"].items():
                pose = (body["x"], body["y"], body["heading"])
                before = self._pose.setdefault(name, pose)
                if max(abs(a - b) for a, b in zip(pose, before, strict=True)) > _MOVED:
                    now = time.monotonic()
                    if now - self._since.get(name, 0.0) > _STILL:
                        self._began[name] = now
                    self._pose[name], self._since[name] = pose, now
            await asyncio.sleep(_LOOK)

    async def see(self, robot: RemoteRobot) -> None:
        """Go on until cancelled."""
        async for picture in await robot.request("floor"):
            self.picture = picture

    def stand(self) -> frozenset[str]:
        """Return who stands without an order, and has for a while."""
        now = time.monotonic()
        free = {
            vehicle["name"].removeprefix("transport").lower()
            for vehicle in self.picture["vehicles"]
            if vehicle["condition"] == "free" and not vehicle["order"]
        }
        return frozenset(item for item in free if now - self._since.get(item, 0.0) > _STILL)

    def began(self, name: str) -> float:
        """Return when a body that stood moved first, the last time that it did."""
        return self._began.get(name, 0.0)

    def has_way(self, name: str) -> bool:
        """Return whether a vehicle holds more than the node at which it stands."""
        ways = {vehicle["name"]: vehicle["way"] for vehicle in self.picture["vehicles"]}
        return len(ways.get(f"transport{name.title()}", ())) > 1

    def vehicle_of(self, order: str) -> str:
        """Return who has an order; nothing where no vehicle has."""
        found = [item["vehicle"] for item in self.picture["orders"] if item["order"] == order]
        return found[0].removeprefix("transport").lower() if found else ""


async def one(robot: RemoteRobot, floor: Watched, order: dict[str, Any], found: Measured) -> None:
    """Place an order and follow it until its vehicle moves."""
    stood, begun = floor.stand(), time.monotonic()
    await robot.call("transport", order)
    found.returned.append(time.monotonic() - begun)
    while not (vehicle := floor.vehicle_of(order["order"])):
        if time.monotonic() > begun + _LIMIT:
            return
        await asyncio.sleep(_LOOK)
    assigned = time.monotonic()
    found.assigned.append(assigned - begun)
    waits = False
    while floor.began(vehicle) < begun:
        if time.monotonic() > begun + _LIMIT:
            progress(f"{order['order']}: {vehicle} did not move within {_LIMIT:g} s")
            return
        if not floor.has_way(vehicle) and time.monotonic() > assigned + _RESERVED:
            waits = True
        await asyncio.sleep(_LOOK)
    if vehicle in stood:
        taken = floor.began(vehicle) - begun
        (found.waited if waits else found.moved[vehicle]).append(taken)
        progress(f"{order['order']}: {vehicle} moved after {taken:.3f} s, {waits=}")


async def measure(url: str, floor: Watched, count: int, found: Measured) -> None:
    """Place orders until so many vehicles were seen to begin."""
    async with connect(url) as robot:
        tasks = [asyncio.create_task(floor.look()), asyncio.create_task(floor.see(robot))]
        try:
            wanted: Iterator[dict[str, Any]] = orders(f"{int(time.time())}-", heavy=10.0)
            end = time.monotonic() + 60 * _MINUTES
            while found.count < count and time.monotonic() < end:
                if floor.stand():
                    await one(robot, floor, next(wanted), found)
                await asyncio.sleep(_LOOK)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)


def rows(found: Measured) -> list[Row]:
    """Return the table."""
    everyone = list(itertools.chain(*found.moved.values()))
    kinds = {
        "order to the reply of its call": found.returned,
        "order to the vehicle that has it": found.assigned,
        "order to wheel, any vehicle whose way is free": everyone,
        **{f"order to wheel, {FRAMEWORKS[name]}": of for name, of in found.moved.items()},
        "order to wheel, where others held the way": found.waited,
    }
    return [{"from, to": what, **figures(seconds)} for what, seconds in kinds.items()]


def main() -> int:
    """Run it and print the table."""
    chosen = options(__doc__, count=30)
    tables = Tables(chosen.json)
    found = Measured()
    with stage() as scene:
        asyncio.run(measure(scene.places.robot_url, Watched(scene.link), chosen.count, found))
        truth = scene.link.ask()
    tables.add(f"From the order to the wheel; collisions: {truth['collisions']}", rows(found))
    tables.print()
    return 0 if found.count >= chosen.count and not truth["collisions"] else 1


if __name__ == "__main__":
    sys.exit(main())
