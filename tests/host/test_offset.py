"""The offset between two clocks is right to half of the quickest round trip."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from uoarm._host.machines import ClockOffset

_DELAYS = st.integers(0, 10**9)
_OFFSETS = st.integers(-(10**18), 10**18)


@given(_OFFSETS, st.lists(st.tuples(_DELAYS, _DELAYS), min_size=1, max_size=16))
def test_it_is_right_to_half_of_the_quickest_round_trip(
    true: int, delays: list[tuple[int, int]]
) -> None:
    offset = ClockOffset()
    now = 10**18
    for there, back in delays:
        offset.add(now, now + there + true, now + there + back)
        now += there + back + 1
    assert offset.round_trip == min(there + back for there, back in delays)
    assert abs(offset.nanoseconds - true) <= offset.round_trip / 2 + 1


def test_a_clock_that_is_set_anew_is_learned() -> None:
    offset = ClockOffset()
    offset.add(0, 0, 2)
    for _ in range(16):
        offset.add(100, 5050, 110)
    assert offset.nanoseconds == 5050 - 105


def test_nothing_is_known_at_first_and_after_a_machine_has_left() -> None:
    offset = ClockOffset()
    known = [offset.known]
    offset.add(0, 50, 10)
    known.append(offset.known)
    offset.clear()
    assert [*known, offset.known] == [False, True, False]
    assert offset.nanoseconds == 0


def test_our_clock_that_was_set_back_meanwhile_does_no_harm() -> None:
    offset = ClockOffset()
    offset.add(100, 50, 0)
    assert offset.round_trip == 0


def test_an_answer_during_which_our_clock_was_set_is_no_answer() -> None:
    offset = ClockOffset()
    offset.add(0, 1_000_500, 1_000, 1_000)
    assert offset.nanoseconds == 1_000_000
    day = 86_400 * 10**9
    offset.add(day, 1_000_500, 2_000, 1_000_000)  # set back by a day while it was asked
    assert not offset.known
    offset.add(2_000_000, 2_500_000, 3_000_000, 1_000_000)
    assert (offset.nanoseconds, offset.round_trip) == (0, 1_000_000)
