"""From a provider's death to the first message of the one that takes over, in one process."""

from __future__ import annotations

import itertools
import os
import threading
import time
from queue import SimpleQueue
from typing import Any

import uoarm
from bench.tables import at, print_table
from uoarm.config import loads
from uoarm.testing import MemoryBridge

DEATHS = 200
NUMBER: Any = {"type": "integer"}
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


def main() -> None:
    """Print the table of takeovers."""
    rows = []
    for name, function in (("the source itself", "camera"), ("the source of a chain", "name")):
        found = sorted(1000 * _takeover(function) for _ in range(DEATHS))
        rows.append((name, f"{at(found, 0.5):.2f}", f"{at(found, 0.99):.2f}"))
    head = ("what the application receives", "median ms", "p99 ms")
    print_table("Death to the first message of a spare that runs", head, rows)
    print(f"load {os.getloadavg()[0]:.1f}")


def _takeover(function: str) -> float:
    """Let the camera die while a spare emits without a pause; return the seconds of silence."""
    one, two = MemoryBridge("one"), MemoryBridge("two")
    best, spare = one.emitter("best", NUMBER), two.emitter("spare", NUMBER)
    two.loop("finder", NUMBER)
    two.loop("namer", NUMBER)
    reports: SimpleQueue[float] = SimpleQueue()

    def take(number: int) -> None:
        if number > 0:
            reports.put(time.perf_counter())

    with uoarm.RobotManager(loads(ROBOT), bridges={"one": one, "two": two}) as robot:
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


def _emit(spare: Any, over: threading.Event) -> None:
    for number in itertools.count(1):
        spare.emit(number)
        if over.wait(0.0005):
            return


if __name__ == "__main__":
    main()
