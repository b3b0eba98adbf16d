"""Latency: from the command to the wheel, for each framework.

    python examples/warehouse/experiments/moving.py

The application is not started: each vehicle is commanded from its home to the node before it and
back, as the application does it. It counts as moving once its body, in the simulator, is not where
it was, and is commanded again only after it stood still. Then the one of ROS 2 is steered by hand,
to and fro with single velocities, each of which it has until it expires. Prints a table.
"""

from __future__ import annotations

import asyncio
import sys
import time
from typing import Any, Final

from experiment import FRAMEWORKS, Row, Tables, figures, options, stage
from warehouse_floor.layout import NODES
from warehouse_floor.link import FloorLink

from uoarm.client import RemoteRobot, connect

_VEHICLES: Final = {
    "amr": ("Amr", ("n11", "home1")),
    "cart": ("Cart", ("n12", "home2")),
    "agv": ("Agv", ("n13", "home3")),
}
_LOOK: Final = 0.005
_AGAIN: Final = 0.2
_MOVED: Final = 0.002
_METRES_A_SECOND: Final = 0.4
_LIMIT: Final = 60.0
_STILL: Final = 0.4


class Floor:
    """Where the bodies are, asked again and again."""

    def __init__(self, link: FloorLink) -> None:
        self._link = link
        self.bodies: dict[str, Any] = {}

    async def watch(self) -> None:
        """Go on until cancelled."""
        while True:
            self.bodies = self._link.ask()["bodies"]
            await asyncio.sleep(_LOOK)

    def place(self, name: str) -> tuple[float, float, float]:
        """Return position and heading."""
        body = self.bodies[name]
        return body["x"], body["y"], body["heading"]

    async def moves(self, name: str) -> float:
        """Return the seconds until a body is not where it is now.

        Raises:
            TimeoutError: it stood for a minute.
        """
        then, begun = self.place(name), time.monotonic()
        while all(abs(a - b) < _MOVED for a, b in zip(self.place(name), then, strict=True)):
            if time.monotonic() > begun + _LIMIT:
                raise TimeoutError(f"{name} did not move within {_LIMIT:g} s")
            await asyncio.sleep(_LOOK)
        return time.monotonic() - begun

    async def stands(self, name: str) -> float:
        """Wait until a body has not moved for a while; return since when, monotonic."""
        then, since = self.place(name), time.monotonic()
        while time.monotonic() < since + _STILL:
            await asyncio.sleep(_LOOK)
            if self.place(name) != then:
                then, since = self.place(name), time.monotonic()
        return since


async def to_the_wheel(robot: RemoteRobot, floor: Floor, vehicle: str, count: int) -> list[float]:
    """Return the seconds from each command until the vehicle moves."""
    name, nodes = _VEHICLES[vehicle]
    found: list[float] = []
    held = await robot.request(f"drive{name}", receive=False, wait=_LIMIT)
    async with held, await robot.request(f"transport{name}.state", wait=_LIMIT) as stream:
        reached = 0

        async def listen() -> None:
            nonlocal reached
            async for state in stream:
                reached = state["leg"]

        listening = asyncio.create_task(listen())
        first = int(time.time())
        for leg in range(first, first + 1 + count):
            node = nodes[(leg - first) % 2]
            way = (nodes[(leg - first + 1) % 2], node)  # from where it stands
            points = [{"node": text, "x": NODES[text][0], "y": NODES[text][1]} for text in way]
            command = {"leg": leg, "points": points, "carry": ""}
            await floor.stands(vehicle)
            moves = asyncio.create_task(floor.moves(vehicle))
            await asyncio.sleep(0)  # it has noted where the vehicle stands
            while reached != leg or not moves.done():
                await stream.send(command, "command")
                await asyncio.sleep(_AGAIN)
            found.append(moves.result())
        listening.cancel()
    return found[1:]  # with the first one what is lazy comes up


async def by_hand(robot: RemoteRobot, floor: Floor, count: int) -> tuple[list[float], list[float]]:
    """Return the seconds from each velocity until the vehicle moves, and until it stands again."""
    moved: list[float] = []
    stood: list[float] = []
    async with await robot.request("steerAmr", receive=False, wait=_LIMIT) as stream:
        for number in range(count + 1):
            await floor.stands("amr")
            moves = asyncio.create_task(floor.moves("amr"))
            await asyncio.sleep(0)  # it has noted where the vehicle stands
            forward = _METRES_A_SECOND if number % 2 else -_METRES_A_SECOND
            still = dict.fromkeys("xyz", 0.0)
            begun = time.monotonic()
            await stream.send({"linear": {**still, "x": forward}, "angular": still})
            moved.append(await moves)
            stood.append(await floor.stands("amr") - begun)
    return moved[1:], stood[1:]


async def measure(url: str, floor: Floor, count: int) -> list[Row]:
    """Measure everything and return the table."""
    watch = asyncio.create_task(floor.watch())
    try:
        await asyncio.sleep(1)
        async with connect(url) as robot:
            work = [to_the_wheel(robot, floor, vehicle, count) for vehicle in _VEHICLES]
            found = dict(zip(FRAMEWORKS.values(), await asyncio.gather(*work), strict=True))
            moved, stood = await by_hand(robot, floor, count)
    finally:
        watch.cancel()
    kinds = {f"command to wheel, {name}": of for name, of in found.items()}
    kinds["velocity to wheel, ROS 2 by hand"] = moved
    kinds["the only velocity to standing, ROS 2 by hand"] = stood
    return [{"from, to": what, **figures(seconds)} for what, seconds in kinds.items()]


def main() -> int:
    """Run it and print the table."""
    chosen = options(__doc__, count=30)
    tables = Tables(chosen.json)
    with stage(without=["orders"]) as scene:
        rows = asyncio.run(measure(scene.places.robot_url, Floor(scene.link), chosen.count))
        truth = scene.link.ask()
    tables.add(f"From the command to the wheel; collisions: {truth['collisions']}", rows)
    tables.print()
    return 1 if truth["collisions"] else 0


if __name__ == "__main__":
    sys.exit(main())
