"""The clock of a simulation, and the silence that publishers promise not to reach."""

from __future__ import annotations

import pytest
from uoarm_ros2._health import SimulatedClock, promised_silence


def test_a_simulated_clock_stands_and_begins_again() -> None:
    clock = SimulatedClock()
    seen = []
    for seconds in (10, 12, 12, 1, 3):
        clock.take(seconds * 1_000_000_000)
        seen.append(clock())
    assert seen == [0, 2, 2, 2, 4]


@pytest.mark.parametrize(
    ("deadlines", "seconds"),
    [([], None), ([0.5, None], None), ([0.5, 0.4], 1.5), ([0.1], 1.0)],
)
def test_three_deadlines_are_a_silence_where_every_publisher_has_one(
    deadlines: list[float | None], seconds: float | None
) -> None:
    assert promised_silence(deadlines) == seconds
