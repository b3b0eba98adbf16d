"""The paper's request: resolve, check and open a chain of three, against its one millisecond."""

from __future__ import annotations

import time
from collections.abc import Callable

import uoarm
from bench.tables import at, microseconds, print_table
from uoarm.config import loads

ROBOT = """
version: 1
bridges: {python: {}}
functions:
  camera:
    components:
      - {name: eye, bridge: python, output: {endpoint: ["bench.chain_components:camera"]}}
  faceDetection:
    components:
      - name: finder
        bridge: python
        input: {from: camera, endpoint: ["bench.chain_components:detect"]}
        output: {endpoint: ["bench.chain_components:detect"]}
  faceRecognition:
    components:
      - name: knower
        bridge: python
        input: {from: faceDetection, endpoint: ["bench.chain_components:recognise"]}
        output: {endpoint: ["bench.chain_components:recognise"]}
"""


def main() -> None:
    """Print the table of requests."""
    robot = loads(ROBOT)

    def first_request() -> float:
        with uoarm.RobotManager(robot) as manager:
            return _spent(lambda: manager.request("faceRecognition").kill)

    cold = sorted(first_request() for _ in range(50))
    with uoarm.RobotManager(robot) as manager:
        resolve = microseconds(lambda: manager.resolve("faceRecognition"))
        opened = []
        for _ in range(300):
            start = time.perf_counter_ns()
            connection = manager.request("faceRecognition")
            opened.append((time.perf_counter_ns() - start) / 1000)
            connection.kill()
        opened.sort()
        kept = manager.request("faceRecognition")
        shared = []
        for _ in range(300):
            start = time.perf_counter_ns()
            connection = manager.request("faceRecognition")
            shared.append((time.perf_counter_ns() - start) / 1000)
            connection.kill()
        shared.sort()
        kept.kill()
    rows = [
        (
            name,
            f"{at(samples, 0.5):,.0f}",
            f"{at(samples, 0.99):,.0f}",
            f"{1000 / at(samples, 0.5):.1f}x",
        )
        for name, samples in (
            (
                "first request of a new manager (bridge started, structures asked, edges proven)",
                cold,
            ),
            ("warm resolve", resolve),
            ("warm request (resolve, open five channels, start the source)", opened),
            ("request of what another connection has open", shared),
        )
    ]
    head = ("a chain of three in one process", "median us", "p99 us", "the paper's 1 ms is")
    print_table("The paper's request", head, rows)


def _spent(action: Callable[[], object]) -> float:
    start = time.perf_counter_ns()
    action()
    return (time.perf_counter_ns() - start) / 1000


if __name__ == "__main__":
    main()
