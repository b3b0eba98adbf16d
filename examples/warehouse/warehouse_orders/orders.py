"""Transport orders and reservations, and the journal from which they are known after a death."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping
from enum import Enum
from pathlib import Path
from typing import Any

from attrs import define, frozen
from warehouse_floor.layout import DOCKS, SHELVES

__all__ = ["Journal", "Note", "Order", "Reservation", "Status", "read_lines", "replay"]


class Status(Enum):
    """How far an order is. It never goes back from `LOADED`."""

    WAITING = "waiting"
    ASSIGNED = "assigned"
    LOADED = "loaded"
    DONE = "done"


@define
class Order:
    """Carry one box.

    Attributes:
        name: of the order and of its box.
        source: the shelf.
        target: the dock; empty: whichever is free.
        load: kg.
        status: how far it is.
        vehicle: which one has it; of one that is done, which had it.
    """

    name: str
    source: str
    target: str
    load: float
    status: Status = Status.WAITING
    vehicle: str = ""

    @classmethod
    def placed(cls, entry: Mapping[str, Any]) -> Order:
        """Make an order of what a client asked for.

        Raises:
            ValueError: it cannot be carried out; the text says why.
        """
        order = cls(entry["order"], entry["source"], entry["target"], float(entry["load"]))
        if order.source not in SHELVES:
            raise ValueError(f"there is no shelf {order.source!r}, but {', '.join(SHELVES)}")
        if order.target and order.target not in DOCKS:
            raise ValueError(f"there is no dock {order.target!r}, but {', '.join(DOCKS)}")
        if not order.name or len(order.name) > 64 or not order.load >= 0:  # noqa: PLR2004
            raise ValueError("an order has a name of 1 to 64 characters and a load of 0 kg or more")
        return order


@frozen
class Note:
    """One line of the journal: an order came to have this status, with this vehicle."""

    order: str
    status: Status
    vehicle: str

    def line(self) -> dict[str, str]:
        """Return it as plain values."""
        return {"order": self.order, "status": self.status.value, "vehicle": self.vehicle}


@frozen
class Reservation:
    """A vehicle holds these nodes, and this is the number of its last command."""

    vehicle: str
    leg: int
    nodes: tuple[str, ...]

    def line(self) -> dict[str, Any]:
        """Return it as plain values."""
        return {"vehicle": self.vehicle, "leg": self.leg, "nodes": list(self.nodes)}

    @classmethod
    def latest(cls, lines: Iterable[Mapping[str, Any]]) -> list[Reservation]:
        """Return the last one of each vehicle."""
        held = {line["vehicle"]: line for line in lines}
        return [cls(name, value["leg"], tuple(value["nodes"])) for name, value in held.items()]


def replay(placed: Iterable[Mapping[str, Any]], notes: Iterable[Mapping[str, Any]]) -> list[Order]:
    """Return the orders as they were noted last; notes of orders never placed are none."""
    orders: dict[str, Order] = {}
    for entry in placed:
        if entry["order"] not in orders:
            orders[entry["order"]] = Order.placed(entry)
    for note in notes:
        order = orders.get(note["order"])
        if order is not None and order.status is not Status.DONE:
            order.status, order.vehicle = Status(note["status"]), note["vehicle"]
    return list(orders.values())


class Journal:
    """A file of JSON lines that are on the disk when `write` returns.

    Args:
        path: appended to. A last line that a death cut short is ended, so that it is read as
            none and the next one stands alone.
    """

    def __init__(self, path: Path) -> None:
        self._file = path.open("ab+")
        if self._file.tell():
            self._file.seek(-1, os.SEEK_END)
            if self._file.read(1) != b"\n":
                self._file.write(b"\n")

    def write(self, entries: Iterable[Mapping[str, Any]]) -> None:
        """Append entries; returns once they are on the disk."""
        text = "".join(json.dumps(entry) + "\n" for entry in entries)
        if text:
            self._file.write(text.encode())
            self._file.flush()
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def read_lines(path: Path, offset: int = 0) -> Iterator[tuple[Mapping[str, Any], int]]:
    """Read whole lines of a journal, each with the offset behind it.

    Args:
        path: of a journal; where there is none, nothing is read.
        offset: where to begin.
    """
    try:
        with path.open("rb") as file:
            file.seek(offset)
            lines = file.readlines()
    except FileNotFoundError:
        return
    for line in lines:
        if not line.endswith(b"\n"):
            return  # still being written
        offset += len(line)
        try:
            entry = json.loads(line)
        except ValueError:
            continue  # cut short by a death; no client knows that it was taken
        yield entry, offset
