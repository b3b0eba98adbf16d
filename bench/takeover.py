"""From a provider's death to the first message of the one that takes over, in one process."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from queue import SimpleQueue
from typing import Any

import uoarm
from bench.tables import print_table, row
from bench.turns import load
from uoarm.config import loads
from uoarm.testing import Emitter, MemoryBridge

DEATHS = 200
ROBOT = """
version: 1
bridges: {one: {plugin: memory}, two: {plugin: memory}}
functions:
  camera:
    components:
      - {name: best, bridge: one, priority: 2, output: {endpoint: [best]}}
      - {name: spare, bridge: two, priority: 1, output: {endpoint: [spare]}}
  finder:
    components:
      - {name: finder, bridge: two, input: {from: camera, endpoint: [finder]},
         output: {endpoint: [finder]}}
  name:
    components:
      - {name: namer, bridge: two, input: {from: finder, endpoint: [namer]},
         output: {endpoint: [namer]}}
"""


@contextmanager
def chain() -> Iterator[tuple[uoarm.RobotManager, MemoryBridge, Emitter, Emitter]]:
    """Run a chain of three; gives the bridge of its best source, the source, and the spare."""
    number: Any = {"type": "integer"}
    one, two = MemoryBridge("one"), MemoryBridge("two")
    best, spare = one.emitter("best", number), two.emitter("spare", number)
    two.loop("finder", number)
    two.loop("namer", number)
    with uoarm.RobotManager(loads(ROBOT), bridges={"one": one, "two": two}) as robot:
        yield robot, one, best, spare


def main() -> None:
    """Print the table of takeovers."""
    rows = []
    for name, function in (("the source itself", "camera"), ("the source of a chain", "name")):
        rows.append(row(name, [1000 * _takeover(function) for _ in range(DEATHS)], digits=2)[:3])
    head = ("what the application receives", "median ms", "p99 ms")
    print_table("Death to the first message of a spare that runs", head, rows)
    print(load())


def _takeover(function: str) -> float:
    """Let the camera die while a spare emits without a pause; return the seconds of silence."""
    reports: SimpleQueue[float] = SimpleQueue()

    def take(number: int) -> None:
        if number > 0:
            reports.put(time.perf_counter())

    with chain() as (robot, one, best, spare):
        robot.request(function, on_message=take)
        best.emit(0)
        over = threading.Event()
        emitting = threading.Thread(target=_emit, args=(spare, over))
        emitting.start()
        begun = time.perf_counter()
        one.die("best")
        seconds = reports.get(timeout=60) - begun
        over.set()
        emitting.join()
    return seconds


def _emit(spare: Emitter, over: threading.Event) -> None:
    for number in itertools.count(1):
        spare.emit(number)
        if over.wait(0.0005):
            return


if __name__ == "__main__":
    main()
