"""Random faults: parts die, ways are blocked, vehicles get lost, while orders keep coming.

    python examples/warehouse/experiments/faults.py --minutes 10

At the end every fault is over, and what is left must be done. Prints a table, and fails where an
order was lost or done twice, two things touched, or a vehicle moved without a live command.
"""

from __future__ import annotations

import argparse
import asyncio
import itertools
import os
import random
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from attrs import define, field

EXAMPLE = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(EXAMPLE), str(EXAMPLE.parent / "healthbot"), str(EXAMPLE.parent / "vision")]

from healthbot_scene.crew import Crew, Part  # noqa: E402 - found once the path is set
from warehouse_floor.layout import NODES  # noqa: E402
from warehouse_floor.link import FloorLink  # noqa: E402
from warehouse_orders.orders import read_lines  # noqa: E402
from warehouse_scene.parts import Places, make_places, parts_of  # noqa: E402
from warehouse_scene.placing import orders  # noqa: E402

from uoarm.client import connect  # noqa: E402
from uoarm.errors import UoarmError  # noqa: E402

VEHICLES = ("amr", "cart", "agv")
BLOCKED = ("n51", "n45", "n24", "n72", "n15")
_FIRST = ("robot", "broker")
_CLEAR_METRES = 3.0
_WAITING = 4
_LOOK_SECONDS = 0.5
_SETTLE_SECONDS = 420.0


@define
class Faults:
    """What is broken now, and how often what was.

    Attributes:
        counts: of each fault.
        placed: orders that were acknowledged.
    """

    crew: Crew
    places: Places
    parts: dict[str, Part]
    link: FloorLink
    counts: Counter[str] = field(factory=Counter)
    placed: list[str] = field(factory=list)
    _dead: dict[str, float] = field(factory=dict)
    _lost: dict[str, float] = field(factory=dict)
    _blocked: dict[str, float] = field(factory=dict)

    def one(self, now: float) -> None:
        """Have something happen."""
        kind = random.choices(
            ("vehicle", "lost", "blocked", "application", "robot", "broker"), (4, 3, 3, 3, 1, 1)
        )[0]
        until = now + random.uniform(3, 25)
        if kind == "blocked":
            self._block(random.choice(BLOCKED), until)
        elif kind == "lost":
            self._lost[random.choice(VEHICLES)] = until
            self.counts["a vehicle is lost"] += 1
        else:
            name = {"vehicle": random.choice(VEHICLES), "application": "orders"}.get(kind, kind)
            if name not in self._dead:
                self.crew.kill(name)
                self._dead[name] = until
                self.counts[f"{name} is killed"] += 1
        self._tell()

    def mend(self, now: float) -> None:
        """Let the faults be over whose time is."""
        for running in self.crew.dead():
            self.counts[f"{running.part.name} ends by itself"] += 1
            self._dead[running.part.name] = now
            print(f"{running.part.name}: {running.last_words()}", file=sys.stderr, flush=True)
        over = [name for name, until in self._dead.items() if until <= now]
        for name in sorted(over, key=_FIRST.__contains__, reverse=True):
            # What needs the robot or the broker is not ready before they are.
            if name in _FIRST or not self._dead.keys() & set(_FIRST):
                self.crew.start(self.parts[name])
                del self._dead[name]
        self._blocked = {node: until for node, until in self._blocked.items() if until > now}
        self._tell()
        self._lost = {name: until for name, until in self._lost.items() if until > now}

    def _block(self, node: str, until: float) -> None:
        bodies = self.link.ask()["bodies"].values()
        x, y = NODES[node]
        if all((one["x"] - x) ** 2 + (one["y"] - y) ** 2 > _CLEAR_METRES**2 for one in bodies):
            self._blocked[node] = until
            self.counts["a way is blocked"] += 1

    def _tell(self) -> None:
        self.link.ask(obstacles=sorted(self._blocked))
        known = self.link.ask()["bodies"]
        for name in VEHICLES:
            if name in known:
                is_localised = self._lost.get(name, 0) < time.monotonic()
                self.link.ask(localised=name, **{"is": is_localised})


def done_orders(places: Places) -> Counter[str]:
    """Return how often each order was noted as done."""
    notes = [note for note, _ in read_lines(places.run / "noted.jsonl")]
    return Counter(note["order"] for note in notes if note["status"] == "done")


async def place(faults: Faults, order: dict[str, Any]) -> bool:
    """Place an order; False where the robot is away, so that it is placed again."""
    try:
        async with connect(faults.places.robot_url, timeout=5) as robot:
            await robot.call("transport", order, timeout=5)
    except (UoarmError, OSError, TimeoutError):
        return False
    faults.placed.append(order["order"])
    return True


@contextmanager
def keep_placing(faults: Faults) -> Iterator[None]:
    """Have some orders under way, always, for the length of a block."""
    stop = threading.Event()

    def work() -> None:
        wanted = orders(f"{int(time.time())}-")
        waiting = next(wanted)
        while not stop.wait(_LOOK_SECONDS):
            under_way = len(faults.placed) - len(done_orders(faults.places))
            if under_way < _WAITING and asyncio.run(place(faults, waiting)):
                waiting = next(wanted)

    thread = threading.Thread(target=work, name="placing")
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def run(minutes: float, every: float) -> int:
    """Run, and return the exit code."""
    begun_load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory(prefix="warehouse-") as folder:
        places = make_places(Path(folder))
        parts = parts_of(places, places.write_robot(EXAMPLE / "robot.yaml"))
        with Crew(places.run, places.environment()) as crew, FloorLink(places.floor) as link:
            crew.start_all(parts, lambda _: None)
            named = {part.name: part for part in parts}
            faults = Faults(crew, places, named, link)
            begun = time.monotonic()
            end, fault = begun + 60 * minutes, begun + every
            with keep_placing(faults):
                while (now := time.monotonic()) < end:
                    faults.mend(now)
                    if now > fault:
                        faults.one(now)
                        fault = now + random.expovariate(1 / every)
                    time.sleep(_LOOK_SECONDS)
            faults.mend(float("inf"))
            end = time.monotonic() + _SETTLE_SECONDS
            while len(done_orders(places)) < len(faults.placed) and time.monotonic() < end:
                time.sleep(1)
            truth = link.ask()
        done = done_orders(places)
    return told(faults, done, truth, minutes, begun_load)


def told(
    faults: Faults, done: Counter[str], truth: dict[str, Any], minutes: float, before: float
) -> int:
    """Print the table and return the exit code."""
    lost = [order for order in faults.placed if order not in done]
    twice = [order for order, times in done.items() if times > 1]
    delivered = truth["deliveries"]
    undelivered = [order for order in done if delivered.get(order) != 1]
    wrong = {
        "orders lost": len(lost),
        "orders noted as done twice": len(twice),
        "orders noted as done whose box was not put down once": len(undelivered),
        "boxes reached for after they were delivered": truth["repeats"],
        "collisions": truth["collisions"],
        "moves without a live command": truth["unauthorised"],
    }
    print(f"{minutes:g} minutes of random faults, load {before:.1f} to {os.getloadavg()[0]:.1f}\n")
    print("| what | how often |\n| --- | --- |")
    facts = {"orders placed": len(faults.placed), "orders done": len(done)}
    facts["metres driven"] = round(truth["metres"])
    for what, count in itertools.chain(facts.items(), sorted(faults.counts.items()), wrong.items()):
        print(f"| {what} | {count} |")
    if lost:
        print(f"\nlost: {', '.join(lost)}")
    return 1 if any(wrong.values()) else 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--every", type=float, default=15.0, help="seconds between two faults")
    options = parser.parse_args()
    sys.exit(run(options.minutes, options.every))
