"""Health of a channel: each change is told once, and trouble passes."""

from __future__ import annotations

import pytest
from uoarm_ros2._pulse import Pulse, SimulatedClock

from uoarm.model import Health


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


def test_peers_come_and_go(clock: Clock) -> None:
    told: list[tuple[Health, str]] = []
    pulse = Pulse(lambda *news: told.append(news), clock=clock)
    for current in (0, 1, 2, 1, 0, 0, 1):
        pulse.peers(current, "publisher of /x", required=True)
    assert told == [
        (Health.LOST, "the last publisher of /x is gone"),
        (Health.OK, "a publisher of /x is there"),
    ]
    pulse.peers(0, "publisher of /x", required=False)
    assert told[-1][0] is Health.DEGRADED


def test_what_is_offered_is_well_without_anybody(clock: Clock) -> None:
    told: list[tuple[Health, str]] = []
    pulse = Pulse(lambda *news: told.append(news), clock=clock)
    for current in (1, 0, 1):
        pulse.peers(current, "subscription of /x", required=False, offered=True)
    assert told == []
    pulse.tell(Health.DEGRADED, "incompatible QoS")
    pulse.peers(0, "subscription of /x", required=False, offered=True)
    assert told[-1] == (Health.OK, "no subscription of /x is there, and none need be")


def test_what_cannot_be_read_is_counted_and_told_once(clock: Clock) -> None:
    told: list[tuple[Health, str]] = []
    pulse = Pulse(lambda *news: told.append(news), clock=clock)
    for _ in range(3):
        pulse.unread("on topic /x: cut short")
    assert told == [(Health.DEGRADED, "a message cannot be read on topic /x: cut short")]
    assert pulse.facts()["unreadable"] == 3


def test_recurring_trouble_is_told_once_and_passes(clock: Clock) -> None:
    told: list[tuple[Health, str]] = []
    pulse = Pulse(lambda *news: told.append(news), clock=clock)
    for total in (1, 2, 3):
        pulse.missed(total, "topic /x")
        pulse.tick()
    assert [health for health, _ in told] == [Health.DEGRADED]
    clock.now += 5.0
    pulse.tick()
    assert len(told) == 1, "no message has arrived since"
    pulse.beat()
    pulse.tick()
    assert [health for health, _ in told] == [Health.DEGRADED, Health.OK]
    pulse.deadline(1, "topic /x")
    assert [health for health, _ in told][-1] is Health.DEGRADED
    assert pulse.facts()["lost_by_middleware"] == 3
    assert pulse.facts()["deadlines_missed"] == 1


def test_silence_is_stale_and_a_message_mends_it(clock: Clock) -> None:
    told: list[tuple[Health, str]] = []
    pulse = Pulse(lambda *news: told.append(news), stale_after=0.5, clock=clock)
    clock.now += 0.5
    pulse.tick()
    assert told == []
    clock.now += 0.1
    pulse.tick()
    pulse.tick()
    assert told == [(Health.LOST, "no message for 0.5 s")]
    pulse.beat()
    pulse.tick()
    assert told[-1][0] is Health.OK
    assert len(told) == 2


def test_a_simulated_clock_stands_and_begins_again() -> None:
    clock = SimulatedClock()
    seen = []
    for seconds in (10, 12, 12, 1, 3):
        clock.take(seconds * 1_000_000_000)
        seen.append(clock())
    assert seen == [0, 2, 2, 2, 4]
