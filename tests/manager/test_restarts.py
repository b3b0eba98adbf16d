"""A bridge that dies again and again is started later and later, and at last not at all."""

from __future__ import annotations

import pytest

from uoarm._bridges import Restarts
from uoarm.errors import BridgeError, FailureReason
from uoarm.testing import ManualClock


def _die(restarts: Restarts, clock: ManualClock, after: float) -> None:
    restarts.began("far")
    clock.advance(after)
    restarts.died("far", "it was killed")


def _waits(restarts: Restarts, clock: ManualClock, limit: int = 100) -> float:
    """Return how long it takes until a start is allowed."""
    waited = 0.0
    while True:
        try:
            restarts.check("far", limit)
        except BridgeError:
            clock.advance(0.125)
            waited += 0.125
        else:
            return waited


def test_a_bridge_that_never_died_may_start() -> None:
    Restarts(ManualClock()).check("far", 1)


def test_each_death_in_a_row_doubles_the_wait_up_to_half_a_minute() -> None:
    clock = ManualClock()
    restarts = Restarts(clock)
    waits = []
    for _ in range(11):
        _die(restarts, clock, after=1.0)
        waits.append(_waits(restarts, clock))
    assert waits == [0, 0.25, 0.5, 1, 2, 4, 8, 16, 30, 30, 30]


def test_a_minute_of_life_clears_the_record() -> None:
    clock = ManualClock()
    restarts = Restarts(clock)
    for _ in range(4):
        _die(restarts, clock, after=1.0)
    _die(restarts, clock, after=60.0)
    assert _waits(restarts, clock) == 0


def test_at_the_limit_it_is_given_up_with_the_cause() -> None:
    clock = ManualClock()
    restarts = Restarts(clock)
    for _ in range(3):
        _die(restarts, clock, after=1.0)
    clock.advance(1e6)
    with pytest.raises(
        BridgeError, match="died 3 times in a row, at last: it was killed"
    ) as report:
        restarts.check("far", 3)
    assert report.value.reason is FailureReason.UNAVAILABLE
    restarts.check("other", 3)
