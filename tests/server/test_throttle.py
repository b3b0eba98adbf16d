"""How many messages of a stream pass where a client asks for fewer."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from uoarm.server.streams import Throttle


def passed(period: float, every: float, count: int) -> list[float]:
    """Return when messages pass of so many that come in a period."""
    throttle, times = Throttle(every, is_even=True), []
    for number in range(count):
        now = number * period
        if throttle.is_due(now):
            throttle.take(now)
            times.append(now)
    return times


@given(st.floats(0.001, 0.3))
def test_as_many_pass_as_are_asked_for_whatever_the_source_has(period: float) -> None:
    """Ten a second, of 12 a second, too: it was every other one, so that 6 were left."""
    seconds = 60.0
    times = passed(period, 0.1, int(seconds / period))
    wanted = min(10.0, 1 / period)
    assert wanted * seconds * 0.98 - 2 <= len(times) <= 10.0 * seconds + 2


def test_a_pause_is_made_up_for_by_no_burst() -> None:
    throttle = Throttle(0.1, is_even=True)
    throttle.take(0.0)
    throttle.take(50.0)
    assert not throttle.is_due(50.05)
    assert throttle.is_due(50.1)
