"""What one message costs inside the manager, on top of the frameworks' own cost."""

from __future__ import annotations

import threading
import time
from functools import partial
from typing import TypedDict

from bench.tables import microseconds, print_table, row
from uoarm._dataplane import Outlet, Route, make_check
from uoarm.local import schema_of
from uoarm.model import Message, MessageStructure, OverflowPolicy, QueuePolicy, ValidationMode


class _Header(TypedDict):
    stamp: float
    frame_id: str


class _Pose(TypedDict):
    header: _Header
    x: float
    y: float


_POSE = MessageStructure(schema_of(_Pose))


def main() -> None:
    """Print the table of hops."""
    message = {"header": {"stamp": 1.0, "frame_id": "base"}, "x": 1.0, "y": 2.0}
    rows = [row("a bare bound call", microseconds(lambda: _nothing(message), batch=100), "floor")]

    direct = Outlet()
    direct.attach(Route("a", "b", _nothing, clock=time.monotonic))
    rows.append(row("one route, direct", microseconds(lambda: direct.deliver(message), batch=100)))

    for mode in (ValidationMode.SAMPLED, ValidationMode.ALWAYS):
        checked = Outlet()
        check = make_check(_POSE, mode, "a")
        checked.attach(Route("a", "b", _nothing, clock=time.monotonic, check=check))
        samples = microseconds(partial(checked.deliver, message), batch=100)
        rows.append(row(f"one route, checked: {mode.value}", samples))

    adapted = Outlet()
    adapted.attach(
        Route("a", "b", _nothing, clock=time.monotonic, transfer=lambda m: {"pose": m["x"]})
    )
    rows.append(
        row("one route with an adapter", microseconds(lambda: adapted.deliver(message), batch=100))
    )

    fan = Outlet()
    for number in range(10):
        fan.attach(Route("a", f"b{number}", _nothing, clock=time.monotonic))
    rows.append(
        row("ten routes of one output", microseconds(lambda: fan.deliver(message), batch=20))
    )

    rows.append(row("through a queue to its worker", _through_a_queue(message), "one at a time"))
    print_table("One route hop (us)", ("what", "median", "p99", ""), rows)


def _nothing(message: Message) -> None:
    """Take a message and do nothing."""


def _through_a_queue(message: Message) -> list[float]:
    arrived = threading.Semaphore(0)
    policy = QueuePolicy(8, OverflowPolicy.BLOCK)
    route = Route("a", "b", lambda _: arrived.release(), clock=time.monotonic, queue=policy)

    def once() -> None:
        route.deliver(message)
        arrived.acquire()

    try:
        return microseconds(once)
    finally:
        route.close()


if __name__ == "__main__":
    main()
