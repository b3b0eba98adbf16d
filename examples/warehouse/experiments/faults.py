"""Random faults: parts die, ways are blocked, vehicles get lost, while orders keep coming.

    python examples/warehouse/experiments/faults.py --minutes 10

At the end every fault is over, and what is left must be done. Prints a table, and fails where an
order was lost or done twice, two things touched, or a vehicle moved without a live command.
"""

from __future__ import annotations

import asyncio
import itertools
import random
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from attrs import define, field
from experiment import VEHICLES, Stage, Tables, options, progress, stage
from warehouse_orders.orders import read_lines
from warehouse_scene.parts import Places, newcomer
from warehouse_scene.placing import orders

from uoarm.client import connect
from uoarm.errors import UoarmError

_GUEST = "visitor"
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
        stage: on which it is.
        vehicles: that die and get lost.
        counts: of each fault.
        placed: orders that were acknowledged.
    """

    stage: Stage
    vehicles: tuple[str, ...] = VEHICLES
    counts: Counter[str] = field(factory=Counter)
    placed: list[str] = field(factory=list)
    _dead: dict[str, float] = field(factory=dict)
    _lost: dict[str, float] = field(factory=dict)
    _blocked: dict[str, float] = field(factory=dict)

    def one(self, now: float) -> None:
        """Have something happen."""
        kind = random.choices(
            ("vehicle", "lost", "blocked", "application", "robot", "broker", "station"),
            (4, 3, 3, 3, 1, 1, 1),
        )[0]
        until = now + random.uniform(3, 25)
        if kind == "blocked":
            self._block(random.choice(BLOCKED), until)
        elif kind == "lost":
            self._lost[random.choice(self.vehicles)] = until
            self.counts["a vehicle is lost"] += 1
        else:
            name = {"vehicle": random.choice(self.vehicles), "application": "orders"}.get(
                kind, kind
            )
            if name not in self._dead:
                self.stage.crew.kill(name)
                self._dead[name] = until
                self.counts[f"{name} is killed"] += 1
        self._report()

    def mend(self, now: float) -> None:
        """Let the faults be over whose time is."""
        for running in self.stage.crew.dead():
            self.counts[f"{running.part.name} ends by itself"] += 1
            self._dead[running.part.name] = now
            progress(f"{running.part.name}: {running.last_words()}")
        over = [name for name, until in self._dead.items() if until <= now]
        for name in sorted(over, key=_FIRST.__contains__, reverse=True):
            # What needs the robot or the broker is not ready before they are.
            if name in _FIRST or not self._dead.keys() & set(_FIRST):
                self.stage.crew.start(self.stage.parts[name])
                del self._dead[name]
        for node in [node for node, until in self._blocked.items() if until <= now]:
            self.stage.link.ask(unblock=node)
            del self._blocked[node]
        self._lost = {name: until for name, until in self._lost.items() if until > now}
        self._report()

    def _block(self, node: str, until: float) -> None:
        if self.stage.link.ask(block=node, clear=_CLEAR_METRES)["is_blocked"]:
            self._blocked[node] = until
            self.counts["a way is blocked"] += 1

    def _report(self) -> None:
        known = self.stage.link.ask()["bodies"]
        for name in self.vehicles:
            if name in known:
                self.stage.link.ask(localised=name, **{"is": name not in self._lost})


def done_orders(places: Places) -> Counter[str]:
    """Return how often each order was noted as done."""
    notes = [note for note, _ in read_lines(places.run / "noted.jsonl")]
    return Counter(note["order"] for note in notes if note["status"] == "done")


async def place(faults: Faults, order: dict[str, Any]) -> bool:
    """Place an order; False where the robot is away, so that it is placed again."""
    try:
        async with connect(faults.stage.places.robot_url, timeout=5) as robot:
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
            under_way = len(faults.placed) - len(done_orders(faults.stage.places))
            if under_way < _WAITING and asyncio.run(place(faults, waiting)):
                waiting = next(wanted)

    thread = threading.Thread(target=work, name="placing")
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def run(minutes: float, every: float, tables: Tables) -> bool:
    """Run, and return whether nothing was wrong."""
    with stage() as scene:
        visitor = newcomer(scene.places)
        scene.crew.start(visitor)
        scene.parts[_GUEST] = visitor
        faults = Faults(scene, (*VEHICLES, _GUEST))
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
        while len(done_orders(scene.places)) < len(faults.placed) and time.monotonic() < end:
            time.sleep(1)
        truth = scene.link.ask()
        done = done_orders(scene.places)
    lost = [order for order in faults.placed if order not in done]
    delivered = truth["deliveries"]
    wrong = {
        "orders lost": len(lost),
        "orders noted as done twice": sum(times > 1 for times in done.values()),
        "orders noted as done whose box was not put down once": sum(
            delivered.get(order) != 1 for order in done
        ),
        "boxes reached for after they were delivered": truth["repeats"],
        "collisions": truth["collisions"],
        "moves without a live command": truth["unauthorised"],
    }
    facts = {"orders placed": len(faults.placed), "orders done": len(done)}
    facts["metres driven"] = round(truth["metres"])
    report = itertools.chain(facts.items(), sorted(faults.counts.items()), wrong.items())
    rows = [{"what": what, "how often": count} for what, count in report]
    tables.add(f"Random faults, {minutes:g} minutes", rows)
    for line in (*truth["contacts"], *(f"lost: {order}" for order in lost)):
        progress(line)
    return not any(wrong.values())


def main() -> int:
    """Run it and print the table."""
    chosen = options(__doc__, minutes=10.0, every=15.0)
    tables = Tables(chosen.json)
    is_well = run(chosen.minutes, chosen.every, tables)
    tables.print()
    return 0 if is_well else 1


if __name__ == "__main__":
    sys.exit(main())
