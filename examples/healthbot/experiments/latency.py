"""How long each step takes: resolving, requesting, one message through one framework and two.

The paper names one figure, less than 1 ms for each functional process with its dependency check
and the communication between two frameworks. Here one message is on its way at a time, and the
application is in the process of the robot manager.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from attrs import asdict, frozen
from circuits import FRAMEWORKS, configuration, message, name_of
from floors import FLOORS, measure
from stage import free_domain, load, machine, record, table, writable
from uoarm_rtm.nameserver import NameServer

from uoarm import RobotManager
from uoarm._adapt import check_edge, transfer
from uoarm._resolve import Resolver, Structures
from uoarm.config import loads
from uoarm.model import Component, Plan

_LOOPS = Path(__file__).with_name("loops.py")
_LIMIT = 30.0
_PAPER = 0.001
_QUANTILES = ("p50", "p95", "p99", "below 1 ms")
_SHARES = (0.5, 0.95, 0.99)
_CHAINS = {
    "python": "plain Python",
    "rtm_python": "OpenRTM to plain Python",
    "rocos_rtm": "ROCOS profile to OpenRTM",
    "rtm_rocos": "OpenRTM to ROCOS profile",
}


@frozen
class Loop:
    """A loop of another process.

    Attributes:
        line: what it printed.
        process: its id.
    """

    line: str
    process: int


@contextmanager
def loop(*arguments: str) -> Iterator[Loop]:
    """Run a loop of another process."""
    command = [sys.executable, str(_LOOPS), *arguments]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdout is not None
        try:
            yield Loop(process.stdout.readline().strip(), process.pid)
        finally:
            process.communicate(timeout=_LIMIT)


@frozen
class Figure:
    """How long one thing took.

    Attributes:
        title: what it is.
        kind: `floor`, `step`, `alone` or `pair`.
        where: `bare`, `one process` or `hosts`.
        p50: seconds that half of the samples kept to.
        p95: and 95 %.
        p99: and 99 %.
        below: share of the samples that keep to the paper's figure.
    """

    title: str
    kind: str
    where: str
    p50: float
    p95: float
    p99: float
    below: float


def figure(title: str, kind: str, where: str, seconds: list[float]) -> Figure:
    """Return the quantiles of some samples."""
    ordered = sorted(seconds)
    p50, p95, p99 = (ordered[min(len(ordered) - 1, int(len(ordered) * q))] for q in _SHARES)
    below = sum(value < _PAPER for value in ordered) / len(ordered)
    return Figure(title, kind, where, p50, p95, p99, below)


def timed(action: Callable[[], object], count: int) -> list[float]:
    """Return how long each of a number of calls took."""
    taken = []
    for _ in range(count):
        begun = time.perf_counter()
        action()
        taken.append(time.perf_counter() - begun)
    return taken


def round_trips(robot: RobotManager, first: str, second: str, count: int) -> list[float]:
    """Send messages through one framework or two, each once the one before is back."""
    taken = []
    with robot.request(first) as begin, robot.request(name_of(first, second)) as end:
        for number in range(count + count // 10):
            begun = time.perf_counter()
            begin.send(message(first, number))
            while end.get(_LIMIT)["data"] != number:
                pass
            taken.append(time.perf_counter() - begun)
    return taken[count // 10 :]


def requests(robot: RobotManager, name: str, count: int) -> list[float]:
    """Open a function and close it; only the opening is timed."""
    taken = []
    for _ in range(count):
        begun = time.perf_counter()
        way = robot.request(name)
        taken.append(time.perf_counter() - begun)
        way.kill()
    return taken


class Known:
    """The structures that the bridges described for a plan's components."""

    def __init__(self, plan: Plan) -> None:
        self._known = {step.component.name: Structures(step.structures) for step in plan.steps}

    def structures(self, component: Component) -> Structures:
        """Return what was described of a component."""
        return self._known[component.name]


def functional(robot: RobotManager, name: str, where: str, count: int) -> Iterator[Figure]:
    """Measure resolving, requesting and converting for one function."""
    plan = robot.resolve(name)
    known = Known(plan)

    def search() -> None:
        Resolver(robot.config, known, check_edge).resolve(name)

    def took(title: str, seconds: list[float]) -> Figure:
        return figure(f"{_CHAINS[name]}: {title}", "step", where, seconds)

    yield took("resolve, every dependency checked", timed(search, count))
    yield took("resolve again", timed(lambda: robot.resolve(name), count))
    yield took("request, until it is open", requests(robot, name, max(20, count // 20)))
    for edge in plan.edges:
        make = transfer(edge)
        if make is not None:
            sent = message(edge.producer.partition("_")[0], 1)
            yield took("convert a message", timed(partial(make, sent), count))


def hops(robot: RobotManager, where: str, count: int) -> Iterator[Figure]:
    """Measure messages through every framework, and from each to every other."""
    for name, title in FRAMEWORKS.items():
        yield figure(f"{title} alone", "alone", where, round_trips(robot, name, "", count))
    for name, first in FRAMEWORKS.items():
        for two, second in FRAMEWORKS.items():
            if name != two:
                seconds = round_trips(robot, name, two, count)
                yield figure(f"{first} to {second}", "pair", where, seconds)


def floors(count: int) -> Iterator[Figure]:
    """Measure the frameworks without uoarm."""
    for name, title in FLOORS.items():
        yield figure(title, "floor", "bare", measure(name, count))


def shown(figures: Sequence[Figure]) -> Iterator[tuple[str, ...]]:
    """Return rows of a table: what was measured in several places stands in one row."""
    places = list(dict.fromkeys(item.where for item in figures))
    for title in dict.fromkeys(item.title for item in figures):
        cells = [title]
        for where in places:
            found = [item for item in figures if (item.title, item.where) == (title, where)]
            for item in found:
                cells += [f"{value * 1e6:,.1f}" for value in (item.p50, item.p95, item.p99)]
                cells.append(f"{item.below:.0%}")
        yield tuple(cells)


def main() -> None:
    """Measure the floors, then uoarm with its bridges in one process and each in its own."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=500, help="messages on each way")
    parser.add_argument("--record", type=writable, metavar="FILE", help="write the figures as JSON")
    options = parser.parse_args()
    domain = free_domain()
    os.environ |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(domain)}
    before = load()
    figures = list(floors(options.count))
    with NameServer() as names, loop("rtm", names.address) as _, loop("rocos") as device:
        for where, hosted in (("hosts", True), ("one process", False)):
            text = configuration(names.address, device.line, domain, hosted=hosted)
            with RobotManager(loads(text)) as robot:
                figures += hops(robot, where, options.count)
                for name in _CHAINS:
                    figures += functional(robot, name, where, options.count)
    figures.sort(key=lambda item: item.where == "hosts")
    measured = machine(before)
    print(f"Latency in µs, {measured}\n")
    bare = [item for item in figures if item.kind == "floor"]
    table(("without uoarm", *_QUANTILES), list(shown(bare)))
    for kinds, title in ((("step",), "functional process"), (("alone", "pair"), "one message")):
        some = [item for item in figures if item.kind in kinds]
        table(
            (title, *_QUANTILES, *(f"hosts {quantile}" for quantile in _QUANTILES)),
            list(shown(some)),
        )
    if options.record:
        record(options.record, measured, [asdict(item) for item in figures])


if __name__ == "__main__":
    main()
