"""Turns of a loop that end early with nothing to do are counted, and made rare."""

from __future__ import annotations

from uoarm.bridge import TurnCounter


def test_the_counter_has_turns_for_nothing_come_further_and_further_apart() -> None:
    counter = TurnCounter()
    rests = [counter.add(empty=True) for _ in range(9)]
    assert rests == [0.0, 0.001, 0.002, 0.004, 0.008, 0.016, 0.02, 0.02, 0.02]
    assert counter.add(empty=False) == 0.0
    assert counter.add(empty=True, complete=False) == 0.0
    assert counter.add(empty=True) == 0.0
    assert (counter.turns.all, counter.turns.empty) == (12, 11)
