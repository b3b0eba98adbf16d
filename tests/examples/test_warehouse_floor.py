"""The simulator of the warehouse: what it counts is what happened, and bases stop by themselves."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.examples.warehouse_fleet import WAREHOUSE
from tests.sweeps import for_all
from warehouse_floor.bodies import BASE_TIMEOUT, Floor
from warehouse_floor.layout import DOCKS, HOMES, NODES, SHELVES, neighbours, route
from warehouse_orders.orders import Journal, Note, Order, Status, read_lines, replay

STEP = 0.05
assert WAREHOUSE.is_dir()


def drive(floor: Floor, seconds: float, *, now: float = 0.0, until: float = 1e9) -> float:
    """Drive every body forward for a time; return when it is over."""
    for _ in range(round(seconds / STEP)):
        now += STEP
        for name in floor.bodies:
            floor.command(name, (1.0, 0.0, 0.0), until, now)
        floor.step(now, STEP)
    return now


def coast(floor: Floor, now: float, seconds: float) -> float:
    """Command nothing for a time."""
    for _ in range(round(seconds / STEP)):
        now += STEP
        floor.step(now, STEP)
    return now


def test_a_base_stops_when_it_gets_no_command() -> None:
    floor = Floor()
    body = floor.add("one", "home1")
    now = drive(floor, 2)
    assert body.speed == pytest.approx(1.0)
    coast(floor, now, BASE_TIMEOUT + 0.5)
    assert not body.is_moving


def test_who_moves_without_a_live_command_is_counted_once() -> None:
    floor = Floor()
    floor.add("one", "home1")
    now = drive(floor, 1, until=1.0)
    assert floor.unauthorised == 0
    now = drive(floor, 2, now=now, until=1.0)
    assert floor.unauthorised == 1
    now = coast(floor, now, 2)
    drive(floor, 1, now=now, until=1.0)
    assert floor.unauthorised == 2


def test_vehicles_that_touch_are_counted_once() -> None:
    floor = Floor()
    floor.add("one", "n11")
    other = floor.add("other", "n21")
    other.pose = (*other.pose[:2], 3.14159)
    drive(floor, 0.5)
    assert floor.collisions == 0
    drive(floor, 1, now=0.5)
    assert floor.collisions == 1


def test_a_rack_is_hit() -> None:
    floor = Floor()
    floor.add("one", "n13")
    drive(floor, 1.5)
    assert floor.collisions == 1


def test_a_bumper_stops_before_what_stands_in_the_way() -> None:
    floor = Floor()
    body = floor.add("one", "n11")
    floor.obstacles.add("n41")
    drive(floor, 10)
    assert floor.sense("one").is_blocked
    assert floor.collisions == 0
    assert body.pose[0] > NODES["n21"][0]


def test_boxes_are_picked_at_shelves_and_put_down_at_docks() -> None:
    floor = Floor()
    body = floor.add("one", "shelf1")
    assert floor.carry("one", "box")
    assert not floor.carry("one", "")
    body.pose = (*NODES["dock1"], 0.0)
    assert floor.carry("one", "")
    assert floor.boxes == {"box": "dock1"}
    body.pose = (*NODES["shelf1"], 0.0)
    assert not floor.carry("one", "box")
    assert not floor.carry("one", "box")
    assert floor.repeats == 1


@given(
    st.sampled_from(sorted(NODES)),
    st.sampled_from(sorted(NODES)),
    st.sets(st.sampled_from(sorted(NODES))),
)
def test_a_route_leads_along_neighbours_and_past_what_is_closed(
    start: str, goal: str, closed: set[str]
) -> None:
    way = route(start, goal, closed)
    if way is None:
        assert closed or (start in {*SHELVES, *DOCKS, *HOMES})
        return
    assert (way[0], way[-1]) == (start, goal)
    assert not closed.intersection(way[1:])
    assert all(there in neighbours(here) for here, there in pairwise(way))


@for_all("start", sorted(NODES))
def test_every_node_can_be_left_for_every_other(start: str) -> None:
    assert all(route(start, goal) for goal in NODES)


def test_a_journal_that_was_cut_short_is_read_and_written_on(tmp_path: Path) -> None:
    path = tmp_path / "noted.jsonl"
    placed = {"order": "a", "source": "shelf1", "target": "", "load": 5}
    journal = Journal(path)
    journal.write([Note("a", Status.LOADED, "v").line()])
    journal.close()
    with path.open("a") as file:
        file.write('{"order": "a", "sta')
    assert [
        order.status for order in replay([placed], [mapping for mapping, _ in read_lines(path)])
    ] == [Status.LOADED]
    journal = Journal(path)
    journal.write([Note("a", Status.DONE, "v").line()])
    journal.close()
    (order,) = replay([placed], [mapping for mapping, _ in read_lines(path)])
    assert (order.status, order.vehicle) == (Status.DONE, "v")


@pytest.mark.parametrize(
    ("field", "value", "text"),
    [
        ("source", "shelf9", "shelf1"),
        ("target", "home1", "dock1"),
        ("load", -1, "0 kg"),
        ("order", "", "1 to 64"),
    ],
)
def test_an_order_that_cannot_be_carried_out_is_refused(
    field: str, value: object, text: str
) -> None:
    entry = {"order": "a", "source": "shelf1", "target": "", "load": 5, field: value}
    with pytest.raises(ValueError, match=text):
        Order.placed(entry)
