"""The warehouse's component for VDA 5050: one order at a time, given again until it is reported."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "warehouse"))

from warehouse_parts import vda
from warehouse_parts.messages import NOTHING, Command


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr("warehouse_parts.vda.monotonic", lambda: now[0])
    return now


def leg(number: int, carry: str = "") -> Command:
    points: Any = [{"node": "n11", "x": 1.5, "y": 1.5}, {"node": "n21", "x": 3.0, "y": 1.5}]
    return {"leg": number, "points": points, "carry": carry}


def sent(agv: vda.Agv, command: Command) -> list[tuple[str, str]]:
    emitted: list[Any] = list(agv.command(command))
    return [
        (item.port, item.message.get("orderId", item.message.get("goal_id"))) for item in emitted
    ]


def test_a_goal_is_given_again_until_it_is_reported(clock: list[float]) -> None:
    agv = vda.Agv(payload=10)
    assert sent(agv, leg(7)) == [("goal", "7-1")]
    assert sent(agv, leg(7)) == []
    clock[0] += 3
    assert sent(agv, leg(7)) == [("goal", "7-1")]
    agv.status({"goal_id": "7-1", "status": "accepted"})
    clock[0] += 3
    assert sent(agv, leg(7)) == []


def test_one_order_has_ended_before_the_next_begins(clock: list[float]) -> None:
    agv = vda.Agv(payload=10)
    sent(agv, leg(7))
    agv.status({"goal_id": "7-1", "status": "accepted"})
    clock[0] += 3
    assert sent(agv, leg(8)) == [("cancel", "7-1")]
    assert sent(agv, leg(8)) == []
    agv.status({"goal_id": "7-1", "status": "canceled"})
    assert sent(agv, leg(8, "box")) == [("goal", "8-2")]


def test_an_order_that_no_vehicle_reports_is_forgotten(clock: list[float]) -> None:
    agv = vda.Agv(payload=10)
    sent(agv, leg(7))
    for _ in range(6):
        clock[0] += 3
        assert sent(agv, NOTHING) == [("cancel", "7-1")]
    assert sent(agv, leg(8)) == [("goal", "8-2")]


def test_what_was_refused_is_given_again_under_another_number(clock: list[float]) -> None:
    agv = vda.Agv(payload=10)
    sent(agv, leg(7))
    agv.status({"goal_id": "7-1", "status": "rejected"})
    assert sent(agv, leg(7)) == []
    clock[0] += 3
    assert sent(agv, leg(7)) == [("goal", "7-2")]


def test_what_is_done_is_not_given_again(clock: list[float]) -> None:
    agv = vda.Agv(payload=10)
    sent(agv, leg(7))
    agv.status({"goal_id": "7-1", "status": "succeeded"})
    clock[0] += 3
    assert sent(agv, leg(7)) == []
