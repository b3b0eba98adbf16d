"""The warm request in turns with another state of uoarm, so that both see the same neighbours.

`python -m bench.request_turns FOLDER`: FOLDER is a checkout of the other state, whose `src` is
used with this folder's benchmark; without it only this state is measured.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from bench.request import GOAL, chain
from bench.tables import at, print_table

T = TypeVar("T")

HERE = Path(__file__).parents[1]
_WARM_UP = 20


def main() -> None:
    """Print the table, from the samples of all rounds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", help="a checkout of the other state")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--count", type=int, default=400, help="requests in each round")
    asked = parser.parse_args()
    other, rounds, count = asked.folder, asked.rounds, asked.count
    states = {"now": HERE, **({"before": Path(other)} if other else {})}
    found: dict[tuple[str, str], list[list[float]]] = {}
    loads = []
    for _ in range(rounds):
        for state, folder in states.items():
            path = os.pathsep.join((str(folder / "src"), str(HERE)))
            script = f"from bench.request_turns import measure; measure({count})"
            done = subprocess.run(
                [sys.executable, "-c", script],
                env={**os.environ, "PYTHONPATH": path},
                stdout=subprocess.PIPE,
                check=True,
                timeout=600,
            )
            for what, samples in json.loads(done.stdout).items():
                found.setdefault((what, state), []).append(samples)
            loads.append(os.getloadavg()[0])
    rows = []
    for (what, state), each in sorted(found.items()):
        every = sorted(sample for samples in each for sample in samples)
        figures = (every[0], at(every, 0.1), at(every, 0.5), at(every, 0.99))
        rows.append((what, state, *(f"{one:,.0f}" for one in figures)))
    head = ("us", "state", "fastest", "first decile", "median", "p99")
    print_table(f"{rounds} rounds of {count} in turns", head, rows)
    print(f"load {min(loads):.1f} to {max(loads):.1f}")


def measure(count: int) -> None:
    """Print as JSON what requests of the state that is imported take, in microseconds."""
    import uoarm  # noqa: PLC0415 - of the state that is measured

    with uoarm.RobotManager(chain()) as robot:
        for _ in range(_WARM_UP):
            robot.request(GOAL).kill()
        found: dict[str, list[float]] = {"request": [], "its processor time": [], "its kill": []}
        for _ in range(count):
            cpu = time.process_time_ns()
            spent, connection = _timed(lambda: robot.request(GOAL))
            found["its processor time"].append((time.process_time_ns() - cpu) / 1000)
            found["request"].append(spent)
            found["its kill"].append(_timed(connection.kill)[0])
        kept, shared = robot.request(GOAL), []
        for _ in range(count):
            spent, connection = _timed(lambda: robot.request(GOAL))
            shared.append(spent)
            connection.kill()
        kept.kill()
    first = []
    for _ in range(max(1, count // 10)):
        with uoarm.RobotManager(chain()) as robot:
            first.append(_timed(lambda: robot.request(GOAL))[0])
    print(json.dumps({**found, "of what is open": shared, "first of a manager": first}))


def _timed(action: Callable[[], T]) -> tuple[float, T]:
    begun = time.perf_counter_ns()
    result = action()
    return (time.perf_counter_ns() - begun) / 1000, result


if __name__ == "__main__":
    main()
