"""The paper's request: resolve, check and open a chain of three, against its one millisecond.

`python -m bench.request --before FOLDER --rounds 5` measures this state and the one of another
checkout in turns, so that both see the same neighbours. What the interpreter's garbage collector
takes depends on what else the process holds, and on what was done before; the last column is
without it.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path

from bench.tables import at, print_table
from bench.turns import Collections, load, measured_apart, parser, states

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


def main() -> None:
    """Print the table, from the samples of all rounds."""
    asked = parser(__doc__)
    asked.add_argument("--count", type=int, default=300, help="requests in each round")
    given = asked.parse_args()
    found: dict[tuple[str, str], list[tuple[float, float]]] = {}
    for _ in range(given.rounds):
        for state, folder in states(given).items():
            for what, samples in measured_apart(folder, "request", given.count).items():
                found.setdefault((what, state), []).extend(samples)
    rows = []
    for (what, state), samples in sorted(found.items()):
        whole, without = (sorted(column) for column in zip(*samples, strict=True))
        figures = (whole[0], at(whole, 0.1), at(whole, 0.5), at(whole, 0.99), at(without, 0.99))
        rows.append((what, state, *(f"{figure:,.0f}" for figure in figures)))
    head = ("us", "state", "fastest", "decile", "median", "p99", "p99 without collector")
    print_table("The paper's request, a chain of three", head, rows)
    print(load())


def measure(count: int) -> None:
    """Print as JSON the microseconds of each step, and those without the collector."""
    import uoarm  # noqa: PLC0415 - of the state that is measured
    from uoarm.config import loads  # noqa: PLC0415

    collections = Collections()

    def chain(host: str = "false", others: int = 0) -> uoarm.RobotManager:
        text = ROBOT.format(BRIDGE.format(Path(__file__).parent, host))
        return uoarm.RobotManager(loads(text + "".join(map(OTHER.format, range(others)))))

    def spent(action: Callable[[], object]) -> tuple[float, float]:
        collected, begun = collections.spent, time.perf_counter_ns()
        action()
        whole = time.perf_counter_ns() - begun
        return whole / 1000, (whole - (collections.spent - collected)) / 1000

    def requested(manager: uoarm.RobotManager) -> tuple[float, float]:
        connections: list[uoarm.Connection] = []
        took = spent(lambda: connections.append(manager.request(GOAL)))
        connections[0].kill()
        return took

    def first() -> tuple[float, float]:
        with chain() as manager:
            return requested(manager)

    def repeated(sample: Callable[[], tuple[float, float]]) -> list[tuple[float, float]]:
        sample()  # the first one of a manager is another matter, and has a row of its own
        return [sample() for _ in range(count)]

    found = {"first request of a new manager": repeated(first)}
    with chain() as manager:
        found["warm resolve"] = repeated(lambda: spent(lambda: manager.resolve(GOAL)))
        found["warm request"] = repeated(lambda: requested(manager))
        kept = manager.request(GOAL)
        found["request of what is open"] = repeated(lambda: requested(manager))
        kept.kill()
    with chain("true") as manager:
        text = "warm request, each component in a host of its own"
        found[text] = repeated(lambda: requested(manager))
    with chain(others=OTHERS) as manager:
        for number in range(OTHERS):
            manager.request(f"other{number}")
        text = f"warm request beside {OTHERS:,} other connections"
        found[text] = repeated(lambda: requested(manager))
    print(json.dumps(found))


if __name__ == "__main__":
    main()
