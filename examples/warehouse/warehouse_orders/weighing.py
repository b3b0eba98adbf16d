"""What the station knows of the boxes that arrived, and what its lamp shows. A plain model."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any, Final

from warehouse_orders.orders import Order, Status

__all__ = ["Weighing"]

_TOLERANCE_KG: Final = 0.5


class Weighing:
    """Each box that arrived is weighed once.

    Args:
        lines: of a journal: `order` and `mass`.

    Attributes:
        masses: kg by order.
    """

    def __init__(self, lines: Iterable[Mapping[str, Any]] = ()) -> None:
        self.masses: dict[str, float] = {line["order"]: line["mass"] for line in lines}
        self._last = next(reversed(self.masses), "")

    def due(self, orders: Collection[Order]) -> str:
        """Return a box that stands at a dock and was not weighed; empty: there is none."""
        arrived = (order.name for order in orders if order.status is Status.DONE)
        return next((name for name in arrived if name not in self.masses), "")

    def take(self, name: str, mass: float) -> None:
        """Take what a box weighs, in kg, once the journal has it."""
        self.masses[name] = mass
        self._last = name

    def colour(self, orders: Mapping[str, Order]) -> str:
        """Return what the lamp shows.

        Red: the last box weighs something else than its order says. Amber: one is on its way, or
        waits to be weighed. Green: the last one was right. Off: none came yet.
        """
        last = orders.get(self._last)
        if last is not None and abs(self.masses[self._last] - last.load) > _TOLERANCE_KG:
            return "red"
        if self.due(orders.values()) or any(
            order.status is Status.LOADED for order in orders.values()
        ):
            return "amber"
        return "green" if self.masses else "off"
