"""Gives orders to vehicles, and ways to those who drive, so that none is lost and none collide.

A plain state machine: reports, deaths, orders and time come in, commands and notes for the journal
go out. A vehicle that drives holds every node of its way before it starts, and gives each back as
it has left it, so that no two ever wait for one another on the way. It is sent a few nodes at a
time. What it was sent once is no other's until it has said that it came to the end, or that it
has taken the command to stand: not while it is silent, and not when the coordinator begins again,
which is why reservations are in the journal before a vehicle is sent there.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator
from typing import Final

from attrs import define, frozen
from warehouse_floor.layout import DOCKS, HOMES, NODES, PITCH, node_at, route

from warehouse_orders.orders import Note, Order, Reservation, Status

__all__ = ["Command", "Coordinator", "Report", "Vehicle"]

SILENCE: Final = 3.0
"""Seconds without a report after which a vehicle counts as dead."""

_ROLLING, _ROLLS_SECONDS = 0.05, 1.0
_EMPTY, _FULL = 25.0, 60.0  # per cent of the battery: goes to charge, is used again
_CLOSED_SECONDS: Final = 15.0
_LATE_SECONDS: Final = 1.0
_STUCK_SECONDS: Final = 20.0
_STEP_METRES: Final = 0.1
_NODES_AT_ONCE: Final = 3
"""The way of one command, which is as far as a vehicle can come without a report."""


@frozen
class Report:
    """What a vehicle says of itself, whatever its framework.

    Attributes:
        x: metres.
        y: metres.
        heading: radians.
        speed: metres a second.
        battery: per cent.
        payload: kg that it can carry.
        load: the box that it carries, or nothing.
        leg: the last command that it carried out to the end.
        stopped: the command to stand that it has taken; 0: it may follow one given before.
        is_localised: whether it knows where it is.
        is_blocked: whether something stands in its way.
        drives_on: whether it drives to the end of its way when no client renews the command.
    """

    x: float
    y: float
    heading: float
    speed: float
    battery: float
    payload: float
    load: str
    leg: int
    stopped: int
    is_localised: bool
    is_blocked: bool
    drives_on: bool


@frozen
class Command:
    """What a vehicle shall do; it holds as long as it is renewed.

    Attributes:
        vehicle: which one.
        leg: a number that is new for every new command.
        way: nodes to be visited, the first of which it stands at; empty: stand still.
        carry: the box that it shall carry once it is there; empty: none.
    """

    vehicle: str
    leg: int
    way: tuple[str, ...]
    carry: str


@define
class Vehicle:
    """What is known of one vehicle.

    Attributes:
        name: of the vehicle.
        report: the last one.
        received_at: when it came.
        is_alive: whether it reports itself.
        held: nodes that no other may enter, the first of which it is at.
        target: where it is going; empty: nowhere.
        leg_end: where its last command takes it, which is on its way to the target.
        order: that it has.
        leg: of its last command.
        carry: of its last command.
        stopped: when it was commanded to stand.
        seen: where it was when it moved last, and when that was.
        is_charging: whether it stays at home until the battery is full enough.
    """

    name: str
    report: Report
    received_at: float
    is_alive: bool = True
    held: tuple[str, ...] = ()
    target: str = ""
    leg_end: str = ""
    order: str = ""
    leg: int = 0
    carry: str = ""
    stopped: float = 0.0
    seen: tuple[float, float, float] = (0.0, 0.0, 0.0)
    is_charging: bool = False

    @property
    def is_usable(self) -> bool:
        """Whether it can be sent anywhere: it reports itself, and knows that it is on the floor."""
        return self.is_alive and self.report.is_localised and bool(self.held)

    @property
    def is_there(self) -> bool:
        """Whether it has carried out its last command."""
        return bool(self.target) and self.report.leg == self.leg

    @property
    def is_standing(self) -> bool:
        """Whether it has surely stopped, and will not drive before a command.

        Speed alone does not say so: who turns, waits at an obstacle or has not been reached by the
        command to stand yet has none either.
        """
        if self.target or self.report.speed >= _ROLLING:
            return False
        has_taken = self.report.stopped == self.leg
        return self.report.leg == self.leg or (
            has_taken and self.received_at - self.stopped > _ROLLS_SECONDS
        )


class Coordinator:
    """The state machine. No method waits, and none does more than change what is below.

    Args:
        orders: those that a journal has.
        first_leg: above every number of a command that was given before.
        held: what a journal has of the vehicles; they are dead until they report.

    Attributes:
        orders: by name, in the order in which they were placed.
        vehicles: by name.
    """

    def __init__(
        self,
        orders: Iterable[Order] = (),
        first_leg: int = 1,
        held: Collection[Reservation] = (),
    ) -> None:
        self.orders: dict[str, Order] = {order.name: order for order in orders}
        self.vehicles: dict[str, Vehicle] = {
            reservation.vehicle: _unreported(reservation) for reservation in held
        }
        self._reserved = {reservation.vehicle: reservation for reservation in held}
        self._leg = max([first_leg, *(reservation.leg for reservation in held)])
        self._closed: dict[str, float] = {}
        self._notes: list[Note] = []
        for order in self.orders.values():
            if order.status is Status.ASSIGNED:  # who had it may never report again
                self._note(order, Status.WAITING, "")

    def notes(self) -> list[Note]:
        """Return what is new for the journal, which must have it before a command is sent."""
        notes, self._notes = self._notes, []
        return notes

    def reservations(self) -> list[Reservation]:
        """Return what has changed of the vehicles' reservations, for the journal as well."""
        vehicles = self.vehicles.values()
        held = [Reservation(vehicle.name, vehicle.leg, _granted(vehicle)) for vehicle in vehicles]
        changed = [
            reservation
            for reservation in held
            if self._reserved.get(reservation.vehicle) != reservation
        ]
        self._reserved = {reservation.vehicle: reservation for reservation in held}
        return changed

    def place(self, order: Order) -> None:
        """Take an order; one that is known already is not taken twice."""
        self.orders.setdefault(order.name, order)

    def report(self, name: str, report: Report, now: float) -> None:
        """Take what a vehicle says."""
        vehicle = self.vehicles.get(name)
        if vehicle is None or not vehicle.is_alive:
            vehicle = self._appear(name, report, now)
        before, vehicle.report, vehicle.received_at = vehicle.report, report, now
        if not report.is_localised:
            return
        if not before.is_localised:
            self._stand(vehicle)
        self._release(vehicle)
        self._account(vehicle)
        self._watch(vehicle, now)
        if report.is_blocked and vehicle.target and len(vehicle.held) > 1:
            self._closed[vehicle.held[1]] = now + _CLOSED_SECONDS
            self._stand(vehicle)

    def lost(self, name: str) -> None:
        """Take that a vehicle is dead; an order of which it has not the box goes to another."""
        vehicle = self.vehicles.get(name)
        if vehicle is None or not vehicle.is_alive:
            return
        vehicle.is_alive = False
        vehicle.held, vehicle.target = _granted(vehicle), ""
        order = self.orders.get(vehicle.order)
        if order is not None and order.status is Status.ASSIGNED:
            self._note(order, Status.WAITING, "")
            vehicle.order = ""

    def tick(self, now: float) -> list[Command]:
        """Decide what every vehicle shall do, and return it; it is sent again at each tick."""
        for vehicle in self.vehicles.values():
            if vehicle.is_alive and now - vehicle.received_at > SILENCE:
                self.lost(vehicle.name)
        self._closed = {node: until for node, until in self._closed.items() if until > now}
        self._assign()
        for vehicle in self.vehicles.values():
            if vehicle.is_usable:
                self._direct(vehicle)
        return [
            self._command(vehicle, now) for vehicle in self.vehicles.values() if vehicle.is_alive
        ]

    def unfit(self, vehicle: Vehicle, order: Order) -> str:
        """Return why a vehicle cannot have an order now, what lasts first; empty: it can."""
        if vehicle.report.payload < order.load:
            return f"carries {vehicle.report.payload:g} kg, not {order.load:g}"
        if not vehicle.is_alive:
            return "does not report"
        if not vehicle.report.is_localised:
            return "does not know where it is"
        if not vehicle.held:
            return "is off the floor"
        if vehicle.order or vehicle.report.load:
            return f"has {vehicle.order or vehicle.report.load}"
        if vehicle.is_charging or vehicle.report.battery < _EMPTY:
            return f"charges, {vehicle.report.battery:.0f} %"
        return ""

    def _appear(self, name: str, report: Report, now: float) -> Vehicle:
        """A vehicle is new, or back: whatever it was doing, it stands now."""
        known = self.vehicles.get(name)
        vehicle = Vehicle(name, report, now)
        if known is not None:
            vehicle.order, vehicle.held = known.order, known.held
        self.vehicles[name] = vehicle
        self._stand(vehicle)
        for order in self.orders.values():
            if order.vehicle == name and order.status is Status.LOADED:
                vehicle.order = order.name
        return vehicle

    def _watch(self, vehicle: Vehicle, now: float) -> None:
        """Give a vehicle another command where the last one has led nowhere for a while."""
        x, y, since = vehicle.seen
        has_moved = math.dist((x, y), (vehicle.report.x, vehicle.report.y)) > _STEP_METRES
        if has_moved or not vehicle.target:
            vehicle.seen = (vehicle.report.x, vehicle.report.y, now)
        elif now - since > _STUCK_SECONDS:
            self._stand(vehicle)

    def _account(self, vehicle: Vehicle) -> None:
        """Hold what it carries against what it should."""
        carried = self.orders.get(vehicle.report.load)
        if carried is not None and carried.status is not Status.DONE:
            if carried.vehicle != vehicle.name:
                self._take_away(carried)
                self._take_away(self.orders.get(vehicle.order))
                vehicle.order = carried.name
            if carried.status is not Status.LOADED or carried.vehicle != vehicle.name:
                self._note(carried, Status.LOADED, vehicle.name)
        own = self.orders.get(vehicle.order)
        # Boxes can be put down at docks only, and this is said only to who has one.
        if own is not None and own.status is Status.LOADED and not vehicle.report.load:
            self._note(own, Status.DONE, vehicle.name)
            vehicle.order = ""

    def _take_away(self, order: Order | None) -> None:
        """Let no vehicle go for an order any more."""
        if order is None:
            return
        holder = self.vehicles.get(order.vehicle)
        if holder is not None and holder.order == order.name:
            holder.order = ""
            if holder.is_usable:
                self._stand(holder)
        if order.status is Status.ASSIGNED:
            self._note(order, Status.WAITING, "")

    def _note(self, order: Order, status: Status, vehicle: str) -> None:
        order.status, order.vehicle = status, vehicle
        self._notes.append(Note(order.name, status, vehicle))

    def _assign(self) -> None:
        """Give each order that waits, the oldest first, to the nearest vehicle that is fit."""
        for order in self.orders.values():
            if order.status is not Status.WAITING or self._is_taken(order.source):
                continue
            ways = [
                (len(way), vehicle.name)
                for vehicle in self.vehicles.values()
                if not self.unfit(vehicle, order)
                and (way := route(vehicle.held[0], order.source)) is not None
            ]
            if ways:
                _, name = min(ways)
                self.vehicles[name].order = order.name
                self._stand(self.vehicles[name])
                self._note(order, Status.ASSIGNED, name)

    def _direct(self, vehicle: Vehicle) -> None:
        """Give a vehicle its next way once it has none, or has come to the end of it."""
        report = vehicle.report
        if vehicle.is_charging:
            vehicle.is_charging = report.battery < _FULL
        elif report.battery < _EMPTY and not vehicle.order:
            vehicle.is_charging = True
        if vehicle.is_there and vehicle.leg_end != vehicle.target:
            self._go_on(vehicle)
        elif vehicle.is_there:
            vehicle.target, vehicle.stopped = "", 0.0
        if not vehicle.is_standing:
            return
        order = self.orders.get(vehicle.order)
        if order is None:
            if vehicle.held[0] not in HOMES:
                self._send(vehicle, HOMES, report.load)
        elif order.status is Status.ASSIGNED:
            self._send(vehicle, (order.source,), order.name)
        else:
            self._send(vehicle, (order.target,) if order.target else DOCKS, "")

    def _send(self, vehicle: Vehicle, targets: Iterable[str], carry: str) -> None:
        """Let it drive to the nearest of some nodes, if a whole way to it is free."""
        held = {node for other in self._others(vehicle) for node in other.held}
        closed = held | self._closed.keys()
        start = vehicle.held[0]
        ways = [
            (len(way), way)
            for target in targets
            if not self._is_taken(target, vehicle)
            and (way := route(start, target, closed)) is not None
            and not closed.intersection(way[1:])
        ]
        if ways:
            _, way = min(ways)
            # Between two nodes it holds both, until it stands at the first of its way.
            vehicle.held = (*way, *(node for node in vehicle.held if node not in way))
            vehicle.target, vehicle.carry = way[-1], carry
            self._go_on(vehicle)

    def _go_on(self, vehicle: Vehicle) -> None:
        """Give it the next part of its way, in which alone it can be should it fall silent."""
        last = vehicle.held.index(vehicle.target)
        vehicle.leg_end = vehicle.held[min(last, _NODES_AT_ONCE)]
        self._leg += 1
        vehicle.leg = self._leg

    def _is_taken(self, node: str, but: Vehicle | None = None) -> bool:
        """Whether a vehicle is, or shall be, where another would have to wait."""
        others = self.vehicles.values() if but is None else self._others(but)
        wanted = (self.orders.get(vehicle.order) for vehicle in others)
        shelves = {order.source for order in wanted if order and order.status is Status.ASSIGNED}
        return node in shelves or any(
            node == vehicle.target or node in vehicle.held for vehicle in others
        )

    def _others(self, vehicle: Vehicle) -> list[Vehicle]:
        return [item for item in self.vehicles.values() if item is not vehicle]

    def _stand(self, vehicle: Vehicle) -> None:
        """Let it stop where it is; it holds what it was sent until it has."""
        around = tuple(_around(vehicle.report.x, vehicle.report.y))
        vehicle.held = (*around, *(node for node in _granted(vehicle) if node not in around))
        vehicle.target, vehicle.carry = "", vehicle.report.load
        vehicle.stopped = vehicle.received_at
        self._leg += 1
        vehicle.leg = self._leg

    def _release(self, vehicle: Vehicle) -> None:
        """Give back what lies behind it."""
        if vehicle.is_standing:
            around = tuple(_around(vehicle.report.x, vehicle.report.y))
            vehicle.held = around or vehicle.held
        here = node_at(vehicle.report.x, vehicle.report.y)
        if vehicle.target and here in vehicle.held:
            way = vehicle.held[: vehicle.held.index(vehicle.target) + 1]
            if here in way:
                vehicle.held = way[way.index(here) :]

    def _command(self, vehicle: Vehicle, now: float) -> Command:
        way: tuple[str, ...] = ()
        is_present = now - vehicle.received_at <= _LATE_SECONDS or vehicle.report.drives_on
        if vehicle.target and vehicle.is_usable and is_present:
            way = vehicle.held[: vehicle.held.index(vehicle.leg_end) + 1]
        is_last = bool(way) and vehicle.leg_end == vehicle.target
        carry = vehicle.carry if is_last else vehicle.report.load
        return Command(vehicle.name, vehicle.leg, way, carry)


def _unreported(known: Reservation) -> Vehicle:
    """Return a vehicle of which nothing is known but what it holds."""
    name, held = known.vehicle, known.nodes
    x, y = NODES[held[0]] if held else (0.0, 0.0)
    nothing = Report(
        x, y, heading=0.0, speed=0.0, battery=0.0, payload=0.0, load="", leg=0, stopped=0,
        is_localised=False, is_blocked=False, drives_on=False,
    )  # fmt: skip
    return Vehicle(name, nothing, float("-inf"), is_alive=False, held=held, leg=known.leg)


def _granted(vehicle: Vehicle) -> tuple[str, ...]:
    """Return what it holds but for its way from the end of its last command on.

    It was never sent there, so that is free once it is not led any more.
    """
    if not vehicle.target:
        return vehicle.held
    end, target = map(vehicle.held.index, (vehicle.leg_end, vehicle.target))
    # Behind its way are the nodes between which it stood at the command.
    return (*vehicle.held[: end + 1], *vehicle.held[target + 1 :])


def _around(x: float, y: float) -> Iterator[str]:
    """Yield the nodes that a vehicle here keeps others from, the nearest first."""
    apart = sorted((math.dist((x, y), place), name) for name, place in NODES.items())
    for metres, name in apart:
        if metres < PITCH * 0.97 and (metres > PITCH / 10 or name == apart[0][1]):
            yield name
        if metres < PITCH / 10:
            return
