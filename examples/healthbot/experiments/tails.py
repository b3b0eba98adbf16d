"""Where the slowest messages between two frameworks waited: in programs, for a processor, or else.

Messages go one at a time, as in `latency.py`, with all bridges in this process. Before and after
each, the kernel is asked what every thread of this process and of the loops has had since (Linux,
`/proc/*/task/*/schedstat`). So the time of a message is divided in three:

- programs: time for which threads ran;
- machine: time for which threads could have run and the kernel ran others;
- waiting: the rest, in which no thread could run. Wake-ups of an idle processor are in it, and
  timers.

A thread that waits for the interpreter's lock sleeps, while the one that has it runs: that is in
the time of programs, which then is longer than that of most messages.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from attrs import frozen
from circuits import FRAMEWORKS, configuration, message, name_of
from latency import loop
from stage import free_domain, load, machine, table
from uoarm_rtm.nameserver import NameServer

from uoarm import RobotManager
from uoarm.config import loads

_LIMIT = 30.0
_SLOWEST = 0.01
_PARTS = ("programs", "machine", "waiting")


@frozen
class Whole:
    """What one message took, in microseconds.

    Attributes:
        wall: from the application and back to it.
        programs: for which threads ran.
        machine: for which threads could have run.
    """

    wall: float
    programs: float
    machine: float

    @property
    def waiting(self) -> float:
        """Microseconds in which no thread could run."""
        return max(0.0, self.wall - self.programs - self.machine)


class Threads:
    """All threads that some processes have now.

    Args:
        processes: their ids.
    """

    def __init__(self, processes: Sequence[int]) -> None:
        self._files = [
            os.open(path / "schedstat", os.O_RDONLY)
            for process in processes
            for path in Path(f"/proc/{process}/task").iterdir()
        ]

    def spent(self) -> tuple[int, int]:
        """Return the nanoseconds that they ran, and that they could have run, since they began."""
        ran = could = 0
        for file in self._files:
            one, other, _ = os.pread(file, 100, 0).split()
            ran, could = ran + int(one), could + int(other)
        return ran, could

    def close(self) -> None:
        """Ask no more."""
        for file in self._files:
            os.close(file)


def wholes(
    robot: RobotManager, first: str, second: str, processes: Sequence[int], count: int
) -> Iterator[Whole]:
    """Send messages through two frameworks, each once the one before is back."""
    with robot.request(first) as begin, robot.request(name_of(first, second)) as end:
        threads = Threads(processes)
        try:
            for number in range(count + count // 10):
                ran, could = threads.spent()
                begun = time.perf_counter_ns()
                begin.send(message(first, number))
                while end.get(_LIMIT)["data"] != number:
                    pass
                wall = time.perf_counter_ns() - begun
                ran_now, could_now = threads.spent()
                if number >= count // 10:
                    yield Whole(wall / 1e3, (ran_now - ran) / 1e3, (could_now - could) / 1e3)
        finally:
            threads.close()


def row(title: str, taken: Sequence[Whole]) -> tuple[str, ...]:
    """Return what all took and, of the slowest, where."""
    ordered = sorted(taken, key=lambda one: one.wall)
    slow = ordered[-max(1, int(len(ordered) * _SLOWEST)) :]
    most = ordered[len(ordered) // 4 : -len(ordered) // 4]
    cells = [f"{ordered[len(ordered) // 2].wall:,.0f}", f"{slow[0].wall:,.0f}"]
    for some in (most, slow):
        cells += [f"{sum(getattr(one, part) for one in some) / len(some):,.0f}" for part in _PARTS]
    return title, *cells


def main() -> None:
    """Print one row for each pair."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=500, help="messages on each way")
    parser.add_argument("--switch", type=float, default=5.0, help="switch interval, ms")
    options = parser.parse_args()
    sys.setswitchinterval(options.switch / 1000)
    domain = free_domain()
    os.environ |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(domain)}
    before, rows = load(), []
    with NameServer() as names, loop("rtm", names.address) as rtm, loop("rocos") as rocos:
        processes = [os.getpid(), rtm.process, rocos.process]
        text = configuration(names.address, rocos.line, domain, hosted=False)
        with RobotManager(loads(text)) as robot:
            for one, first in FRAMEWORKS.items():
                for two, second in FRAMEWORKS.items():
                    if one != two:
                        taken = list(wholes(robot, one, two, processes, options.count))
                        rows.append(row(f"{first} to {second}", taken))
    print(f"µs, switch interval {options.switch:g} ms, {machine(before)}\n")
    head = ("pair", "p50", "p99", *_PARTS, *(f"slowest: {one}" for one in _PARTS))
    table(head, rows)


if __name__ == "__main__":
    main()
