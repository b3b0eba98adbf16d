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
from warehouse_orders.orders import Note, Order, Reservation, Status, replay  # noqa: E402

STEP, EVERY, LATE = 0.1, 3, 0.25
LIFETIME, CANCEL_SECONDS = 1.0, 2.0
DRIVES_ON = "vehicle2"


class Fleet:
    """Vehicles 1 to `count`; the third moves sideways and carries little.

    The second drives each order to its end, whatever dies meanwhile, and is slow to cancel one.
    Attributes:
        dead: vehicles whose program is not there.
        cut: vehicles whose connection is broken in both directions; their program goes on.
    """

    def __init__(self, count: int = 3) -> None:
        self.now = 0.0
        self.floor = Floor()
        self.names = [f"vehicle{number}" for number in range(1, count + 1)]
        self.drivers = {name: Driver(sideways=name == "vehicle3") for name in self.names}
        self.commands: dict[str, tuple[float, Command]] = {}
        self.order: Command | None = None
        self.cancelled = float("inf")
        self.dead: set[str] = set()
        self.cut: set[str] = set()
        self.sent: deque[tuple[float, Command]] = deque()
        self.reserved: list[Reservation] = []
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
        held = Reservation.latest([reservation.line() for reservation in self.reserved])
        self.coordinator = Coordinator(orders, first_leg=round(self.now * 100), held=held)

    def kill(self, name: str) -> None:
        self.dead.add(name)

    def revive(self, name: str) -> None:
        """Start the program of a vehicle again; it knows nothing of what it did."""
        self.dead.discard(name)
        self.drivers[name] = Driver(sideways=name == "vehicle3")
        self.commands.pop(name, None)
        if name == DRIVES_ON:
            self.order = None

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
        if name == DRIVES_ON:
            self.take(command)
            command = self.order or Command(name, command.leg, (), "")
            given, is_live = self.now, self.order is not None and sense.is_localised
        driver.go(command.leg, [NODES[node] for node in command.way] if is_live else ())
        step = driver.step((sense.x, sense.y, sense.heading), sense.load, command.carry)
        velocity = step.velocity if is_live else STAND
        self.floor.command(name, velocity, given + LIFETIME, self.now)
        self.floor.carry(name, driver.carry)

    def take(self, command: Command) -> None:
        """Have one order at a time: it is done, or cancelled, before there is another."""
        order, done = self.order, self.drivers[DRIVES_ON].done
        if order is None:
            if command.way and command.leg != done:
                self.order, self.cancelled = command, float("inf")
            return
        if command.leg != order.leg or not command.way:
            self.cancelled = min(self.cancelled, self.now + CANCEL_SECONDS)
        if done == order.leg or self.now > self.cancelled:
            self.order = None

    def stopped(self, name: str) -> int:
        """Return the command to stand that a vehicle has taken."""
        command = self.commands[name][1] if name in self.commands else None
        if command is None or command.way or (name == DRIVES_ON and self.order is not None):
            return 0
        return command.leg

    def exchange(self) -> None:
        for name in self.names:
            if name not in self.dead | self.cut:
                payload = 10.0 if name == "vehicle3" else 50.0
                reports = asdict(self.floor.sense(name))
                report = Report(
                    payload=payload, leg=self.drivers[name].done, stopped=self.stopped(name),
                    drives_on=name == DRIVES_ON, **reports,
                )  # fmt: skip
                self.reports.append((self.now + LATE, name, report))
        while self.reports and self.reports[0][0] <= self.now:
            _, name, report = self.reports.popleft()
            if self.coordinator is not None and name not in self.dead | self.cut:
                self.coordinator.report(name, report, self.now)
        if self.coordinator is not None:
            commands = self.coordinator.tick(self.now)
            self.journal.extend(self.coordinator.notes())
            self.reserved.extend(self.coordinator.reservations())
            self.sent.extend((self.now + LATE, command) for command in commands)
        while self.sent and self.sent[0][0] <= self.now:
            _, command = self.sent.popleft()
            if command.vehicle not in self.dead | self.cut:
                self.commands[command.vehicle] = (self.now, command)

    @property
    def done(self) -> set[str]:
        return {note.order for note in self.journal if note.status is Status.DONE}

    def check(self) -> None:
        """Nothing touched, nothing moved by itself, nothing was lost or done twice."""
        floor = self.floor
        assert (floor.contacts, floor.unauthorised, floor.repeats) == ([], 0, 0)
        assert all(times <= 1 for times in floor.deliveries.values())
        assert self.done <= {name for name, times in floor.deliveries.items() if times == 1}
        finished = [note.order for note in self.journal if note.status is Status.DONE]
        assert len(finished) == len(set(finished))

    def settle(self, seconds: float = 600) -> None:
        """Let all faults be over, and have everything done."""
        self.floor.obstacles.clear()
        self.cut.clear()
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
