"""When bridges are asked for candidates, and when those are known that may be expected."""

from __future__ import annotations

from uoarm._control.discovery.candidate_watch import Rounds
from uoarm.config import loads

ONE, OTHER = (loads("version: 1\nbridges: {}\nfunctions: {}\n") for _ in range(2))


def test_first_rounds_are_short_until_every_need_is_met_or_frameworks_had_their_time() -> None:
    rounds = Rounds()
    told = [
        (rounds.ended(base, begun, begun + 0.01, has_all=has_all), rounds.matched is base)
        for base, begun, has_all in (
            (ONE, 0.0, False),
            (ONE, 2.5, False),
            (ONE, 3.5, False),
            (OTHER, 4.0, True),
            (ONE, 5.0, False),  # it is new again
        )
    ]
    assert told == [(0.25, False), (0.25, False), (2.0, True), (2.0, True), (0.25, False)]


def test_rounds_take_a_fifth_of_the_time_at_most() -> None:
    assert Rounds().ended(ONE, 10.0, 20.0, has_all=True) == 40.0
