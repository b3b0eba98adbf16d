"""A whole warehouse in one thread and no time: floor, vehicles, coordinator, and their faults."""

from __future__ import annotations

import sys
from collections import deque
from pathlib import Path

from attrs import asdict

WAREHOUSE = Path(__file__).parents[2] / "examples" / "warehouse"
sys.path.insert(0, str(WAREHOUSE))

from warehouse_floor.bodies import Floor  # noqa: E402
from warehouse_floor.layout import NODES  # noqa: E402
from warehouse_floor.navigator import STAND, Driver  # noqa: E402
from warehouse_orders.coordinator import Command, Coordinator, Report  # noqa: E402
from warehouse_orders.orders import Note, Order, Status, replay  # noqa: E402

STEP, EVERY, LATE = 0.1, 3, 0.25
LIFETIME = 1.0


class Fleet:
    """Vehicles 1 to `count`; the third moves sideways and carries little."""

    def __init__(self, count: int = 3) -> None:
        self.now = 0.0
        self.floor = Floor()
        self.names = [f"vehicle{number}" for number in range(1, count + 1)]
        self.drivers = {name: Driver(sideways=name == "vehicle3") for name in self.names}
        self.commands: dict[str, tuple[float, Command]] = {}
        self.dead: set[str] = set()
        self.reports: deque[tuple[float, str, Report]] = deque()
        self.placed: list[dict[str, object]] = []
        self.journal: list[Note] = []
        self.coordinator: Coordinator | None = Coordinator()
        for number, name in enumerate(self.names, 1):
            self.floor.add(name, f"home{number}", is_holonomic=name == "vehicle3")

    def place(self, name: str, source: str = "shelf1", target: str = "", load: float = 5) -> None:
        self.placed.append({"order": name, "source": source, "target": target, "load": load})
        if self.coordinator is not None:
            self.coordinator.place(Order.placed(self.placed[-1]))

    def restart(self) -> None:
        """Have the coordinator begin again from its journal."""
        orders = replay(self.placed, [note.line() for note in self.journal])
        self.coordinator = Coordinator(orders, first_leg=round(self.now * 100))

    def kill(self, name: str) -> None:
        self.dead.add(name)

    def revive(self, name: str) -> None:
        """Start the program of a vehicle again; it knows nothing of what it did."""
        self.dead.discard(name)
        self.drivers[name] = Driver(sideways=name == "vehicle3")
        self.commands.pop(name, None)

    def run(self, seconds: float) -> None:
        for tick in range(round(seconds / STEP)):
            self.now += STEP
            for name in self.names:
                if name not in self.dead:
                    self.drive(name)
            self.floor.step(self.now, STEP)
            if tick % EVERY == 0:
                self.exchange()

    def drive(self, name: str) -> None:
        sense = self.floor.sense(name)
        driver = self.drivers[name]
        given, command = self.commands.get(name, (-LIFETIME, Command(name, 0, (), "")))
        is_live = self.now - given < LIFETIME and sense.is_localised
        driver.go(command.leg, [NODES[node] for node in command.way] if is_live else ())
        step = driver.step((sense.x, sense.y, sense.heading), sense.load, command.carry)
        velocity = step.velocity if is_live else STAND
        self.floor.command(name, velocity, given + LIFETIME, self.now)
        self.floor.carry(name, driver.carry)

    def exchange(self) -> None:
        for name in self.names:
            if name not in self.dead:
                payload = 10.0 if name == "vehicle3" else 50.0
                told = asdict(self.floor.sense(name))
                report = Report(
                    payload=payload, leg=self.drivers[name].done, drives_on=False, **told
                )
                self.reports.append((self.now + LATE, name, report))
        while self.reports and self.reports[0][0] <= self.now:
            _, name, report = self.reports.popleft()
            if self.coordinator is not None and name not in self.dead:
                self.coordinator.report(name, report, self.now)
        if self.coordinator is not None:
            commands = self.coordinator.tick(self.now)
            self.journal.extend(self.coordinator.notes())
            for command in commands:
                self.commands[command.vehicle] = (self.now, command)

    @property
    def done(self) -> set[str]:
        return {note.order for note in self.journal if note.status is Status.DONE}

    def check(self) -> None:
        """Nothing touched, nothing moved by itself, nothing was lost or done twice."""
        floor = self.floor
        assert (floor.collisions, floor.unauthorised, floor.repeats) == (0, 0, 0)
        assert all(times <= 1 for times in floor.deliveries.values())
        assert self.done <= {name for name, times in floor.deliveries.items() if times == 1}
        finished = [note.order for note in self.journal if note.status is Status.DONE]
        assert len(finished) == len(set(finished))

    def settle(self, seconds: float = 600) -> None:
        """Let all faults be over, and have everything done."""
        self.floor.obstacles.clear()
        for name in [*self.dead]:
            self.revive(name)
        for body in self.floor.bodies.values():
            body.is_localised = True
        if self.coordinator is None:
            self.restart()
        wanted = {str(entry["order"]) for entry in self.placed}
        until = self.now + seconds
        while self.done != wanted and self.now < until:
            self.run(5)
        self.check()
        assert self.done == wanted
