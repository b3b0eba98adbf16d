"""Health of a channel: each change is reported once, and trouble passes."""

from __future__ import annotations

from typing import Any, TypeAlias

import pytest
from uoarm_ros2._health import SimulatedClock, TopicHealth

from uoarm.model import Health

Reported: TypeAlias = "tuple[list[tuple[Health, str]], TopicHealth]"


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


def test_peers_come_and_go(clock: Clock) -> None:
    reports: list[tuple[Health, str]] = []
    topic_health = TopicHealth(lambda *news: reports.append(news), clock=clock)
    for current in (0, 1, 2, 1, 0, 0, 1):
        topic_health.note_peers(current, "publisher of /x", required=True)
    assert reports == [
        (Health.LOST, "disconnected: the last publisher of /x is gone"),
        (Health.OK, "a publisher of /x is there"),
    ]
    topic_health.note_peers(0, "publisher of /x", required=False)
    assert reports[-1][0] is Health.DEGRADED


def steady(clock: Clock, *, seconds: float = 10.0, gap: float = 0.25, **more: Any) -> Reported:
    """Return the reports and the health of a channel to which messages came steadily."""
    reports: list[tuple[Health, str]] = []
    topic_health = TopicHealth(
        lambda *news: reports.append(news), clock=clock, receives=True, **more
    )
    topic_health.note_peers(1, "publisher of /x", required=True)
    reports.clear()
    for _ in range(int(seconds / gap)):
        clock.now += gap
        topic_health.note_message()
        topic_health.tick()
    assert reports == []
    return reports, topic_health


def test_a_loss_says_which_option_would_have_reported_it_sooner(clock: Clock) -> None:
    reports, topic_health = steady(clock)
    clock.now += 20
    topic_health.note_peers(0, "publisher of /x", required=True)
    [(health, cause)] = reports
    assert health is Health.LOST
    assert cause.startswith(
        "disconnected: the last publisher of /x is gone, 20.0 s after its last message: "
    )
    assert cause.endswith("stale_after: 3 in the options of the output reports it sooner")


def test_a_loss_that_is_reported_at_once_says_no_more(clock: Clock) -> None:
    reports, topic_health = steady(clock)
    clock.now += 0.5
    topic_health.note_peers(0, "publisher of /x", required=True)
    assert reports == [(Health.LOST, "disconnected: the last publisher of /x is gone")]


def test_what_came_steadily_and_ceases_is_degraded_until_it_comes_again(clock: Clock) -> None:
    reports, topic_health = steady(clock)
    for _ in range(10):
        clock.now += 0.25
        topic_health.tick()
    assert reports == []
    for _ in range(10):
        clock.now += 0.25
        topic_health.tick()
    [(health, cause)] = reports
    assert health is Health.DEGRADED
    assert cause.startswith("silent: no message for 3.2 s, and before one came every 0.25 s or")
    assert "stale_after: 3 " in cause
    topic_health.note_message()
    topic_health.tick()
    assert reports[1:] == [(Health.OK, "messages arrive as they should")]
    clock.now += 60
    topic_health.tick()
    assert len(reports) == 2, "a topic that paused once is steady no more"


@pytest.mark.parametrize("more", [{"seconds": 4.0}, {"seconds": 30.0, "gap": 2.0}])
def test_of_few_messages_nothing_is_concluded(clock: Clock, more: dict[str, float]) -> None:
    reports, topic_health = steady(clock, **more)
    clock.now += 600
    topic_health.tick()
    assert reports == []


def test_a_topic_with_deadlines_is_lost_after_three_of_them(clock: Clock) -> None:
    reports, topic_health = steady(clock)
    assert topic_health.facts()["stale_after"] == "never"
    topic_health.note_deadlines([0.5, None])
    assert topic_health.facts()["stale_after"] == "never"
    topic_health.note_deadlines([0.5, 0.4])
    assert topic_health.facts()["stale_after"] == 1.5
    clock.now += 1.6
    topic_health.tick()
    cause = "silent: no message for 1.5 s, 3 times the deadline of its QoS (stale_after)"
    assert reports == [(Health.LOST, cause)]


def test_a_stated_time_stands_whatever_the_deadlines(clock: Clock) -> None:
    reports, topic_health = steady(clock, stale_after=60.0)
    topic_health.note_deadlines([0.1])
    clock.now += 59
    topic_health.tick()
    assert reports == []
    assert topic_health.facts()["stale_after"] == 60.0


def test_an_offered_channel_is_well_without_peers(clock: Clock) -> None:
    reports: list[tuple[Health, str]] = []
    topic_health = TopicHealth(lambda *news: reports.append(news), clock=clock)
    for current in (1, 0, 1):
        topic_health.note_peers(current, "subscription of /x", required=False, offered=True)
    assert reports == []
    topic_health.report(Health.DEGRADED, "incompatible QoS")
    topic_health.note_peers(0, "subscription of /x", required=False, offered=True)
    assert reports[-1] == (Health.OK, "no subscription of /x is there, and none need be")


def test_recurring_trouble_is_reported_once_and_passes(clock: Clock) -> None:
    reports: list[tuple[Health, str]] = []
    topic_health = TopicHealth(lambda *news: reports.append(news), clock=clock)
    for total in (1, 2, 3):
        topic_health.note_lost(total, "topic /x")
        topic_health.tick()
    assert [health for health, _ in reports] == [Health.DEGRADED]
    clock.now += 5.0
    topic_health.tick()
    assert len(reports) == 1, "no message has arrived since"
    topic_health.note_message()
    topic_health.tick()
    assert [health for health, _ in reports] == [Health.DEGRADED, Health.OK]
    topic_health.note_missed_deadline(1, "topic /x")
    assert [health for health, _ in reports][-1] is Health.DEGRADED
    assert topic_health.facts()["lost_by_middleware"] == 3
    assert topic_health.facts()["deadlines_missed"] == 1


def test_silence_is_stale_and_a_message_mends_it(clock: Clock) -> None:
    reports: list[tuple[Health, str]] = []
    topic_health = TopicHealth(lambda *news: reports.append(news), stale_after=0.5, clock=clock)
    clock.now += 0.5
    topic_health.tick()
    assert reports == []
    clock.now += 0.1
    topic_health.tick()
    topic_health.tick()
    assert reports == [(Health.LOST, "silent: no message for 0.5 s")]
    topic_health.note_message()
    topic_health.tick()
    assert reports[-1][0] is Health.OK
    assert len(reports) == 2


def test_a_simulated_clock_stands_and_begins_again() -> None:
    clock = SimulatedClock()
    seen = []
    for seconds in (10, 12, 12, 1, 3):
        clock.take(seconds * 1_000_000_000)
        seen.append(clock())
    assert seen == [0, 2, 2, 2, 4]
