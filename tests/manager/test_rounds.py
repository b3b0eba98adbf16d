"""When bridges are asked for candidates, and when those are known that may be expected."""

from __future__ import annotations

from uoarm._resolve import DiscoveryRounds
from uoarm.config import loads

ONE, OTHER = (loads("version: 1\nbridges: {}\nfunctions: {}\n") for _ in range(2))


def test_first_rounds_are_short_until_every_need_is_met_or_frameworks_had_their_time() -> None:
    rounds = DiscoveryRounds()
    reports = [
        (
            rounds.ended(base, begun, begun + 0.01, is_whole=is_whole, has_all=has_all),
            rounds.matched is base,
        )
        for base, begun, is_whole, has_all in (
            (ONE, 0.0, True, False),
            (ONE, 2.5, True, False),
            (ONE, 3.5, True, False),
            (OTHER, 4.0, True, True),
            (ONE, 5.0, False, True),  # it is new again
            (ONE, 9.0, False, False),
            (ONE, 11.9, True, False),
            (ONE, 12.1, True, False),
        )
    ]
    is_not_yet, is_matched = (0.25, False), (2.0, True)
    assert reports == [*[is_not_yet] * 2, *[is_matched] * 2, *[is_not_yet] * 3, is_matched]


def test_rounds_take_a_fifth_of_the_time_at_most() -> None:
    assert DiscoveryRounds().ended(ONE, 10.0, 20.0, is_whole=True, has_all=True) == 40.0


def test_no_long_rest_follows_a_round_while_requests_wait_for_the_first_candidates() -> None:
    rounds = DiscoveryRounds()
    assert rounds.ended(ONE, 10.0, 20.0, is_whole=False, has_all=False) == 0.25
    assert rounds.ended(ONE, 20.25, 30.0, is_whole=True, has_all=False) == 39.0
    assert rounds.matched is ONE
