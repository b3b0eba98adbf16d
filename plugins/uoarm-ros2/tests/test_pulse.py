"""Health of a channel: each change is told once, and trouble passes."""

from __future__ import annotations

from typing import Any, TypeAlias

import pytest
from uoarm_ros2._pulse import Pulse, SimulatedClock

from uoarm.model import Health

Told: TypeAlias = "tuple[list[tuple[Health, str]], Pulse]"


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


def test_peers_come_and_go(clock: Clock) -> None:
    reports: list[tuple[Health, str]] = []
    pulse = Pulse(lambda *news: reports.append(news), clock=clock)
    for current in (0, 1, 2, 1, 0, 0, 1):
        pulse.peers(current, "publisher of /x", required=True)
    assert reports == [
        (Health.LOST, "the last publisher of /x is gone"),
        (Health.OK, "a publisher of /x is there"),
    ]
    pulse.peers(0, "publisher of /x", required=False)
    assert reports[-1][0] is Health.DEGRADED


def steady(clock: Clock, *, seconds: float = 10.0, gap: float = 0.25, **more: Any) -> Told:
    """Return what is told of a channel to which messages came steadily, and its pulse."""
    reports: list[tuple[Health, str]] = []
    pulse = Pulse(lambda *news: reports.append(news), clock=clock, hears=True, **more)
    pulse.peers(1, "publisher of /x", required=True)
    reports.clear()
    for _ in range(int(seconds / gap)):
        clock.now += gap
        pulse.beat()
        pulse.tick()
    assert reports == []
    return reports, pulse


def test_a_loss_says_what_would_have_told_it_sooner(clock: Clock) -> None:
    reports, pulse = steady(clock)
    clock.now += 20
    pulse.peers(0, "publisher of /x", required=True)
    [(health, cause)] = reports
    assert health is Health.LOST
    assert cause.startswith("the last publisher of /x is gone, 20.0 s after its last message: ")
    assert cause.endswith("stale_after: 3 in the options of the output tells it sooner")


def test_a_loss_that_is_told_at_once_says_no_more(clock: Clock) -> None:
    reports, pulse = steady(clock)
    clock.now += 0.5
    pulse.peers(0, "publisher of /x", required=True)
    assert reports == [(Health.LOST, "the last publisher of /x is gone")]


def test_what_came_steadily_and_ceases_is_degraded_until_it_comes_again(clock: Clock) -> None:
    reports, pulse = steady(clock)
    for _ in range(10):
        clock.now += 0.25
        pulse.tick()
    assert reports == []
    for _ in range(10):
        clock.now += 0.25
        pulse.tick()
    [(health, cause)] = reports
    assert health is Health.DEGRADED
    assert cause.startswith("no message for 3.2 s, and before one came every 0.25 s or sooner")
    assert "stale_after: 3 " in cause
    pulse.beat()
    pulse.tick()
    assert reports[1:] == [(Health.OK, "messages arrive as they should")]
    clock.now += 60
    pulse.tick()
    assert len(reports) == 2, "a topic that paused once is steady no more"


@pytest.mark.parametrize("more", [{"seconds": 4.0}, {"seconds": 30.0, "gap": 2.0}])
def test_of_few_messages_nothing_is_concluded(clock: Clock, more: dict[str, float]) -> None:
    reports, pulse = steady(clock, **more)
    clock.now += 600
    pulse.tick()
    assert reports == []


def test_a_topic_that_promises_its_rate_is_lost_after_three_deadlines(clock: Clock) -> None:
    reports, pulse = steady(clock)
    assert pulse.facts()["stale_after"] == "never"
    pulse.promise([0.5, None])
    assert pulse.facts()["stale_after"] == "never"
    pulse.promise([0.5, 0.4])
    assert pulse.facts()["stale_after"] == 1.5
    clock.now += 1.6
    pulse.tick()
    cause = "no message for 1.5 s, 3 times the deadline of its QoS (stale_after)"
    assert reports == [(Health.LOST, cause)]


def test_a_stated_time_stands_whatever_is_promised(clock: Clock) -> None:
    reports, pulse = steady(clock, stale_after=60.0)
    pulse.promise([0.1])
    clock.now += 59
    pulse.tick()
    assert reports == []
    assert pulse.facts()["stale_after"] == 60.0


def test_what_is_offered_is_well_without_anybody(clock: Clock) -> None:
    reports: list[tuple[Health, str]] = []
    pulse = Pulse(lambda *news: reports.append(news), clock=clock)
    for current in (1, 0, 1):
        pulse.peers(current, "subscription of /x", required=False, offered=True)
    assert reports == []
    pulse.tell(Health.DEGRADED, "incompatible QoS")
    pulse.peers(0, "subscription of /x", required=False, offered=True)
    assert reports[-1] == (Health.OK, "no subscription of /x is there, and none need be")


def test_recurring_trouble_is_told_once_and_passes(clock: Clock) -> None:
    reports: list[tuple[Health, str]] = []
    pulse = Pulse(lambda *news: reports.append(news), clock=clock)
    for total in (1, 2, 3):
        pulse.missed(total, "topic /x")
        pulse.tick()
    assert [health for health, _ in reports] == [Health.DEGRADED]
    clock.now += 5.0
    pulse.tick()
    assert len(reports) == 1, "no message has arrived since"
    pulse.beat()
    pulse.tick()
    assert [health for health, _ in reports] == [Health.DEGRADED, Health.OK]
    pulse.deadline(1, "topic /x")
    assert [health for health, _ in reports][-1] is Health.DEGRADED
    assert pulse.facts()["lost_by_middleware"] == 3
    assert pulse.facts()["deadlines_missed"] == 1


def test_silence_is_stale_and_a_message_mends_it(clock: Clock) -> None:
    reports: list[tuple[Health, str]] = []
    pulse = Pulse(lambda *news: reports.append(news), stale_after=0.5, clock=clock)
    clock.now += 0.5
    pulse.tick()
    assert reports == []
    clock.now += 0.1
    pulse.tick()
    pulse.tick()
    assert reports == [(Health.LOST, "no message for 0.5 s")]
    pulse.beat()
    pulse.tick()
    assert reports[-1][0] is Health.OK
    assert len(reports) == 2


def test_a_simulated_clock_stands_and_begins_again() -> None:
    clock = SimulatedClock()
    seen = []
    for seconds in (10, 12, 12, 1, 3):
        clock.take(seconds * 1_000_000_000)
        seen.append(clock())
    assert seen == [0, 2, 2, 2, 4]
