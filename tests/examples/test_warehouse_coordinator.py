"""The warehouse's coordinator with vehicles that die, get lost and are blocked."""

from __future__ import annotations

import pytest
from attrs import evolve
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from tests.examples.warehouse_fleet import Fleet
from warehouse_floor.layout import DOCKS, SHELVES
from warehouse_orders.coordinator import Command, Coordinator, Report
from warehouse_orders.orders import Order, Status


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
    fleet.floor.boxes["box"] = first  # it went on, without a report, as far as it had been sent
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
    assert not fleet.floor.bodies["vehicle1"].is_moving
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


def test_a_dead_vehicle_is_driven_round_by_a_coordinator_without_reports_of_it() -> None:
    fleet = Fleet(2)
    fleet.place("box1", "shelf4", "dock1")
    fleet.run(8)
    (first,) = [note.vehicle for note in fleet.journal]
    fleet.coordinator = None
    fleet.kill(first)
    fleet.run(5)
    x, y = fleet.floor.bodies[first].pose[:2]
    fleet.restart()
    fleet.run(60)
    assert fleet.floor.bodies[first].pose[:2] == (x, y)
    assert fleet.done == {"box1"}
    fleet.check()


def test_the_first_to_report_waits_for_no_vehicle_and_hits_none() -> None:
    fleet = Fleet(2)
    fleet.place("box1", "shelf4", "dock1")
    fleet.run(8)
    (first,) = [note.vehicle for note in fleet.journal]
    fleet.coordinator = None
    fleet.run(5)
    fleet.cut.add(first)
    fleet.restart()
    fleet.run(60)
    fleet.check()
    fleet.settle()


def test_what_a_vehicle_was_ordered_is_its_own_until_it_says_that_it_stands() -> None:
    coordinator = Coordinator()
    coordinator.place(Order("box", "shelf4", "dock1", 5.0))
    report = Report(
        0.0, 1.5, heading=0.0, speed=0.0, battery=90.0, payload=50.0, load="", leg=0, stopped=0,
        is_localised=True, is_blocked=False, drives_on=True,
    )  # fmt: skip
    seconds = 0.0

    def say(stopped: int = 0, speed: float = 0.0, *, is_blocked: bool = False) -> Command:
        nonlocal seconds
        seconds += 1
        latest = evolve(report, stopped=stopped, speed=speed, is_blocked=is_blocked)
        coordinator.report("one", latest, seconds)
        (command,) = coordinator.tick(seconds)
        return command

    stand = say().leg
    say(stand)
    command = say(stand)
    assert command.way[0] == "home1"
    assert len(command.way) > 2
    vehicle = coordinator.vehicles["one"]
    assert not say(is_blocked=True).way  # it waits there with its order, and is commanded to stand
    for _ in range(10):
        assert not say().way
        assert set(command.way) <= set(vehicle.held)
    stand = vehicle.leg
    say(stand, speed=1.0)
    assert set(command.way) <= set(vehicle.held)
    say(stand)
    assert vehicle.held != command.way


KINDS = ("kill", "revive", "lose", "find", "block", "clear", "coordinator", "place", "cut", "join")
FAULTS = st.tuples(st.sampled_from(KINDS), st.integers(0, 3), st.integers(1, 60))


@settings(max_examples=5, deadline=None, derandomize=True, phases=(Phase.explicit, Phase.generate))
@given(st.lists(FAULTS, max_size=14))
def test_whatever_happens_nothing_is_lost(faults: list[tuple[str, int, int]]) -> None:
    play(faults)


@pytest.mark.long
@settings(max_examples=40, deadline=None, phases=(Phase.explicit, Phase.generate))
@given(st.lists(FAULTS, min_size=6, max_size=30))
def test_whatever_happens_for_long_nothing_is_lost(faults: list[tuple[str, int, int]]) -> None:
    play(faults)


def play(faults: list[tuple[str, int, int]]) -> None:
    """Have faults happen one after the other, then none, and all orders done."""
    fleet = Fleet(3)
    fleet.place("first", "shelf2")
    for number, (fault, which, tenths) in enumerate(faults):
        happen(fleet, fault, which, f"box{number}", min(tenths, 50))
        fleet.run(tenths / 10 * 2)
        fleet.check()
    fleet.settle()


def happen(fleet: Fleet, fault: str, which: int, box: str, load: float) -> None:
    """Have one fault happen, an order be placed, or a fault be over."""
    name = fleet.names[which % 3]
    if fault == "kill":
        fleet.kill(name)
    elif fault == "revive":
        fleet.revive(name)
    elif fault == "cut":
        fleet.cut.add(name)
    elif fault == "join":
        fleet.cut.clear()
    elif fault in {"lose", "find"}:
        fleet.floor.bodies[name].is_localised = fault == "find"
    elif fault == "block":
        fleet.floor.block(("n51", "n45", "n24", "n72")[which], clear=2)
    elif fault == "clear":
        fleet.floor.obstacles.clear()
    elif fault == "place":
        fleet.place(box, SHELVES[which], load=load)
    elif fleet.coordinator is None:
        fleet.restart()
    else:
        fleet.coordinator = None


def test_a_vehicle_off_the_floor_gets_no_order() -> None:
    fleet = Fleet(1)
    fleet.floor.bodies["vehicle1"].pose = (100.0, 100.0, 0.0)
    fleet.place("box", "shelf1")
    fleet.run(5)
    assert not fleet.journal
    fleet.floor.bodies["vehicle1"].pose = (0.0, 1.5, 0.0)
    fleet.settle()


def test_a_vehicle_that_gets_nowhere_is_ordered_anew() -> None:
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
