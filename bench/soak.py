"""A soak of hosts, failover and failback: `python -m bench.soak --minutes 30`.

A chain of two hosted functions, each with two candidates in hosts of their own, delivers to this
process while random hosts are killed, stopped, made to hang, slow or refusing, each at least
once. It must go on behind its handle; at the end every message must be received or counted, as
must each copy that two finders got while one of them took over from the other, and threads,
descriptors and memory be where they were after the first part. Exit code 0 when all of
that held.

A host that dies between two writes leaves one message in doubt, and no other: a source between its
journal and the counter in shared memory, a step between that counter of what it gave and the one of
what it took. Few kills come just there: one message for twenty hosts may be missing, or counted
twice, at most. More is a loss of the accounts: nine in a hundred hosts were one.

Silence and patience are longer on a machine that is slow, so that hosts which only wait for a
processor are not given up. What `--events` writes, a test plays again (`tests/control/field`).
"""

from __future__ import annotations

import gc
import logging
import os
import random
import signal
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import click
from attrs import Factory, define, evolve, frozen

from bench.tables import print_table
from bench.turns import ROOT, resident_megabytes
from uoarm import Connection, RobotManager
from uoarm._host import RemoteBridge
from uoarm.config import loads
from uoarm.model import FailoverPolicy
from uoarm.testing import ResourceSnapshot, copies, losses, slowness

FAULTS = ("kill", "stop", "pause", "hang", "refuse", "slow")
DEADLY = frozenset({"kill", "stop", "hang"})
_MOMENT_SECONDS = 0.25
PATIENCE_SECONDS = 90.0 * slowness()
SILENCE_SECONDS = 0.6 * slowness()
BETWEEN_SECONDS = 1.5
STILL_SECONDS = 2.0 * slowness()
GROWTH_MEGABYTES = 25.0
HOSTS_IN_DOUBT = 20
POLICY = FailoverPolicy(wait=PATIENCE_SECONDS, limit=1_000_000, return_after=0.5)
ROBOT = """
version: 1
bridges: {bridges}
functions:
  numbers:
    components:
      - {{name: first, bridge: one, priority: 2, output: {{endpoint: ["_components:numbers"]}}}}
      - {{name: second, bridge: two, priority: 1, output: {{endpoint: ["_components:numbers"]}}}}
  found:
    components:
      - name: near
        bridge: three
        priority: 2
        input: {{from: numbers, endpoint: ["_components:finder"]}}
        output: {{endpoint: ["_components:finder"]}}
      - name: far
        bridge: four
        priority: 1
        input: {{from: numbers, endpoint: ["_components:finder"]}}
        output: {{endpoint: ["_components:finder"]}}
"""


class Faults:
    """Does random harm to the hosts of a robot, and counts it.

    Args:
        robot: whose hosts are harmed.
        folder: where components look for the harm that they do to themselves.
        seed: of the choice.
    """

    def __init__(self, robot: RobotManager, folder: Path, seed: int) -> None:
        self._robot = robot
        self._folder = folder
        self._random = random.Random(seed)
        self.done: Counter[str] = Counter()
        self._does: dict[str, Callable[[], None]] = {
            "kill": lambda: os.kill(self._random_host(), signal.SIGKILL),
            "stop": lambda: os.kill(self._random_host(), signal.SIGSTOP),
            "pause": self._pause,
            "hang": (folder / "hang").touch,
            "refuse": lambda: self._for_a_moment("refuse"),
            "slow": lambda: self._for_a_moment("slow"),
        }

    @property
    def deaths(self) -> int:
        """How many hosts were meant to die."""
        return sum(count for fault, count in self.done.items() if fault in DEADLY)

    def harm(self, fault: str | None = None) -> None:
        """Do one fault, a random one where none is named; nothing when no host runs."""
        fault = fault or self._random.choice(FAULTS)
        try:
            self._does[fault]()
        except (LookupError, ProcessLookupError):
            return
        self.done[fault] += 1

    def _random_host(self) -> int:
        """Return the process of a random host that runs."""
        bridges = self._robot._bridges._bridges.values()  # noqa: SLF001 - to harm them
        hosts = sorted(
            bridge.process for bridge in tuple(bridges) if isinstance(bridge, RemoteBridge)
        )
        return self._random.choice(hosts)

    def _pause(self) -> None:
        process = self._random_host()
        os.kill(process, signal.SIGSTOP)
        threading.Event().wait(_MOMENT_SECONDS)
        os.kill(process, signal.SIGCONT)

    def _for_a_moment(self, harm: str) -> None:
        file = self._folder / harm
        file.touch()
        threading.Event().wait(_MOMENT_SECONDS)
        file.unlink()


@frozen
class Sample:
    """This process at one moment."""

    memory_megabytes: float
    threads: int
    descriptors: int


@define
class Soak:
    """What a soak has seen."""

    arrived: int = 0
    samples: list[Sample] = Factory(list)

    def take(self, _: object) -> None:
        """Count a message that arrived."""
        self.arrived += 1


@click.command()
@click.option("--minutes", type=click.FloatRange(min=0.05), default=30.0, show_default=True)
@click.option("--deaths", default=0, help="Go on until this many hosts were meant to die.")
@click.option("--seed", default=1, show_default=True, help="Of the choice of faults.")
@click.option("--silence", default=SILENCE_SECONDS, help="Seconds after which a host is given up.")
@click.option(
    "--events",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write the events of the control plane: a test plays them again.",
)
def main(minutes: float, deaths: int, seed: int, silence: float, events: Path | None) -> None:
    """Harm hosts under a connection for some minutes."""
    logging.getLogger("uoarm").setLevel(logging.CRITICAL)  # every fault is logged, in hundreds
    if events is not None:
        _write_events(events)
    with tempfile.TemporaryDirectory(prefix="uoarm-soak-") as folder:
        with RobotManager(evolve(loads(_robot(Path(folder), silence)), failover=POLICY)) as warm:
            warm.request("found", timeout=PATIENCE_SECONDS).get(PATIENCE_SECONDS)
        for left in Path(folder).glob("*.journal"):
            left.unlink()
        before = ResourceSnapshot()
        held = _soak(Path(folder), silence, 60.0 * minutes, deaths, seed)
        before.check()
    sys.exit(0 if held else 1)


def _write_events(path: Path) -> None:
    handler = logging.FileHandler(path, mode="w")
    handler.setFormatter(logging.Formatter("%(message)s"))
    log = logging.getLogger("uoarm.control")
    log.setLevel(logging.DEBUG)
    log.propagate = False
    log.addHandler(handler)


def _robot(folder: Path, silence: float) -> str:
    host = {
        "silence": silence,
        "restarts": 1_000_000,
        "variables": {"UOARM_SOAK": str(folder)},
    }
    one = {"plugin": "python", "host": host, "options": {"path": [str(ROOT / "bench")]}}
    return ROBOT.format(bridges=dict.fromkeys(("one", "two", "three", "four"), one))


def _soak(folder: Path, silence: float, seconds: float, deaths: int, seed: int) -> bool:
    soak = Soak()
    with RobotManager(evolve(loads(_robot(folder, silence)), failover=POLICY)) as robot:
        connection = robot.request("found", on_message=soak.take, timeout=PATIENCE_SECONDS)
        faults = Faults(robot, folder, seed)
        begun = time.monotonic()
        first = list(FAULTS)
        while time.monotonic() - begun < seconds or first or faults.deaths < deaths:
            faults.harm(first.pop(0) if first else None)
            _wait_for_more(soak, connection)
            soak.samples.append(_look())
        (folder / "enough").touch()
        unaccounted = _settle(robot, soak, folder)
        doubt = unaccounted, _processes(folder)
        return _report(robot, connection, soak, faults, doubt)


def _look() -> Sample:
    """Return what this process holds now, after a collection."""
    gc.collect()
    return Sample(
        memory_megabytes=resident_megabytes(),
        threads=threading.active_count(),
        descriptors=sum(1 for _ in Path("/proc/self/fd").iterdir()),
    )


def _wait_for_more(soak: Soak, connection: Connection) -> None:
    """Wait a while, then for messages that came after it.

    Raises:
        TimeoutError: nothing came for a long time.
    """
    pause = threading.Event()
    pause.wait(BETWEEN_SECONDS)
    seen, deadline = soak.arrived, time.monotonic() + PATIENCE_SECONDS
    while soak.arrived < seen + 20:
        if connection.ended or time.monotonic() > deadline:
            raise TimeoutError(f"nothing comes: {connection.status()}")
        pause.wait(0.01)


def _processes(folder: Path) -> int:
    """Return how many hosts there were: more than were meant to die, where silence was taken so."""
    return len({path.stem.rpartition("-")[2] for path in folder.glob("*.journal")})


def _journal(folder: Path, name: str) -> int:
    return sum(path.stat().st_size for path in folder.glob(f"{name}-*.journal"))


def _settle(robot: RobotManager, soak: Soak, folder: Path) -> int:
    """Wait until nothing moves; return how many messages are neither received nor counted."""
    pause = threading.Event()
    deadline = time.monotonic() + PATIENCE_SECONDS
    before, since = None, time.monotonic()
    while True:
        now = time.monotonic()
        status = robot.status()
        counted = soak.arrived + _journal(folder, "refused") + losses(status).total()
        sent = _journal(folder, "begun") - _journal(folder, "undelivered")
        unaccounted = sent + copies(status) - counted
        if (soak.arrived, unaccounted) != before:
            before, since = (soak.arrived, unaccounted), now
        if now > deadline or now - since > (0.0 if unaccounted == 0 else STILL_SECONDS):
            return unaccounted
        pause.wait(0.1)


def _report(
    robot: RobotManager,
    connection: Connection,
    soak: Soak,
    faults: Faults,
    doubt: tuple[int, int],
) -> bool:
    (unaccounted, hosts), gaps = doubt, connection.gaps
    status = robot.status()
    counted = losses(status)
    by_reason = ", ".join(f"{reason} {count}" for reason, count in sorted(counted.items()))
    spans = sorted(gap.seconds for gap in gaps) or [0.0]
    steady = soak.samples[len(soak.samples) // 3 :]
    growth = steady[-1].memory_megabytes - steady[0].memory_megabytes
    rows = [
        ("faults", ", ".join(f"{fault} {count}" for fault, count in faults.done.items())),
        ("changes of plan", f"{len(gaps)}, median gap {1000 * spans[len(spans) // 2]:.0f} ms"),
        ("messages received", f"{soak.arrived:,}"),
        ("messages counted as lost", f"{counted.total():,} ({by_reason})"),
        ("given to two candidates at once", f"{copies(status):,}"),
        ("neither, or counted twice if below 0", f"{unaccounted}, in {hosts} hosts"),
        ("memory, MB", _range([sample.memory_megabytes for sample in soak.samples])),
        ("threads", _range([sample.threads for sample in soak.samples])),
        ("descriptors", _range([sample.descriptors for sample in soak.samples])),
        ("growth after the first third", f"{growth:.1f} MB"),
    ]
    print_table("Soak", ("what", "figures"), rows)
    return abs(unaccounted) <= max(1, hosts // HOSTS_IN_DOUBT) and growth < GROWTH_MEGABYTES


def _range(values: list[float]) -> str:
    return f"{min(values):.0f} to {max(values):.0f}, {values[-1]:.0f} at the end"


if __name__ == "__main__":
    main()
