"""The schedule of attempts: data in, pauses out."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uoarm.bridge import Backoff


def test_pauses_double_up_to_the_longest() -> None:
    backoff = Backoff(first=0.1, most=2.0)
    assert [backoff.pause(failed) for failed in range(1, 8)] == [
        0.1, 0.2, 0.4, 0.8, 1.6, 2.0, 2.0,
    ]  # fmt: skip


def test_a_factor_of_one_is_a_steady_pause() -> None:
    assert {Backoff(0.5, 9.0, factor=1).pause(failed) for failed in (1, 2, 10**9)} == {0.5}


@given(
    first=st.floats(1e-6, 10),
    most=st.floats(1e-6, 100),
    factor=st.floats(1, 10),
    jitter=st.floats(0, 1),
    seed=st.integers(0, 2**32),
    failed=st.integers(0, 10**12),
)
def test_a_pause_is_bounded_and_follows_from_the_seed(
    first: float, most: float, factor: float, jitter: float, seed: int, failed: int
) -> None:
    backoff = Backoff(first, most, factor, jitter, seed)
    pause = backoff.pause(failed)
    assert 0 <= pause <= most
    assert pause >= min(first, most) * (1 - jitter)
    assert pause == Backoff(first, most, factor, jitter, seed).pause(failed)


def test_seeds_spread_those_who_lost_the_same_peer() -> None:
    pauses = {Backoff(jitter=0.5, seed=seed).pause(3) for seed in range(50)}
    assert len(pauses) == 50
    assert all(0.2 <= pause <= 0.4 for pause in pauses)


@pytest.mark.parametrize("wrong", [{"first": 0}, {"most": -1}, {"factor": 0.5}, {"jitter": 2}])
def test_a_schedule_that_makes_no_sense_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Backoff(**wrong)  # type: ignore[arg-type]
