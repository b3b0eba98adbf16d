"""How the manager's work grows with its functions: `python -m bench scale`, or with options.

    python -m bench.scale --sizes 10 100 1000 5000 --json

Each size runs in a process of its own. Of N functions, each with a spare candidate, half have their
first one in a bridge that dies while all of them are open. All is in memory, so that the time is
the manager's own. The exponent of a step says how it grows from one size to the next: 1 with the
functions, 2 with their square.
"""

from __future__ import annotations

import argparse
import itertools
import json
import logging
import math
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from bench.tables import print_table
from uoarm import Connection, RobotManager
from uoarm.config import loads
from uoarm.model import Health
from uoarm.testing import MemoryBridge, wait

_SIZES = (10, 100, 1000, 5000)
_STEPS = ("check", "start", "request", "status", "death", "apply", "close")
_LIMIT_SECONDS = 900.0
_BRIDGES = ("even", "odd", "spare")
_HEAD = (
    f"version: 1\nbridges: {{{', '.join(f'{name}: {{plugin: memory}}' for name in _BRIDGES)}}}\n"
)
_Seconds = dict[str, float]


def main() -> None:
    """Print what each step took at each size, and how it grows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=_SIZES, help="numbers of functions")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--here", type=int, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.here is not None:
        print(json.dumps(measure(given.here)))
        return
    sizes = sorted(set(given.sizes))
    found = {size: _measured_apart(size) for size in sizes}
    growth = exponents(found)
    if given.json:
        print(json.dumps({"seconds": found, "exponents": growth}, indent=2))
        return
    rows = [
        (
            step,
            *(f"{1000 * found[size][step]:,.1f}" for size in sizes),
            *(f"{exponent:.2f}" for exponent in growth[step]),
        )
        for step in _STEPS
    ]
    between = [f"{less:,} to {more:,}" for less, more in itertools.pairwise(sizes)]
    head = ("ms", *(f"{size:,}" for size in sizes), *(f"exponent, {pair}" for pair in between))
    print_table("Steps by the number of functions", head, rows)


def exponents(found: dict[int, _Seconds]) -> dict[str, list[float]]:
    """Return of each step how it grows from each size to the next, as a power of the size."""
    sizes = sorted(found)
    return {
        step: [
            math.log(found[more][step] / found[less][step]) / math.log(more / less)
            for less, more in itertools.pairwise(sizes)
        ]
        for step in _STEPS
    }


def measure(size: int) -> _Seconds:
    """Return how many seconds each step takes with so many functions."""
    logging.getLogger("uoarm").setLevel(logging.CRITICAL)  # a line for each that dies
    spent: _Seconds = {}
    bridges = {name: MemoryBridge(name, {}) for name in _BRIDGES}
    for number in range(size):
        bridges[_first(number)].emitter(f"c{number}", {"type": "integer"})
        bridges["spare"].emitter(f"s{number}", {"type": "integer"})
    text = _HEAD + "functions:\n" + "".join(map(_function, range(size)))

    def timed(step: str, action: Callable[[], object]) -> None:
        start = time.perf_counter()
        action()
        spent[step] = time.perf_counter() - start

    found = []
    timed("check", lambda: found.append(loads(text)))
    managers: list[RobotManager] = []
    timed("start", lambda: managers.append(RobotManager(found[0], bridges=bridges)))
    with managers[0] as manager:
        connections: list[Connection] = []

        def request() -> None:
            connections.extend(manager.request(f"f{number}") for number in range(size))

        def die() -> None:
            bridges["even"].report(Health.LOST, "it was killed")
            for connection in connections[::2]:
                wait(lambda: connection.gaps, timeout=_LIMIT_SECONDS)  # noqa: B023 - at once

        timed("request", request)
        timed("status", manager.status)
        timed("death", die)
        changed = loads(text.replace(f"endpoint: [c{size - 1}]", f"endpoint: [s{size - 1}]", 1))
        timed("apply", lambda: manager.apply(changed, timeout=_LIMIT_SECONDS))
        timed("close", manager.close)
    return spent


def _first(number: int) -> str:
    return "odd" if number % 2 else "even"


def _function(number: int) -> str:
    return (
        f"  f{number}:\n"
        "    components:\n"
        f"      - {{name: c{number}, bridge: {_first(number)}, priority: 1,"
        f" output: {{endpoint: [c{number}]}}}}\n"
        f"      - {{name: s{number}, bridge: spare, output: {{endpoint: [s{number}]}}}}\n"
    )


def _measured_apart(size: int) -> _Seconds:
    done = subprocess.run(
        [sys.executable, "-m", "bench.scale", "--here", str(size)],
        stdout=subprocess.PIPE,
        text=True,
        check=True,
        cwd=Path(__file__).parent.parent,
        timeout=2 * _LIMIT_SECONDS,
    )
    measured: _Seconds = json.loads(done.stdout)
    return measured


if __name__ == "__main__":
    main()
