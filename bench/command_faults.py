"""Faults under commands of 20 Hz: `python -m bench.command_faults --minutes 10`.

Two ROS 2 nodes, an RT-Component, a rocos device and a subscriber of MQTT, each a process, take
commands that a client sends through a server whose bridges are in hosts, one of them on another
machine. Again and again the client, the server, a host or the broker is killed or stopped, the
server's interpreter is held by a native call, the link of the client or of the other machine is cut
or stalled, or everything is stopped on request. What counts is when each sink that the fault
concerns took its stop after its last command, and whether reports of stops are what sinks saw.

A host that is killed sends nothing more: what its framework then tells the sink, and after which
time, is a table of its own. Exit code 1 where a stop was missing or a report untrue.
"""

from __future__ import annotations

import asyncio
import os
import random
import signal
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from pathlib import Path

import click

from bench._command_parts import FUNCTIONS
from bench._command_world import LIFETIME, PERIOD, Line, World, until
from bench.tables import print_table
from uoarm.client import connect

WATCHED = 0.3
STANDS = 1.0
SURELY = 60.0
QUIET = 0.005
HOSTED = ("ros2", "rtm", "rocos", "mqtt")
WEIGHTS = {
    "client SIGKILL": 5, "client SIGSTOP": 5, "client link cut": 5, "client link stalled": 5,
    "server SIGSTOP": 4, "server GIL hang": 4, "server SIGKILL": 1,
    "machine link cut": 3, "machine link stalled": 5,
    "host SIGSTOP": 4, "host SIGKILL": 3, "broker SIGKILL": 2,
    "stop all": 4, "stop all, host stands": 3,
}  # fmt: skip


class Faults:
    """Does faults, and notes what came of them.

    Attributes:
        done: how often each was.
        late: seconds by which the first stop came later than the lifetime after the last command,
            by fault and sink, with the longest that an idle thread was woken late meanwhile.
        told: seconds from the last command to what the framework told of a dead host or broker.
        resumed: seconds from when a host went on that had stood still, to its stop.
        missed: what had no stop.
        stuck: after which fault not all sinks were commanded again, so that all was begun anew.
        untrue: reports of stops that were not what sinks saw.
        oldest: seconds of age of the oldest command that a sink took.
    """

    def __init__(self, world: World, chosen: random.Random) -> None:
        self._world = world
        self._chosen = chosen
        self.done = Counter[str]()
        self.late: dict[tuple[str, str], list[tuple[float, float]]] = defaultdict(list)
        self.told: dict[tuple[str, str, str], list[float]] = defaultdict(list)
        self.resumed: dict[tuple[str, str], list[float]] = defaultdict(list)
        self.missed: list[str] = []
        self.stuck: list[str] = []
        self.untrue: list[str] = []
        self.oldest: dict[str, float] = defaultdict(float)

    def one(self) -> None:
        """Do one fault, and put away what it left."""
        (fault,) = self._chosen.choices(tuple(WEIGHTS), tuple(WEIGHTS.values()))
        world = self._world
        try:
            world.begin()
        except TimeoutError as error:
            self.stuck.append(str(error))
            world.close()
            return
        time.sleep(self._chosen.uniform(0, 2 * PERIOD))
        self.done[fault] += 1
        begun = time.monotonic()
        who, _, what = fault.partition(" ")
        if who == "host":
            self._fault_of_host(fault, what)
        elif who == "broker":
            self._kill_broker(fault)
        elif who == "stop":
            asyncio.run(self._stop_all(fault))
        else:
            self._break(who, what)
            concerned = ("far",) if who == "machine" else FUNCTIONS
            self._expect_stops(fault, concerned, begun)
        self._end_round(fault)
        world.settle(fault)
        print(f"{self.done.total()} {fault} {os.getloadavg()[0]:.1f}", file=sys.stderr)

    def _break(self, who: str, what: str) -> None:
        world = self._world
        assert world.server is not None
        assert world.client is not None
        if what.startswith("link"):
            link = world.clients if who == "client" else world.machines
            (link.cut if what == "link cut" else link.stall)()
            return
        part = world.client if who == "client" else world.server
        part.process.send_signal(signal.SIGUSR1 if what == "GIL hang" else getattr(signal, what))

    def _expect_stops(self, fault: str, concerned: tuple[str, ...], begun: float) -> None:
        for name in concerned:
            stop = self._stop_after(fault, name, begun)
            if stop is not None:
                goes = [at for at, what, _ in self._world.seen(name, 0) if what == "go"]
                last = max(at for at in goes if at <= stop)
                self.late[fault, name].append((stop - last - LIFETIME, self._woken(last, stop)))

    def _stop_after(self, fault: str, name: str, begun: float) -> float | None:
        """Return when a sink took its first stop after a moment; None, and noted: it did not.

        One that stood still at that moment had its stop before; so it is on a busy machine, where
        commands come so seldom that they expire by themselves.
        """
        found: list[Line] = []

        def has_stopped() -> bool:
            seen = self._world.seen(name, 0)
            later = [one for one in seen if one[0] >= begun and one[1] == "stop"]
            found[:] = later or [one for one in seen[-1:] if one[1] == "stop"]
            return bool(found)

        try:
            until(has_stopped, "stopped", SURELY)
        except TimeoutError:
            self.missed.append(f"{fault}: {name}")
            return None
        return found[0][0]

    def _fault_of_host(self, fault: str, what: str) -> None:
        """Kill a host, or have it stand for a while; the others go on."""
        world = self._world
        name = self._chosen.choice(FUNCTIONS)
        process = world.host(name)
        begun = time.monotonic()
        if what == "SIGKILL":
            os.kill(process, signal.SIGKILL)
            time.sleep(STANDS)
            self._note_told(fault, name, begun)
            if any(kind == "stop" for _, kind, _ in world.seen(name, begun + PERIOD)):
                self.untrue.append(f"{fault}: {name} took a stop of the dead")
            return
        with _standing(process):
            time.sleep(STANDS)
            goes_on = time.monotonic()
        stop = self._stop_after(fault, name, begun)
        if stop is not None:
            self.resumed[fault, name].append(stop - goes_on)

    def _kill_broker(self, fault: str) -> None:
        """Kill the broker; after it has come back commands go on."""
        world = self._world
        begun = time.monotonic()
        world.broker.end()
        time.sleep(STANDS)
        self._note_told(fault, "mqtt", begun)
        world.broker.start()
        again = time.monotonic()
        until(lambda: world.seen("mqtt", again), "commands go on behind the broker")

    def _note_told(self, fault: str, name: str, begun: float) -> None:
        goes = [at for at, what, _ in self._world.seen(name, 0) if what == "go"]
        words = self._world.told(name, begun)
        if words:
            self.told[fault, name, words[0][2]].append(words[0][0] - goes[-1])
        else:
            self.told[fault, name, "nothing"].append(0.0)

    async def _stop_all(self, fault: str) -> None:
        """Stop all while commands go on; whoever is said to have stopped must have, and stay so."""
        world = self._world
        stands = self._chosen.choice(HOSTED) if "stands" in fault else None
        async with connect(world.url) as robot:
            with nullcontext() if stands is None else _standing(world.host(stands)):
                begun = time.monotonic()
                report = await robot.stop_all()
                stopped = {one["function"] for one in report["inputs"] if one["stopped"]}
                await asyncio.sleep(WATCHED)
                for name in FUNCTIONS:
                    told = self._untrue(name in stopped, name == stands, world.seen(name, begun))
                    if told:
                        self.untrue.append(f"{fault}: {name}: {told}")
            if stands is not None:
                self._stop_after(fault, stands, begun)
            await robot.release()

    def _untrue(self, is_said: object, stands: object, seen: list[Line]) -> str:
        """Return what is not true of a sink in a report; nothing where all is."""
        whats = [what for _, what, _ in seen]
        first = whats.index("stop") if "stop" in whats else None
        has_stopped = first is not None and "go" not in whats[first:]
        if is_said == has_stopped and is_said != stands:
            return ""
        return f"said to have stopped: {is_said}, its host stands: {stands}, it took {whats}"

    def _end_round(self, fault: str) -> None:
        """Have everybody at rest again; note how old commands were."""
        world = self._world
        for name in FUNCTIONS:
            for _, what, age in world.seen(name, world.begun):
                if what == "go" and age:
                    self.oldest[name] = max(self.oldest[name], float(age))
        if fault.startswith("client"):
            for name in FUNCTIONS:
                try:  # a command may have been on its way behind a stop
                    until(lambda name=name: world.seen(name, 0)[-1][1] == "stop", "at rest")  # type: ignore[misc]
                except TimeoutError:
                    self.missed.append(f"{fault}: {name} went on behind its stop")

    def _woken(self, since: float, to: float) -> float:
        """Return by how much an idle thread was woken late in this time, at the most."""
        late = (float(by) for at, _, by in self._world.clock.lines() if since <= at <= to + QUIET)
        return max(late, default=0.0)


@click.command()
@click.option("--minutes", default=10.0, show_default=True)
@click.option("--most", default=1000, show_default=True, help="Faults.")
@click.option("--seed", default=0, show_default=True)
def main(minutes: float, most: int, seed: int) -> None:
    """Do faults for a while and print what came of them."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that all parts end with it
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ.setdefault("ROS_DOMAIN_ID", str(64 + os.getpid() % 38))
    loads = [os.getloadavg()[0]]
    end = time.monotonic() + 60 * minutes
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        faults = Faults(World(folder, stack), random.Random(seed))
        try:
            while time.monotonic() < end and faults.done.total() < most:
                faults.one()
                loads.append(os.getloadavg()[0])
        except KeyboardInterrupt:
            print("interrupted", file=sys.stderr)
        finally:
            print_results(faults, f"load {min(loads):.0f} to {max(loads):.0f}")
    sys.exit(1 if faults.missed or faults.untrue else 0)


def print_results(faults: Faults, load: str) -> None:
    """Print the tables."""
    print(f"{faults.done.total()} faults, {load}: {dict(sorted(faults.done.items()))}")
    by_sink: dict[str, list[tuple[float, float]]] = defaultdict(list)
    by_fault: dict[str, list[tuple[float, float]]] = defaultdict(list)
    for (fault, name), values in faults.late.items():
        by_sink[name] += values
        by_fault[fault] += values
    headings = ["", "stops", "median", "p99", "most", f"woken within {1000 * QUIET:g} ms", "p99"]
    for title, table in (("sink", by_sink), ("fault", by_fault)):
        print_table(
            f"Stops after the lifetime of {LIFETIME:g} s, by {title}",
            headings,
            [[key, *_figures(values)] for key, values in table.items()],
        )
    print_table(
        "What frameworks tell the sink of a dead host or broker, after its last command",
        ["fault", "sink", "told", "times", "median", "most"],
        [[*key, str(len(values)), *_of(values, 0.5, 1)] for key, values in faults.told.items()],
    )
    print_table(
        "A host that stood still: from when it goes on to its stop",
        ["fault", "sink", "times", "median", "most"],
        [[*key, str(len(values)), *_of(values, 0.5, 1)] for key, values in faults.resumed.items()],
    )
    print(f"oldest commands taken: { {k: f'{v:.3f} s' for k, v in faults.oldest.items()} }")
    print(f"begun anew: {len(faults.stuck)} {faults.stuck}")
    print(f"missed: {len(faults.missed)} {faults.missed}")
    print(f"untrue reports: {len(faults.untrue)} {faults.untrue}")


@contextmanager
def _standing(process: int) -> Iterator[None]:
    """Have a process stand. It goes on however this ends: what stands would stay for good."""
    os.kill(process, signal.SIGSTOP)
    try:
        yield
    finally:
        with suppress(ProcessLookupError):
            os.kill(process, signal.SIGCONT)


def _figures(values: list[tuple[float, float]]) -> list[str]:
    late = [one for one, _ in values]
    quiet = [one for one, woken in values if woken <= QUIET]
    return [str(len(late)), *_of(late, 0.5, 0.99, 1), str(len(quiet)), *_of(quiet, 0.99)]


def _of(values: list[float], *shares: float) -> list[str]:
    """Return the values below which these shares of them are."""
    if not values:
        return ["-" for _ in shares]
    ordered = sorted(values)
    chosen = (ordered[min(len(ordered) - 1, int(share * len(ordered)))] for share in shares)
    return [f"{1000 * one:.0f} ms" for one in chosen]


if __name__ == "__main__":
    main()
