"""Where the slowest messages between two frameworks waited: in programs, for a processor, or else.

Messages go one at a time, as in `latency.py`, with all bridges in this process, or with `--hosts`
each in its own. Before and after each, the kernel is asked what every thread of this process, of
the hosts and of the loops has had since (Linux, `/proc/*/task/*/schedstat`). So the time of a
message is divided in three:

- programs: time for which threads ran;
- machine: time for which threads could have run and the kernel ran others;
- waiting: the rest, in which no thread could run. Wake-ups of an idle processor are in it, and
  timers.

A thread that waits for the interpreter's lock sleeps, while the one that has it runs: that is in
the time of programs, which then is longer than that of most messages.

"Switches" is how often threads were given a processor for one message, on average.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator, Sequence
from operator import sub
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
_SHARES = (0.5, 0.95, 0.99)
_PARTS = ("programs", "machine", "waiting")


@frozen
class Whole:
    """What one message took, in microseconds.

    Attributes:
        wall: from the application and back to it.
        programs: for which threads ran.
        machine: for which threads could have run.
        switches: how often a thread was given a processor.
    """

    wall: float
    programs: float
    machine: float
    switches: int

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

    def spent(self) -> tuple[int, int, int]:
        """Return the nanoseconds that they ran and could have run, and how often, until now."""
        ran = could = often = 0
        for file in self._files:
            one, other, times = os.pread(file, 100, 0).split()
            ran, could, often = ran + int(one), could + int(other), often + int(times)
        return ran, could, often

    def close(self) -> None:
        """Ask no more."""
        for file in self._files:
            os.close(file)


def wholes(robot: RobotManager, first: str, second: str, count: int) -> Iterator[Whole]:
    """Send messages through two frameworks, each once the one before is back."""
    with robot.request(first) as begin, robot.request(name_of(first, second)) as end:
        threads = Threads([os.getpid(), *children()])
        try:
            for number in range(count + count // 10):
                before = threads.spent()
                begun = time.perf_counter_ns()
                begin.send(message(first, number))
                while end.get(_LIMIT)["data"] != number:
                    pass
                wall = time.perf_counter_ns() - begun
                ran, could, often = map(sub, threads.spent(), before)
                if number >= count // 10:
                    yield Whole(wall / 1e3, ran / 1e3, could / 1e3, often)
        finally:
            threads.close()


def children() -> list[int]:
    """Return the processes that this one has started."""
    listed = (int(path.name) for path in Path("/proc").iterdir() if path.name.isdecimal())
    return [number for number in listed if _parent(number) == os.getpid()]


def _parent(process: int) -> int | None:
    try:
        stat = Path(f"/proc/{process}/stat").read_text()
    except OSError:  # it has ended since it was listed
        return None
    return int(stat.rpartition(")")[2].split()[1])


def row(title: str, taken: Sequence[Whole]) -> tuple[str, ...]:
    """Return what all took and, of the slowest, where."""
    ordered = sorted(taken, key=lambda item: item.wall)
    slow = ordered[-max(1, int(len(ordered) * _SLOWEST)) :]
    most = ordered[len(ordered) // 4 : -len(ordered) // 4]
    cells = [f"{ordered[int(len(ordered) * share)].wall:,.0f}" for share in _SHARES]
    cells.append(f"{sum(whole.switches for whole in ordered) / len(ordered):.1f}")
    for some in (most, slow):
        cells += [
            f"{sum(getattr(whole, part) for whole in some) / len(some):,.0f}" for part in _PARTS
        ]
    return title, *cells


def main() -> None:
    """Print one row for each pair."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=500, help="messages on each way")
    parser.add_argument("--hosts", action="store_true", help="give each bridge a process")
    parser.add_argument("--switch", type=float, default=5.0, help="switch interval, ms")
    options = parser.parse_args()
    sys.setswitchinterval(options.switch / 1000)
    domain = free_domain()
    os.environ |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(domain)}
    before, rows = load(), []
    with NameServer() as names, loop("rtm", names.address), loop("rocos") as rocos:
        text = configuration(names.address, rocos.line, domain, hosted=options.hosts)
        with RobotManager(loads(text)) as robot:
            for name, first in FRAMEWORKS.items():
                for two, second in FRAMEWORKS.items():
                    if name != two:
                        taken = list(wholes(robot, name, two, options.count))
                        rows.append(row(f"{first} to {second}", taken))
    place = "hosts" if options.hosts else "one process"
    print(f"µs, {place}, switch interval {options.switch:g} ms, {machine(before)}\n")
    head = (
        "pair",
        "p50",
        "p95",
        "p99",
        "switches",
        *_PARTS,
        *(f"slowest: {part}" for part in _PARTS),
    )
    table(head, rows)


if __name__ == "__main__":
    main()
