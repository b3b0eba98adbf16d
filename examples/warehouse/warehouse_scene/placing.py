"""Places orders as any client does, and follows them until they are done."""

from __future__ import annotations

import asyncio
import itertools
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from warehouse_floor.layout import SHELVES

from uoarm.client import connect
from uoarm.errors import UoarmError

__all__ = ["orders", "place_and_wait"]


def orders(name: str, heavy: float = 30.0) -> Iterator[dict[str, Any]]:
    """Yield orders without an end: from every shelf, every second one of so many kg."""
    for number, source in enumerate(itertools.cycle(SHELVES), 1):
        load = 5.0 if number % 2 else heavy
        yield {"order": f"{name}{number}", "source": source, "target": "", "load": load}


async def place_and_wait(
    url: str, count: int, limit: float, report: Callable[[str], None], *, heavy: float = 30.0
) -> bool:
    """Place orders and return whether all of them are done, and weighed, in time.

    Args:
        url: of the robot.
        count: how many.
        limit: seconds.
        report: called with each change of an order.
        heavy: kg of every second box.
    """
    wanted = list(itertools.islice(orders(f"{int(time.time())}-", heavy), count))
    work = _follow(url, wanted, report)
    try:
        await asyncio.wait_for(work, limit if limit < float("inf") else None)
    except asyncio.TimeoutError:
        report(f"not done within {limit:g} s")
        return False
    except UoarmError as error:
        report(f"it had to end: {error}")
        return False
    return True


async def _follow(
    url: str, wanted: Sequence[dict[str, Any]], report: Callable[[str], None]
) -> None:
    begun = time.monotonic()
    reports: dict[str, str] = {}
    async with connect(url) as robot:
        pictures = await robot.request("floor")
        for order in wanted:
            await robot.call("transport", order)
        async for picture in pictures:
            for order in picture["orders"]:
                now = f"{order['status']} {order['vehicle']}".strip()
                if reports.get(order["order"]) != now:
                    reports[order["order"]] = now
                    seconds = time.monotonic() - begun
                    report(f"{seconds:6.1f} s  {order['order']}: {now} {order['why']}".rstrip())
            if picture["done"] >= len(wanted) and picture["lamp"] != "amber":  # all are weighed
                return
