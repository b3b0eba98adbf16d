"""What is reported of a connection that breaks, lasts, and comes back."""

from __future__ import annotations

from uoarm.bridge import Disconnection
from uoarm.model import Health


def test_a_disconnection_is_reported_once_lost_once_and_over_once() -> None:
    disconnection = Disconnection(grace=10.0)
    assert disconnection.up() is None
    reported = [disconnection.down(now, final=False) for now in (0.0, 1.0, 9.9, 10.0, 11.0)]
    assert reported == [Health.DEGRADED, None, None, Health.LOST, None]
    assert disconnection.is_over
    assert [disconnection.up(), disconnection.up()] == [Health.OK, None]
    assert disconnection.down(20.0, final=True) is Health.LOST


def test_what_no_client_relied_upon_is_not_lost_and_its_coming_is_news() -> None:
    disconnection = Disconnection(grace=10.0)
    assert [disconnection.down(now, final=True) for now in (0.0, 100.0)] == [None, None]
    assert disconnection.up() is Health.OK


def test_it_says_how_long_a_break_may_still_last() -> None:
    disconnection = Disconnection(grace=10.0)
    disconnection.up()
    assert disconnection.left(0.0) is None
    disconnection.down(1.0, final=False)
    assert [disconnection.left(now) for now in (1.0, 4.0, 12.0)] == [10.0, 7.0, 0.0]
    disconnection.down(12.0, final=False)
    assert disconnection.left(12.0) is None
