"""Faults under commands of 20 Hz: `python -m bench.command_faults --minutes 10`.

A ROS 2 node, an RT-Component and a rocos device, each a process, take commands that a client sends
through a server, whose bridges are in hosts. Again and again one of them is killed or stopped, the
server's interpreter is held by a native call, or everything is stopped on request. What counts is
when each sink took its stop after its last command. Every fault must be followed by a stop at every
sink; exit code 1 where one was not, or where the report of a stop was not what the sinks saw.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import click

from bench._command_parts import FUNCTIONS
from bench.tables import print_table
from uoarm.client import connect

LIFETIME = 0.25
PERIOD = 0.05
PATIENCE = 120.0
WATCHED = 0.3
FAULTS = (
    "client SIGKILL", "client SIGSTOP", "server SIGSTOP", "server GIL hang", "server SIGKILL",
    "stop all",
)  # fmt: skip
WEIGHTS = (5, 5, 4, 4, 1, 4)
ROBOT = """
version: 1
bridges:
  ros2: {{plugin: ros2, host: true}}
  rtm: {{plugin: rtm, options: {{nameserver: "{nameserver}"}}, host: true}}
  rocos: {{plugin: rocos, options: {{devices: {{robot: {{url: "{url}"}}}}}}, host: true}}
functions:
  ros2:
    components:
      - name: node
        bridge: ros2
        input:
          endpoint: [/go, std_msgs/msg/Int64]
          lifetime: {lifetime}
          stop: {{message: {{data: 0}}}}
  rtm:
    components:
      - name: rtc
        bridge: rtm
        input:
          endpoint: [Sink0.rtc, go, "IDL:RTC/TimedLong:1.0"]
          options: {{activate: true}}
          lifetime: {lifetime}
          stop: {{message: {{tm: {{sec: 0, nsec: 0}}, data: 0}}}}
  rocos:
    components:
      - name: device
        bridge: rocos
        input:
          endpoint: [robot, velocity]
          lifetime: {lifetime}
          stop: {{message: {{linear: 0, angular: 0}}}}
"""


class Part:
    """A process, whose output is in a file."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.file = folder / f"{arguments[0]}-{time.monotonic_ns()}"
        with self.file.open("wb") as out:
            command = [sys.executable, "-m", "bench._command_parts", *arguments]
            self.process = subprocess.Popen(command, stdout=out)

    def lines(self) -> list[list[str]]:
        """Return what it wrote, in words; of a line that is being written, nothing."""
        return [line.split() for line in self.file.read_text().splitlines(keepends=True)
                if line.endswith("\n")]  # fmt: skip

    def says(self, word: str) -> str:
        """Wait for a line that begins with a word, and return the next word."""
        until(
            lambda: any(line[0] == word for line in self.lines()), f"{self.file.name} says {word}"
        )
        return next(line[1] for line in self.lines() if line[0] == word)

    def end(self) -> None:
        """Kill it."""
        self.process.kill()
        self.process.wait()


def until(ready: Any, what: str) -> None:
    """Wait, a minute at most."""
    deadline = time.monotonic() + PATIENCE
    while not ready():
        if time.monotonic() > deadline:
            raise TimeoutError(what)
        time.sleep(0.005)


def after_last_command(lines: list[list[str]]) -> float | None:
    """Return the seconds from the last command to the first stop behind it; None: there is none."""
    times = [(float(when), what) for when, what in lines if what in {"go", "stop"}]
    last = max((n for n, (_, what) in enumerate(times) if what == "go"), default=None)
    if last is None or last + 1 == len(times):
        return None
    return times[last + 1][0] - times[last][0]


class World:
    """The sinks, and the server and client of this moment."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        from uoarm_rtm._nameserver import NameServer  # noqa: PLC0415

        self.folder = folder
        nameserver = stack.enter_context(NameServer())
        arguments = {"ros2": (), "rtm": (f"127.0.0.1:{nameserver.port}",), "rocos": ()}
        self.sinks = {name: Part(folder, name, *arguments[name]) for name in FUNCTIONS}
        for one in self.sinks.values():
            stack.callback(one.end)
        text = ROBOT.format(
            nameserver=f"127.0.0.1:{nameserver.port}",
            url=self.sinks["rocos"].says("url"),
            lifetime=LIFETIME,
        )
        (folder / "robot.yaml").write_text(text)
        self.server: Part | None = None
        self.client: Part | None = None
        stack.callback(self.close)

    def begin(self) -> None:
        """Have all sinks commanded."""
        if self.server is None:
            self.server = Part(self.folder, "serve", str(self.folder / "robot.yaml"))
        self.url = f"ws://127.0.0.1:{self.server.says('port')}/"
        self.at = {name: len(one.lines()) for name, one in self.sinks.items()}
        self.client = Part(self.folder, "send", self.url, str(PERIOD))
        until(
            lambda: all(self.goes(name) >= 4 for name in FUNCTIONS),
            f"all sinks are commanded: {self.folder}",
        )

    def seen(self, name: str) -> list[list[str]]:
        """Return what a sink took since `begin`."""
        return self.sinks[name].lines()[self.at[name] :]

    def goes(self, name: str) -> int:
        """Return how many commands a sink took since `begin`."""
        return sum(line[1] == "go" for line in self.seen(name))

    def fail(self, fault: str) -> bool:
        """Do a fault; return whether what was reported of it was true."""
        assert self.server is not None
        assert self.client is not None
        who, _, what = fault.partition(" ")
        process = (self.client if who == "client" else self.server).process
        if who == "stop":
            return asyncio.run(self.stop_all())
        process.send_signal(signal.SIGUSR1 if what == "GIL hang" else getattr(signal, what))
        return True

    async def stop_all(self) -> bool:
        """Stop all while commands go on; whoever is said to have stopped must have, and stay so."""
        async with connect(self.url) as robot:
            report = await robot.stop_all()
            stopped = {one["function"] for one in report["inputs"] if one["stopped"]}
            counts = {name: self.goes(name) for name in FUNCTIONS}
            await asyncio.sleep(WATCHED)
            with contextlib.suppress(OSError):
                assert self.client is not None
                self.client.end()
            await robot.release()
        return all(self.goes(name) == counts[name] for name in stopped) and stopped == set(
            FUNCTIONS
        )

    def settle(self, fault: str) -> None:
        """Put away what the fault left."""
        assert self.server is not None
        if self.client is not None:
            self.client.end()
        if fault == "server SIGKILL":
            self.close()
        else:
            self.server.process.send_signal(signal.SIGCONT)
            until(lambda: all(self.seen(name)[-1][1] == "stop" for name in FUNCTIONS), "settled")

    def close(self) -> None:
        """End the server and the client."""
        for one in (self.client, self.server):
            if one is not None:
                one.end()
        self.client = self.server = None


@click.command()
@click.option("--minutes", default=10.0, show_default=True)
@click.option("--most", default=1000, show_default=True, help="Faults.")
@click.option("--seed", default=0, show_default=True)
def main(minutes: float, most: int, seed: int) -> None:
    """Do faults for a while and print what came of them."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ.setdefault("ROS_DOMAIN_ID", str(64 + os.getpid() % 38))
    chosen, done, missed, untrue = random.Random(seed), Counter[str](), 0, 0
    late: dict[str, list[float]] = {name: [] for name in FUNCTIONS}
    end = time.monotonic() + 60 * minutes
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        world = World(folder, stack)
        while time.monotonic() < end and sum(done.values()) < most:
            (fault,) = chosen.choices(FAULTS, WEIGHTS)
            world.begin()
            time.sleep(chosen.uniform(0, 2 * PERIOD))
            untrue += not world.fail(fault)
            with contextlib.suppress(TimeoutError):
                stopped = lambda: all(  # noqa: E731
                    after_last_command(world.seen(name)) is not None for name in FUNCTIONS
                )
                if fault == "server GIL hang":  # commands go on behind it
                    until(lambda: all(
                        any(line[1] == "stop" for line in world.seen(name)) for name in FUNCTIONS
                    ), "stopped")  # fmt: skip
                else:
                    until(stopped, "stopped")
            done[fault] += 1
            for name in FUNCTIONS:
                gap = first_gap(world.seen(name))
                if gap is None:
                    missed += 1
                elif fault != "stop all":
                    late[name].append(gap - LIFETIME)
            world.settle(fault)
            print(f"{sum(done.values())} {fault} {os.getloadavg()[0]:.1f}", file=sys.stderr)
    rows = [
        [
            name,
            str(len(values)),
            *(f"{1000 * of(values, share):.0f} ms" for share in (0.5, 0.99, 1)),
        ]
        for name, values in late.items()
        if values
    ]
    load = f"load {os.getloadavg()[0]:.0f}"
    print_table(
        f"Stops after the lifetime of {LIFETIME:g} s; {dict(done)}; {load}",
        ["sink", "faults", "median", "p99", "most"],
        rows,
    )
    print(f"missed: {missed}, untrue reports: {untrue}")
    sys.exit(1 if missed or untrue else 0)


def first_gap(lines: list[list[str]]) -> float | None:
    """Return the seconds from the last command before the first stop to that; None: there is none.

    What comes before the first command is a stop of the round before, said again.
    """
    lines = list(itertools.dropwhile(lambda line: line[1] != "go", lines))
    stop = next((n for n, line in enumerate(lines) if line[1] == "stop"), None)
    return None if stop is None else float(lines[stop][0]) - float(lines[stop - 1][0])


def of(values: list[float], share: float) -> float:
    """Return the value below which a share of them is."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


if __name__ == "__main__":
    main()
