"""The paper's request: resolve, check and open a chain of three, against its one millisecond.

What the interpreter's garbage collector takes depends on what else the process holds, and on what
was done before; the last column is without it.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from pathlib import Path

import uoarm
from bench.tables import at, print_table
from uoarm.config import loads
from uoarm.model import Robot

GOAL = "faceRecognition"
BRIDGE = "{{plugin: python, options: {{path: ['{0}']}}, host: {1}}}"
ROBOT = """
version: 1
bridges: {{one: {0}, two: {0}, three: {0}}}
functions:
  camera:
    components:
      - {{name: eye, bridge: one, output: {{endpoint: ["chain_components:camera"]}}}}
  faceDetection:
    components:
      - name: finder
        bridge: two
        input: {{from: camera, endpoint: ["chain_components:detect"]}}
        output: {{endpoint: ["chain_components:detect"]}}
  faceRecognition:
    components:
      - name: knower
        bridge: three
        input: {{from: faceDetection, endpoint: ["chain_components:recognise"]}}
        output: {{endpoint: ["chain_components:recognise"]}}
"""
OTHERS = 1000
OTHER = """
  other{0}:
    components:
      - name: other{0}
        bridge: three
        input: {{endpoint: ["chain_components:recognise"]}}
        output: {{endpoint: ["chain_components:recognise"]}}
"""


class Collections:
    """The nanoseconds that the garbage collector has taken, in whichever thread."""

    def __init__(self) -> None:
        self.spent = 0
        self._begun = 0
        gc.callbacks.append(self._note)

    def _note(self, phase: str, _: dict[str, int]) -> None:
        now = time.perf_counter_ns()
        if phase == "start":
            self._begun = now
        else:
            self.spent += now - self._begun


COLLECTIONS = Collections()


def main() -> None:
    """Print the table of requests."""
    here, hosted = chain(), chain("true")
    with uoarm.RobotManager(here) as near, uoarm.RobotManager(hosted) as far:
        rows = [
            _row(
                "first request of a new manager (bridges started, structures asked, edges proven)",
                300,
                lambda: _first_request(here),
            ),
            _row("warm resolve", 1000, lambda: _spent(lambda: near.resolve(GOAL))),
            _row(
                "warm request (resolve, open five channels, start the source)",
                300,
                lambda: _request(near),
            ),
            _row("the same, each component in a host of its own", 300, lambda: _request(far)),
        ]
        kept = near.request(GOAL)
        text = "request of what another connection has open"
        rows.append(_row(text, 300, lambda: _request(near)))
        kept.kill()
    with uoarm.RobotManager(chain(others=OTHERS)) as crowded:
        for number in range(OTHERS):
            crowded.request(f"other{number}")
        text = f"warm request beside {OTHERS:,} other connections"
        rows.append(_row(text, 300, lambda: _request(crowded)))
    head = ("a chain of three", "fastest us", "median us", "p99 us", "p99 without collector us")
    print_table("The paper's request", head, rows)


def chain(host: str = "false", others: int = 0) -> Robot:
    """Return the robot; `host` is what its bridges say of theirs, `others` are functions beside."""
    text = ROBOT.format(BRIDGE.format(Path(__file__).parent, host))
    return loads(text + "".join(map(OTHER.format, range(others))))


def _row(name: str, count: int, sample: Callable[[], tuple[float, float]]) -> tuple[str, ...]:
    sample()  # the first one of a manager is another matter, and has a row of its own
    samples = [sample() for _ in range(count)]
    whole, bare = (sorted(column) for column in zip(*samples, strict=True))
    figures = whole[0], at(whole, 0.5), at(whole, 0.99), at(bare, 0.99)
    return (name, *(f"{one:,.0f}" for one in figures))


def _first_request(robot: Robot) -> tuple[float, float]:
    with uoarm.RobotManager(robot) as manager:
        return _request(manager)


def _request(manager: uoarm.RobotManager) -> tuple[float, float]:
    """Return the microseconds of one request, and those without the collector; it is killed."""
    connections: list[uoarm.Connection] = []
    spent = _spent(lambda: connections.append(manager.request(GOAL)))
    connections[0].kill()
    return spent


def _spent(action: Callable[[], object]) -> tuple[float, float]:
    before, begun = COLLECTIONS.spent, time.perf_counter_ns()
    action()
    whole = time.perf_counter_ns() - begun
    return whole / 1000, (whole - (COLLECTIONS.spent - before)) / 1000


if __name__ == "__main__":
    main()
