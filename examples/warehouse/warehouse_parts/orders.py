"""Where orders are placed, and where the application shows the floor."""

from __future__ import annotations

import threading
from pathlib import Path

from typing_extensions import TypedDict
from warehouse_orders.orders import Journal, Order, read_lines

__all__ = ["Listed", "OrderBook", "Picture", "Placed", "Seen", "Transport", "board"]


class Transport(TypedDict):
    """Carry `load` kg from a shelf to a dock (empty: any). `order` names it, and its box."""

    order: str
    source: str
    target: str
    load: float


class Placed(TypedDict):
    """The order is on the disk; `is_new`, or it was there before and is not taken twice."""

    order: str
    is_new: bool


class OrderBook:
    """A service that returns once the order can no longer be lost.

    Args:
        file: the journal of orders that were placed.
    """

    def __init__(self, file: str) -> None:
        self._lock = threading.Lock()
        self._known = {entry["order"] for entry, _ in read_lines(Path(file))}
        self._journal = Journal(Path(file))

    def __call__(self, transport: Transport) -> Placed:
        """Place an order; who got no answer may place it again."""
        order = Order.placed(transport)
        with self._lock:
            is_new = order.name not in self._known
            if is_new:
                self._journal.write([transport])
                self._known.add(order.name)
        return {"order": order.name, "is_new": is_new}

    def close(self) -> None:
        """Close the journal."""
        self._journal.close()


class Seen(TypedDict):
    """One vehicle as the coordinator sees it; `way` are the nodes that it holds."""

    name: str
    x: float
    y: float
    heading: float
    battery: float
    payload: float
    load: str
    order: str
    way: list[str]
    condition: str


class Listed(TypedDict):
    """An order; `mass` is what the scale says, 0 before; `why` says why no vehicle has it yet."""

    order: str
    source: str
    target: str
    load: float
    mass: float
    status: str
    vehicle: str
    why: str


class Picture(TypedDict):
    """The floor: vehicles, and the orders that are not done with the last ones that are."""

    vehicles: list[Seen]
    orders: list[Listed]
    done: int
    lamp: str


def board(picture: Picture) -> Picture:
    """Hand on what the coordinator shows to who looks."""
    return picture
