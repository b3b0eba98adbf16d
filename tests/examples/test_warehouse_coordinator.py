"""The warehouse's coordinator with vehicles that die, get lost and are blocked."""

from __future__ import annotations

import math

import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from tests.examples.warehouse_fleet import Fleet
from warehouse_floor.layout import DOCKS, NODES, SHELVES
from warehouse_orders.orders import Status


def test_every_order_is_done_once() -> None:
    fleet = Fleet()
    for number in range(6):
        fleet.place(f"box{number}", SHELVES[number % 4], DOCKS[number % 2], load=5)
    fleet.settle()


def test_a_vehicle_gets_what_it_can_carry() -> None:
    fleet = Fleet()
    fleet.place("heavy1", load=20)
    fleet.place("heavy2", "shelf2", load=20)
    fleet.place("heavy3", "shelf3", load=20)
    fleet.settle()
    carriers = {note.vehicle for note in fleet.journal if note.status is Status.LOADED}
    assert carriers == {"vehicle1", "vehicle2"}


def test_the_order_of_a_dead_vehicle_goes_to_the_next() -> None:
    fleet = Fleet()
    fleet.place("box", "shelf4")
    fleet.run(3)
    (first,) = [note.vehicle for note in fleet.journal]
    fleet.kill(first)
    fleet.run(60)
    assert fleet.done == {"box"}
    assert fleet.journal[-1].vehicle != first
    fleet.settle()


def test_a_box_on_a_dead_vehicle_is_waited_for() -> None:
    fleet = Fleet()
    fleet.place("box", "shelf1")
    while not fleet.journal or fleet.journal[-1].status is not Status.LOADED:
        fleet.run(0.5)
    first = fleet.journal[-1].vehicle
    fleet.kill(first)
    fleet.place("other", "shelf4")
    fleet.run(60)
    assert fleet.done == {"other"}
    fleet.revive(first)
    fleet.settle()
    assert fleet.journal[-1].vehicle == first


def test_who_has_the_box_has_the_order() -> None:
    fleet = Fleet(2)
    fleet.place("box", "shelf4")
    fleet.run(3)
    (first,) = [note.vehicle for note in fleet.journal]
    fleet.kill(first)
    fleet.floor.deliveries["box"] = 0
    fleet.floor.boxes["box"] = first  # it went on, unheard of, as far as it had been told to
    fleet.floor.bodies[first].load = "box"
    fleet.run(20)
    assert fleet.journal[-1].vehicle not in {"", first}
    fleet.revive(first)
    fleet.settle()
    assert fleet.journal[-1].vehicle == first


@pytest.mark.parametrize("seconds", [2, 6, 10, 14, 18, 22, 26])
def test_a_coordinator_that_died_goes_on_where_it_was(seconds: float) -> None:
    fleet = Fleet(2)
    fleet.place("box1", "shelf3")
    fleet.place("box2", "shelf4")
    fleet.run(seconds)
    fleet.coordinator = None
    fleet.run(5)
    assert all(not body.is_moving for body in fleet.floor.bodies.values())
    fleet.restart()
    fleet.settle()


def test_a_blocked_way_is_gone_round() -> None:
    fleet = Fleet(1)
    fleet.place("box", "shelf4")
    fleet.floor.obstacles.add("n51")
    fleet.floor.obstacles.add("n55")
    fleet.run(80)
    assert fleet.done == {"box"}
    fleet.check()


def test_a_vehicle_that_is_lost_stands_and_goes_on() -> None:
    fleet = Fleet(1)
    fleet.place("box", "shelf4")
    fleet.run(4)
    fleet.floor.bodies["vehicle1"].is_localised = False
    fleet.run(2)
    assert not fleet.floor.bodies["vehicle1"].is_moving
    fleet.settle()


def test_a_vehicle_without_power_charges_first() -> None:
    fleet = Fleet(1)
    fleet.floor.bodies["vehicle1"].battery = 20
    fleet.place("box", "shelf4")
    fleet.run(10)
    assert not fleet.journal
    fleet.settle()


FAULTS = st.tuples(
    st.sampled_from(["kill", "revive", "lose", "find", "block", "clear", "coordinator", "place"]),
    st.integers(0, 3),
    st.integers(1, 60),
)


@settings(max_examples=5, deadline=None, derandomize=True, phases=(Phase.explicit, Phase.generate))
@given(st.lists(FAULTS, max_size=14))
def test_whatever_happens_nothing_is_lost(faults: list[tuple[str, int, int]]) -> None:
    fleet = Fleet(3)
    fleet.place("first", "shelf2")
    for number, (fault, which, tenths) in enumerate(faults):
        name = fleet.names[which % 3]
        if fault == "kill":
            fleet.kill(name)
        elif fault == "revive":
            fleet.revive(name)
        elif fault in {"lose", "find"}:
            fleet.floor.bodies[name].is_localised = fault == "find"
        elif fault == "block":
            node = ("n51", "n45", "n24", "n72")[which]
            clear = all(
                math.dist(body.pose[:2], NODES[node]) > 2 for body in fleet.floor.bodies.values()
            )
            if clear:
                fleet.floor.obstacles.add(node)
        elif fault == "clear":
            fleet.floor.obstacles.clear()
        elif fault == "place":
            fleet.place(f"box{number}", SHELVES[which], load=min(tenths, 50))
        elif fleet.coordinator is None:
            fleet.restart()
        else:
            fleet.coordinator = None
        fleet.run(tenths / 10 * 2)
    fleet.settle()


def test_a_vehicle_off_the_floor_is_told_nothing() -> None:
    fleet = Fleet(1)
    fleet.floor.bodies["vehicle1"].pose = (100.0, 100.0, 0.0)
    fleet.place("box", "shelf1")
    fleet.run(5)
    assert not fleet.journal
    fleet.floor.bodies["vehicle1"].pose = (0.0, 1.5, 0.0)
    fleet.settle()


def test_a_vehicle_that_gets_nowhere_is_told_anew() -> None:
    fleet = Fleet(1)
    fleet.place("box", "shelf4")
    fleet.run(3)
    driver = fleet.drivers["vehicle1"]
    fleet.kill("vehicle1")
    fleet.revive("vehicle1")
    fleet.drivers["vehicle1"].go = lambda *_: None  # type: ignore[method-assign]
    leg = fleet.commands["vehicle1"][1].leg if "vehicle1" in fleet.commands else 0
    fleet.run(30)
    assert fleet.commands["vehicle1"][1].leg > leg + 1
    fleet.drivers["vehicle1"] = driver
    fleet.settle()
