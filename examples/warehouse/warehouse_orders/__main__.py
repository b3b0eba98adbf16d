"""The application: orders in, commands out, the floor shown; it may die and be started again.

`python -m warehouse_orders URL FOLDER` until interrupted. FOLDER has the journals. It knows a robot
behind an address, and vehicles as functions whose name begins with `transport` and which have an
output `state` and an input `command`. Boxes that arrived are weighed by the function `weigh`, and
`lamp` shows whether all is well; without them the vehicles go on.
"""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from warehouse_floor.layout import NODES

from uoarm.client import RemoteRobot, connect
from uoarm.errors import UoarmError
from warehouse_orders.coordinator import Command, Coordinator, Report
from warehouse_orders.orders import Journal, Order, Reservation, Status, read_lines, replay
from warehouse_orders.weighing import Weighing

_PREFIX: Final = "transport"
_TICK_SECONDS: Final = 0.2
_LOOK_SECONDS: Final = 3.0
_WAIT_SECONDS: Final = 20.0
_AGAIN_SECONDS: Final = 1.0
_LATEST_DONE: Final = 5
_WEIGH_SECONDS: Final = 5.0
_LAMP_SECONDS: Final = 1.0


class Application:
    """The coordinator with its journal and its connections.

    Args:
        folder: of the journals.
    """

    def __init__(self, folder: Path) -> None:
        self._placed = folder / "placed.jsonl"
        self._offset = 0
        noted = folder / "noted.jsonl"
        orders = replay(self._read(), [entry for entry, _ in read_lines(noted)])
        self._journal = Journal(noted)
        reserved = folder / "reserved.jsonl"
        held = Reservation.latest([entry for entry, _ in read_lines(reserved)])
        self._reservations = Journal(reserved)
        self._coordinator = Coordinator(orders, first_leg=int(time.time()), held=held)
        weighed = folder / "weighed.jsonl"
        self._weighing = Weighing([entry for entry, _ in read_lines(weighed)])
        self._weighed = Journal(weighed)
        self._streams: dict[str, Any] = {}
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._said: dict[str, str] = {}

    def _read(self) -> list[Mapping[str, Any]]:
        """Return the orders that were placed since this was called last."""
        lines = list(read_lines(self._placed, self._offset))
        if lines:
            self._offset = lines[-1][1]
        return [entry for entry, _ in lines]

    async def run(self, url: str) -> None:
        """Go on until cancelled; a robot that is not there is waited for."""
        while True:
            try:
                async with connect(url, resume=False) as robot:
                    await self._with(robot)
            except (UoarmError, OSError, TimeoutError) as error:
                print(f"no robot: {error}", flush=True)
            await asyncio.sleep(_AGAIN_SECONDS)

    async def _with(self, robot: RemoteRobot) -> None:
        """Go on until the robot is gone."""
        shown = await robot.request("floor", receive=False)
        try:
            print("ready", flush=True)
            looked = float("-inf")
            while True:
                now = time.monotonic()
                if now - looked > _LOOK_SECONDS:
                    looked = now
                    await self._look(robot)
                    self._keep("weigh", self._weigh(robot))
                    self._keep("lamp", self._light(robot))
                for entry in self._read():
                    self._coordinator.place(Order.placed(entry))
                commands = self._coordinator.tick(now)
                await self._write()
                for command in commands:
                    await self._send(command)
                await shown.send(self._picture())
                await asyncio.sleep(_TICK_SECONDS)
        finally:
            for task in self._tasks.values():
                task.cancel()
            await asyncio.gather(*self._tasks.values(), return_exceptions=True)
            self._tasks.clear()

    async def _look(self, robot: RemoteRobot) -> None:
        """Open every vehicle that there is, and what takes its commands to its framework."""
        functions = await robot.functions()
        vehicles = [
            function["name"]
            for function in functions
            if function["name"] != _PREFIX and function["name"].startswith(_PREFIX)
        ]
        for function in functions:
            uses = {name for component in function["components"] for name in component["uses"]}
            if uses.intersection(vehicles):
                self._keep(function["name"], self._hold(robot, function["name"]))
        for name in vehicles:
            self._keep(name, self._listen(robot, name))

    def _keep(self, name: str, work: Any) -> None:
        task = self._tasks.get(name)
        if task is None or task.done():
            self._tasks[name] = asyncio.create_task(work)
        else:
            work.close()

    async def _hold(self, robot: RemoteRobot, name: str) -> None:
        """Keep a function open of which nothing is read."""
        try:
            stream = await robot.request(name, receive=False, wait=_WAIT_SECONDS)
            async for _ in stream:
                pass
        except UoarmError as error:
            self._report(name, error)

    async def _listen(self, robot: RemoteRobot, name: str) -> None:
        """Take what a vehicle says, as long as it can be had."""
        try:
            async with await robot.request(f"{name}.state", wait=_WAIT_SECONDS) as stream:
                self._streams[name] = stream
                try:
                    async for state in stream:
                        self._coordinator.report(name, Report(**state), time.monotonic())
                finally:
                    self._streams.pop(name, None)
        except UoarmError as error:
            self._report(name, error)

    async def _weigh(self, robot: RemoteRobot) -> None:
        """Have every box weighed that arrived; one that cannot be is tried again later."""
        while box := self._weighing.due(self._coordinator.orders.values()):
            try:
                found = await robot.call("weigh", {"box": box}, timeout=_WEIGH_SECONDS)
            except UoarmError as error:
                self._report("weigh", error)
                return
            line = {"order": box, "mass": found["mass"]}
            await asyncio.to_thread(self._weighed.write, [line])
            self._weighing.take(box, found["mass"])

    async def _light(self, robot: RemoteRobot) -> None:
        """Say again and again what the lamp shows."""
        try:
            async with await robot.request("lamp", receive=False, wait=_WAIT_SECONDS) as stream:
                while True:
                    await stream.send({"colour": self._colour})
                    await asyncio.sleep(_LAMP_SECONDS)
        except UoarmError as error:
            self._report("lamp", error)

    @property
    def _colour(self) -> str:
        return self._weighing.colour(self._coordinator.orders)

    def _report(self, name: str, error: UoarmError) -> None:
        """Say why a function cannot be had, once for each reason."""
        if self._said.get(name) != str(error):
            self._said[name] = str(error)
            print(f"{name}: {error}", flush=True)

    async def _write(self) -> None:
        """Have the journals on the disk before a vehicle is commanded."""
        notes = [note.line() for note in self._coordinator.notes()]
        held = [reservation.line() for reservation in self._coordinator.reservations()]
        if notes or held:
            await asyncio.to_thread(self._journal.write, notes)
            await asyncio.to_thread(self._reservations.write, held)

    async def _send(self, command: Command) -> None:
        stream = self._streams.get(command.vehicle)
        if stream is None:
            return
        points = [{"node": node, "x": NODES[node][0], "y": NODES[node][1]} for node in command.way]
        message = {"leg": command.leg, "points": points, "carry": command.carry}
        with suppress(UoarmError):  # it is silent soon, and then its order goes to another
            await stream.send(message, "command")

    def _picture(self) -> dict[str, Any]:
        orders = list(self._coordinator.orders.values())
        done = [order for order in orders if order.status is Status.DONE]
        shown = [order for order in orders if order.status is not Status.DONE]
        return {
            "vehicles": list(self._seen()),
            "orders": [self._listed(order) for order in (*shown, *done[-_LATEST_DONE:])],
            "done": len(done),
            "lamp": self._colour,
        }

    def _seen(self) -> Iterator[dict[str, Any]]:
        for vehicle in self._coordinator.vehicles.values():
            report = vehicle.report
            condition = (
                "dead" if not vehicle.is_alive
                else "lost" if not report.is_localised
                else "blocked" if report.is_blocked
                else "charging" if vehicle.is_charging
                else "driving" if vehicle.target
                else "free"
            )  # fmt: skip
            yield {
                "name": vehicle.name,
                "x": report.x,
                "y": report.y,
                "heading": report.heading,
                "battery": report.battery,
                "payload": report.payload,
                "load": report.load,
                "order": vehicle.order,
                "way": list(vehicle.held),
                "condition": condition,
            }

    def _listed(self, order: Order) -> dict[str, Any]:
        why = ""
        if order.status is Status.WAITING:
            vehicles = self._coordinator.vehicles.values()
            reasons = [
                (vehicle.name, self._coordinator.unfit(vehicle, order)) for vehicle in vehicles
            ]
            why = "; ".join(f"{name} {reason}" for name, reason in reasons if reason)
        return {
            "order": order.name,
            "source": order.source,
            "target": order.target,
            "load": order.load,
            "mass": self._weighing.masses.get(order.name, 0.0),
            "status": order.status.value,
            "vehicle": order.vehicle,
            "why": why,
        }


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        asyncio.run(Application(Path(sys.argv[2])).run(sys.argv[1]))
