"""Dynamic configuration: discovering, proving what fits, and one change, as the robot grows.

Times pass on a clock; processor time is what this process needed, whatever else the machine does.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from bench.tables import at, print_table
from uoarm import RobotManager
from uoarm.config import loads, suggest
from uoarm.model import Robot
from uoarm.testing import MemoryBridge

BRIDGES = ("one", "two", "three")
SIZES = (20, 200, 500, 1_000, 2_000, 4_000)
CONNECTIONS = 10
CHANGES = 40
LOOKS = 9


def main() -> None:
    """Print the tables."""
    rows, processor = zip(*map(_rows, SIZES), strict=True)
    print_table(
        "dynamic configuration: components over three bridges, ten connections that run",
        ("components", "discover ms", "suggest ms", "apply ms", "p99", "apply, one moves", "p99"),
        rows,
    )
    print_table(
        "the same in milliseconds of processor time, medians",
        ("components", "discover", "apply", "apply, one moves"),
        processor,
    )


def _rows(size: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    nothing = loads(f"version: 1\nbridges: {_bridges()}\nfunctions: {{}}\n")
    with RobotManager(nothing, bridges=_lab(size)) as robot:
        findings = robot.discover()
        looks = [_timed(robot.discover) for _ in range(LOOKS)]
        written, _ = _timed(lambda: suggest(nothing, findings))
    before, other = _robot(size, moved=0), _robot(size, moved=0, last=5)
    moved = _robot(size, moved=9)
    with RobotManager(before, bridges=_lab(size)) as robot:
        for number in range(min(CONNECTIONS, size // 4)):
            robot.request(f"f{number}")
        untouched = _changes(robot, (other, before))
        moving = _changes(robot, (moved, before))
    discover, processor = _medians(looks)
    times = [discover, written]
    used = [processor]
    for each in (untouched, moving):
        passed, processor = _medians(each)
        times += (passed, at(sorted(one for one, _ in each), 0.99))
        used.append(processor)
    return _row(size, times), _row(size, used)


def _row(size: int, seconds: Sequence[float]) -> tuple[str, ...]:
    return (f"{size:,}", *(f"{1000 * one:,.1f}" for one in seconds))


def _medians(each: Sequence[tuple[float, float]]) -> tuple[float, float]:
    passed, used = zip(*each, strict=True)
    return statistics.median(passed), statistics.median(used)


def _changes(robot: RobotManager, configurations: tuple[Robot, Robot]) -> list[tuple[float, float]]:
    wanted = (configurations[number % 2] for number in range(CHANGES))
    return [_timed(partial(robot.apply, one)) for one in wanted]


def _timed(act: Callable[[], object]) -> tuple[float, float]:
    """Return how many seconds passed, and how many of the processor were used."""
    start, before = time.perf_counter(), time.process_time()
    act()
    return time.perf_counter() - start, time.process_time() - before


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
