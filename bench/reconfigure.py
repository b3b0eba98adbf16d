"""Dynamic configuration: discovering, proving what fits, and one change, as the robot grows."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import TypeVar

from bench.tables import at, print_table
from uoarm import RobotManager
from uoarm.config import loads, suggest
from uoarm.model import Robot
from uoarm.testing import MemoryBridge

T = TypeVar("T")
BRIDGES = ("one", "two", "three")
SIZES = (20, 200, 2_000)
CONNECTIONS = 10
CHANGES = 40


def main() -> None:
    """Print the table."""
    rows = [_row(size) for size in SIZES]
    print_table(
        "dynamic configuration: components over three bridges, ten connections that run",
        ("components", "discover ms", "suggest ms", "apply ms", "p99", "apply, one moves", "p99"),
        rows,
    )


def _row(size: int) -> tuple[str, ...]:
    nothing = loads(f"version: 1\nbridges: {_bridges()}\nfunctions: {{}}\n")
    with RobotManager(nothing, bridges=_lab(size)) as robot:
        discover, findings = _timed(robot.discover)
        written, _ = _timed(lambda: suggest(nothing, findings))
    before, other = _robot(size, moved=0), _robot(size, moved=0, last=5)
    moved = _robot(size, moved=9)
    with RobotManager(before, bridges=_lab(size)) as robot:
        for number in range(min(CONNECTIONS, size // 4)):
            robot.request(f"f{number}")
        untouched = sorted(_changes(robot, (other, before)))
        moving = sorted(_changes(robot, (moved, before)))
    times = (
        discover,
        written,
        *(one for each in (untouched, moving) for one in (statistics.median(each), at(each, 0.99))),
    )
    return (f"{size:,}", *(f"{1000 * one:,.1f}" for one in times))


def _changes(robot: RobotManager, configurations: tuple[Robot, Robot]) -> list[float]:
    wanted = (configurations[number % 2] for number in range(CHANGES))
    return [_timed(partial(robot.apply, one))[0] for one in wanted]


def _timed(act: Callable[[], T]) -> tuple[float, T]:
    start = time.perf_counter()
    done = act()
    return time.perf_counter() - start, done


def _lab(size: int) -> Mapping[str, MemoryBridge]:
    bridges = {name: MemoryBridge(name, {}) for name in BRIDGES}
    for number in range(size):
        schema = {"type": "object", "properties": {f"v{number % 50}": {"type": "integer"}}}
        bridge = bridges[BRIDGES[number % len(BRIDGES)]]
        if number % 2:
            bridge.loop(f"c{number}", schema)
        else:
            bridge.emitter(f"c{number}", schema)
    return bridges


def _bridges() -> str:
    return "{" + ", ".join(f"{name}: {{plugin: memory}}" for name in BRIDGES) + "}"


def _robot(size: int, *, moved: int, last: int = 0) -> Robot:
    """Return functions of two emitters; `moved` is the priority of the second of the first."""
    lines = ["version: 1", f"bridges: {_bridges()}", "functions:"]
    for number in range(size // 4):
        first, second = 4 * number, 4 * number + 2
        priority = moved if number == 0 else last if number == size // 4 - 1 else 0
        lines += [f"  f{number}:", "    components:"]
        for component, rank in ((first, 1), (second, priority)):
            bridge = BRIDGES[component % len(BRIDGES)]
            port = f"output: {{endpoint: [c{component}]}}"
            head = f"name: c{component}, bridge: {bridge}, priority: {rank}"
            lines.append(f"      - {{{head}, {port}}}")
    return loads("\n".join(lines))


if __name__ == "__main__":
    main()
