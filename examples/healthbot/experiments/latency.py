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
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from circuits import FRAMEWORKS, configuration, message, name_of
from stage import free_domain, head, table
from uoarm_rtm.nameserver import NameServer

from uoarm import RobotManager, UoarmError
from uoarm.adapt import check_edge, transfer
from uoarm.config import loads
from uoarm.model import Component, Plan
from uoarm.resolve import Resolver, Structures

_LOOPS = Path(__file__).with_name("loops.py")
_LIMIT = 30.0
_PAPER = 0.001
_HEAD = ("", "p50", "p95", "p99", "below 1 ms")


@contextmanager
def loop(*arguments: str) -> Iterator[str]:
    """Run a loop of another process; yields the line that it prints."""
    command = [sys.executable, str(_LOOPS), *arguments]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdout is not None
        try:
            yield process.stdout.readline().strip()
        finally:
            process.communicate(timeout=_LIMIT)


def row(title: str, seconds: list[float]) -> tuple[str, ...]:
    """Return quantiles in microseconds, and how many of the samples keep to the paper's figure."""
    ordered = sorted(seconds)
    quantiles = [ordered[min(len(ordered) - 1, int(len(ordered) * q))] for q in (0.5, 0.95, 0.99)]
    below = sum(each < _PAPER for each in ordered) / len(ordered)
    return title, *(f"{each * 1e6:,.1f} µs" for each in quantiles), f"{below:.0%}"


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
    """The structures that the bridges told of a plan's components."""

    def __init__(self, plan: Plan) -> None:
        self._known = {step.component.name: Structures(step.structures) for step in plan.steps}

    def structures(self, component: Component) -> Structures:
        """Return what was told of a component."""
        return self._known[component.name]


def functional(robot: RobotManager, name: str, count: int) -> Iterator[tuple[str, ...]]:
    """Measure resolving, requesting and converting for one function."""
    plan = robot.resolve(name)
    known = Known(plan)

    def search() -> None:
        Resolver(robot.robot, known, check_edge).resolve(name)

    yield row(f"{name}: resolve, every dependency checked", timed(search, count))
    yield row(f"{name}: resolve again", timed(lambda: robot.resolve(name), count))
    yield row(f"{name}: request, until it is open", requests(robot, name, max(20, count // 20)))
    for edge in plan.edges:
        make = transfer(edge)
        if make is not None:
            sent = message(edge.producer.partition("_")[0], 1)
            yield row(f"{name}: convert a message", timed(lambda m=make, s=sent: m(s), count))  # type: ignore[misc]  # mypy cannot infer a lambda's default


def measure(robot: RobotManager, count: int) -> None:
    """Print the tables of one robot."""
    names = ("python", "rtm_python", "rocos_rtm", "rtm_rocos")
    table(_HEAD, [line for name in names for line in functional(robot, name, count)])
    ways = [(first, "") for first in FRAMEWORKS]
    ways += [(one, two) for one in FRAMEWORKS for two in FRAMEWORKS if one != two]
    trips = []
    for one, two in ways:
        title = f"{FRAMEWORKS[one]} to {FRAMEWORKS[two]}" if two else f"{FRAMEWORKS[one]} alone"
        try:
            trips.append(row(title, round_trips(robot, one, two, count)))
        except UoarmError as error:
            trips.append((title, str(error).splitlines()[0], "", "", ""))
    table(_HEAD, trips)


def main() -> None:
    """Measure with the bridges in one process, or each in its own."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=500, help="messages on each way")
    parser.add_argument("--hosted", action="store_true", help="each bridge in its own process")
    options = parser.parse_args()
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    domain = free_domain()
    with NameServer() as names, loop("rtm", names.address), loop("rocos") as device:
        text = configuration(names.address, device, domain, hosted=options.hosted)
        with RobotManager(loads(text)) as robot:
            head("Latency, each bridge in its own process" if options.hosted else "Latency")
            measure(robot, options.count)


if __name__ == "__main__":
    main()
