"""The paper's request: resolve, check and open a chain of three, against its one millisecond.

`python -m bench.request --before FOLDER --rounds 5` measures this state and the one of another
checkout in turns, so that both see the same neighbours. What the interpreter's garbage collector
takes depends on what else the process holds, and on what was done before; the last column is
without it.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from bench.tables import at, print_table

HERE = Path(__file__).parents[1]
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
_LIMIT_SECONDS = 600
Samples = dict[str, list[tuple[float, float]]]


class Collections:
    """The nanoseconds that the garbage collector has taken, in whichever thread."""

    def __init__(self, clock: Callable[[], int] = time.perf_counter_ns) -> None:
        self.spent = 0
        self._clock = clock
        self._begun = 0
        gc.callbacks.append(self._note)

    def _note(self, phase: str, _: dict[str, int]) -> None:
        now = self._clock()
        if phase == "start":
            self._begun = now
        else:
            self.spent += now - self._begun


def main() -> None:
    """Print the table, from the samples of all rounds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--before", type=Path, help="a checkout of another state")
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--count", type=int, default=300, help="requests in each round")
    given = parser.parse_args()
    states = {"now": HERE, **({"before": given.before.resolve()} if given.before else {})}
    found: dict[tuple[str, str], list[tuple[float, float]]] = {}
    loads = []
    for _ in range(given.rounds):
        for state, folder in states.items():
            for what, samples in _measured_apart(folder, given.count).items():
                found.setdefault((what, state), []).extend(samples)
            loads.append(os.getloadavg()[0])
    rows = []
    for (what, state), samples in sorted(found.items()):
        whole, without = (sorted(column) for column in zip(*samples, strict=True))
        figures = (whole[0], at(whole, 0.1), at(whole, 0.5), at(whole, 0.99), at(without, 0.99))
        rows.append((what, state, *(f"{figure:,.0f}" for figure in figures)))
    head = ("us", "state", "fastest", "decile", "median", "p99", "p99 without collector")
    print_table("The paper's request, a chain of three", head, rows)
    print(f"load {min(loads):.1f} to {max(loads):.1f}")


def _measured_apart(checkout: Path, count: int) -> Samples:
    """Return what the uoarm of a checkout takes, in a process of its own."""
    path = os.pathsep.join((str(checkout / "src"), str(HERE)))
    done = subprocess.run(
        [sys.executable, "-c", f"from bench.request import measure; measure({count})"],
        env={**os.environ, "PYTHONPATH": path},
        stdout=subprocess.PIPE,
        check=True,
        timeout=_LIMIT_SECONDS,
    )
    samples: Samples = json.loads(done.stdout)
    return samples


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
