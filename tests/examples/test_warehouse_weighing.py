"""The warehouse's station: each box is weighed once, and the lamp shows what that says."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "warehouse"))

from warehouse_orders.orders import Order, Status
from warehouse_orders.weighing import Weighing


def orders(**status: Status) -> dict[str, Order]:
    return {name: Order(name, "shelf1", "", 5.0, value, "amr") for name, value in status.items()}


def test_a_box_is_weighed_once_it_has_arrived_and_not_again() -> None:
    some = orders(box1=Status.LOADED, box2=Status.DONE)
    weighing = Weighing()
    assert weighing.due(some.values()) == "box2"
    weighing.take("box2", 5.01)
    assert weighing.due(some.values()) == ""
    assert Weighing([{"order": "box2", "mass": 5.01}]).due(some.values()) == ""


@pytest.mark.parametrize(
    ("status", "mass", "colour"),
    [
        (Status.WAITING, None, "off"),
        (Status.LOADED, None, "amber"),
        (Status.DONE, None, "amber"),
        (Status.DONE, 5.02, "green"),
        (Status.DONE, 7.0, "red"),
    ],
)
def test_the_lamp_shows_how_the_last_box_was(
    status: Status, mass: float | None, colour: str
) -> None:
    weighing = Weighing([] if mass is None else [{"order": "box", "mass": mass}])
    assert weighing.colour(orders(box=status)) == colour


def test_the_lamp_is_amber_while_the_next_box_comes() -> None:
    weighing = Weighing([{"order": "box", "mass": 5.0}])
    assert weighing.colour(orders(box=Status.DONE, next=Status.LOADED)) == "amber"
