"""What one message costs inside the manager, on top of the frameworks' own cost."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, TypedDict

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
    ways: dict[str, Sequence[Mapping[str, Any]]] = {
        "one route, direct": [{}],
        **{
            f"one route, checked: {mode.value}": [{"check": make_check(_POSE, mode, "a")}]
            for mode in (ValidationMode.SAMPLED, ValidationMode.ALWAYS)
        },
        "one route with an adapter": [{"transfer": lambda m: {"pose": m["x"]}}],
        "ten routes of one output": [{}] * 10,
    }
    rows = [row("a bare bound call", microseconds(lambda: _nothing(message), batch=100), "floor")]
    for name, routes in ways.items():
        outlet = Outlet()
        outlet.retain(retains=False)  # as most outputs say once they are open
        for number, given in enumerate(routes):
            outlet.attach(Route("a", f"b{number}", _nothing, clock=time.monotonic, **given))
        rows.append(row(name, microseconds(partial(outlet.deliver, message), batch=100)))
    retaining = Outlet()
    retaining.retain(retains=True)
    retaining.attach(Route("a", "b", _nothing, clock=time.monotonic))
    name = "one route of an output that retains"
    rows.append(row(name, microseconds(partial(retaining.deliver, message), batch=100)))
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
