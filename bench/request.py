"""The paper's request: resolve, check and open a chain of three, against its one millisecond."""

from __future__ import annotations

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


def main() -> None:
    """Print the table of requests."""
    here, hosted = chain(), chain("true")
    with uoarm.RobotManager(here) as near, uoarm.RobotManager(hosted) as far:
        rows = [
            _row(
                "first request of a new manager (bridges started, structures asked, edges proven)",
                50,
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
    head = ("a chain of three", "fastest us", "median us", "p99 us", "the paper's 1 ms is")
    print_table("The paper's request", head, rows)


def chain(host: str = "false") -> Robot:
    """Return the robot; `host` is what its bridges say of theirs."""
    return loads(ROBOT.format(BRIDGE.format(Path(__file__).parent, host)))


def _row(name: str, count: int, sample: Callable[[], float]) -> tuple[str, ...]:
    sample()  # the first one of a manager is another matter, and has a row of its own
    found = sorted(sample() for _ in range(count))
    median = at(found, 0.5)
    return (
        name,
        *(f"{one:,.0f}" for one in (found[0], median, at(found, 0.99))),
        f"{1000 / median:.1f}x",
    )


def _first_request(robot: Robot) -> float:
    with uoarm.RobotManager(robot) as manager:
        return _request(manager)


def _request(manager: uoarm.RobotManager) -> float:
    """Return the microseconds of one request; it is killed after."""
    begun = time.perf_counter_ns()
    connection = manager.request(GOAL)
    spent = (time.perf_counter_ns() - begun) / 1000
    connection.kill()
    return spent


def _spent(action: Callable[[], object]) -> float:
    begun = time.perf_counter_ns()
    action()
    return (time.perf_counter_ns() - begun) / 1000


if __name__ == "__main__":
    main()
