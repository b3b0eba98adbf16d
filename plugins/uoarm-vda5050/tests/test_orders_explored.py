"""A fleet and a vehicle in every order of events: messages lost, cancellations, deaths, restarts.

Both sides are plain state machines, so that a world is a value: it is copied, one event happens in
each copy, and what has been seen before is not looked at again.
"""

from __future__ import annotations

import copy
import random
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import pytest
from uoarm_vda5050._releases import RELEASES
from uoarm_vda5050._transport_state import Action, GoalEnded, Send, Status, Times, TransportState
from uoarm_vda5050._vehicle_state import Act, Drive, VehicleState

from fleet import goal
from uoarm.errors import UoarmError

TIMES = Times(repeat=1.0, accept=5.0, settle=5.0)
WORLDS = 250
WALKS, LONG = 200, 25


class Lane:
    """One fleet, one vehicle, and what is on its way to it."""

    def __init__(self, release: str) -> None:
        found = RELEASES[release]
        self.fleet = TransportState(found, TIMES, name="f")
        self.vehicle = VehicleState(found, frozenset({"pick"}))
        self.now = 0.0
        self.way: list[tuple[str, Any]] = []
        self.actions: list[Action] = []
        self.acts: Counter[str] = Counter()
        self.online = True
        self.left = Counter(give=2, cancel=1, lose=1, overtake=1, die=1, restart=1)
        self.goals = 0

    def key(self) -> str:
        """What distinguishes worlds: the time does not, where nothing depends on it."""
        fleet = copy.copy(self.fleet)
        due = self.fleet.wake_at()
        for name in ("_repeat_at", "_give_up_at", "_cancel_at", "_abandoned_at", "_made"):
            setattr(fleet, name, 0)
        reports = [(type(item).__name__, getattr(item, "status", "")) for item in self.actions]
        due = None if due is None else due - self.now
        return repr((fleet, due, self.vehicle, self.way, reports[-4:], self.online, self.left))

    def do(self, actions: Iterable[Action]) -> None:
        for action in actions:
            if isinstance(action, Send):
                if self.online:
                    self.way.append((action.topic, action.body))
            else:
                self.actions.append(action)

    def events(self) -> Iterator[Callable[[Lane], object]]:
        if self.left["give"]:
            yield Lane.give
        if self.way:
            yield Lane.arrive
            if self.left["lose"]:
                yield Lane.lose
            if self.left["overtake"] and len({topic for topic, _ in self.way[:2]}) > 1:
                yield Lane.overtake
        if self.online:
            yield Lane.report
        if self.vehicle.task is not None:
            yield Lane.drive
        if self.left["cancel"] and self.fleet.goal_id:
            yield Lane.cancel
        if self.fleet.wake_at() is not None:
            yield Lane.wait
        if self.left["die"] or not self.online:
            yield Lane.die if self.online else Lane.come
        if self.left["restart"]:
            yield Lane.restart

    def give(self) -> None:
        self.left["give"] -= 1
        try:
            _, actions = self.fleet.goal(GOAL, self.now)
        except UoarmError:
            return
        self.do(actions)

    def arrive(self) -> None:
        topic, body = self.way.pop(0)
        if topic == "order":
            self.vehicle.order(copy.deepcopy(body))
        else:
            for action in body["actions"]:
                self.vehicle.instant(action)

    def lose(self) -> None:
        self.left["lose"] -= 1
        self.way.pop(0)

    def overtake(self) -> None:
        """Messages keep their order on each topic only."""
        self.left["overtake"] -= 1
        self.way[:2] = self.way[1::-1]

    def report(self) -> None:
        second, charge = self.vehicle.release.battery
        more = {second: {charge: 50.0, "charging": False}}
        self.do(self.fleet.state({**self.vehicle.body(), **more}, self.now))

    def drive(self) -> None:
        task = self.vehicle.task
        if isinstance(task, Drive):
            assert self.vehicle.reached(task)
        elif isinstance(task, Act):
            self.acts[task.action_id] += 1
            assert self.vehicle.finished(task, "")

    def cancel(self) -> None:
        self.left["cancel"] -= 1
        self.do(self.fleet.cancel("", self.now))

    def wait(self) -> None:
        due = self.fleet.wake_at()
        assert due is not None
        self.now = max(self.now, due)
        self.do(self.fleet.tick(self.now))

    def die(self) -> None:
        self.left["die"] -= 1
        self.online = False
        self.way.clear()
        self.do(self.fleet.connection(False, "CONNECTIONBROKEN"))

    def come(self) -> None:
        self.online = True
        self.do(self.fleet.connection(True, ""))

    def restart(self) -> None:
        """The program of the fleet dies and starts again; it asks for the same goal as before."""
        self.left["restart"] -= 1
        self.fleet = TransportState(self.vehicle.release, TIMES, name="g")
        if not self.online:
            self.fleet.connection(False, "")
        self.actions.clear()

    def hold(self) -> None:
        """What holds in every world."""
        assert max(self.acts.values(), default=0) <= 1, "an action was performed twice"
        ends = [item.status for item in self.actions if isinstance(item, GoalEnded)]
        statuses = [item.status for item in self.actions if isinstance(item, Status)]
        assert [status for status in statuses if status != "accepted"] == ends, (
            "each end is reported once"
        )
        if "succeeded" in ends:
            assert self.acts, "it is said to have succeeded, and was not done"

    def abandon(self) -> None:
        """What is not waited for any more is not carried out, once the vehicle reports again."""
        if self.fleet.goal_id or not self.left["restart"]:
            return
        if not self.online:
            self.come()
        for _ in range(3):
            self.now += TIMES.repeat
            self.report()
            while self.way:
                self.arrive()
        assert self.vehicle.is_idle, "an order that is not waited for stands"

    def settle(self) -> None:
        """When nothing more happens but that time passes, every goal ends."""
        self.abandon()
        for _ in range(40):
            if not self.fleet.goal_id and not self.way:
                break
            while self.way:
                self.arrive()
            if self.vehicle.task is not None:
                self.drive()
            if not self.online:
                self.come()
            self.report()
            due = self.fleet.wake_at()
            if due is not None and due <= self.now + 1.0:
                self.wait()
            self.now += 0.25
        assert not self.fleet.goal_id, "the goal does not end"
        self.hold()


GOAL = goal("a", "b", order="box", b="pick")


@pytest.mark.parametrize("release", ["2.1", "3.0"])
def test_every_order_of_few_events(release: str) -> None:
    first = Lane(release)
    seen, worlds = {first.key()}, [first]
    for world in worlds:
        for event in world.events() if len(worlds) < WORLDS else ():
            other = copy.deepcopy(world)
            event(other)
            other.hold()
            if (key := other.key()) not in seen:
                seen.add(key)
                worlds.append(other)
    for world in worlds:
        world.settle()


@pytest.mark.parametrize("release", ["2.1", "3.0"])
def test_many_orders_of_many_events(release: str) -> None:
    ends: Counter[str] = Counter()
    for seed in range(WALKS):
        chance, world = random.Random(seed), Lane(release)
        for _ in range(LONG):
            events = [*world.events()]
            if not events:
                break
            chance.choice(events)(world)
            world.hold()
        world.settle()
        ends.update(item.status for item in world.actions if isinstance(item, GoalEnded))
    assert ends.keys() >= {"succeeded", "canceled", "aborted", "lost"}, "so much was seen"
