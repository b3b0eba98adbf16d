"""Of many subscriptions those without messages are waited for apart, and miss nothing by it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from endpoints import Start
from peers import DOMAIN
from tests.inbox import Inbox  # type: ignore[import-not-found]
from tests.no_threads import no_threads  # type: ignore[import-not-found]
from uoarm_ros2._middleware import NodeRunner, Participant, _loop
from uoarm_ros2._qos import Policies
from uoarm_ros2._types import import_type, shape_of, structure_of

from uoarm.cdr import Codec
from uoarm.testing import wait

INT64 = import_type("std_msgs/msg/Int64")
TOPICS = [f"/quiet_{number}" for number in range(4)]


@pytest.fixture
def runner() -> Iterator[NodeRunner]:
    participant = Participant(DOMAIN, "")
    yield participant.start_node("ears")
    participant.close(2.0)


class Ear:
    """One subscription with what came, and how many publishers it has."""

    def __init__(self, runner: NodeRunner, topic: str) -> None:
        self.inbox = Inbox()
        self.matched = 0
        read = Codec(structure_of(shape_of(INT64, "std_msgs/msg/Int64"))).decode
        self.native = runner.subscribe(
            INT64,
            topic,
            Policies(),
            lambda octets: self.inbox(read(octets)),
            events={"matched": self._match},
        )
        (self.entity, *self.events) = runner._entities[self.native]

    def _match(self, info: Any) -> None:
        self.matched = info.current_count

    @property
    def is_quiet(self) -> bool:
        return self.entity.is_quiet and all(event.is_quiet for event in self.events)


def _many_ears(runner: NodeRunner, monkeypatch: pytest.MonkeyPatch) -> dict[str, Ear]:
    """Return subscriptions that are too many to be waited for together, from now on."""
    ears = {topic: Ear(runner, topic) for topic in TOPICS}
    # Only when all are there: of those that a sweep finds before, the last would be few.
    monkeypatch.setattr(_loop, "_QUIET_SECONDS", 0.0)
    monkeypatch.setattr(_loop, "_FEW", 2)
    return ears


def test_a_watch_for_which_there_is_no_thread_begins_later(
    runner: NodeRunner, peer: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    failures: list[str] = []
    monkeypatch.setattr(runner._records, "write", lambda _, text, error: failures.append(text))
    with no_threads("quiet"):
        ears = _many_ears(runner, monkeypatch)
        wait(lambda: failures and all(ear.is_quiet for ear in ears.values()))
    talker = peer("talker")
    for topic in TOPICS:
        talker.do("advertise", topic=topic)
    wait(lambda: all(ear.matched == 1 for ear in ears.values()))
    for topic in TOPICS:
        talker.do("publish", topic=topic, first=1, count=1)
    for ear in ears.values():
        ear.inbox.wait_for(1)


def test_a_quiet_subscription_receives_and_is_quiet_again(
    runner: NodeRunner, peer: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_loop, "_SWEEP_SECONDS", 0.0)
    ears = _many_ears(runner, monkeypatch)
    wait(lambda: all(ear.is_quiet for ear in ears.values()))
    talker = peer("talker")
    for topic in TOPICS:
        talker.do("advertise", topic=topic)
    wait(lambda: all(ear.matched == 1 for ear in ears.values()))
    for first in (1, 11, 21):
        for topic in TOPICS:
            talker.do("publish", topic=topic, first=first, count=10)
    for ear in ears.values():
        ear.inbox.wait_for(30)
        assert ear.inbox.numbers() == list(range(1, 31))
    wait(lambda: sum(ear.is_quiet for ear in ears.values()) >= 2)
    gone, *kept = ears.values()
    runner.discard(gone.native)
    for topic in TOPICS:
        talker.do("unadvertise", topic=topic)
    wait(lambda: all(ear.matched == 0 for ear in kept))


def test_few_subscriptions_are_waited_for_together(
    runner: NodeRunner, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_loop, "_QUIET_SECONDS", 0.0)
    monkeypatch.setattr(_loop, "_SWEEP_SECONDS", 0.0)
    ears = [Ear(runner, topic) for topic in TOPICS]
    swept: list[float] = []
    sweep = runner._loop._sweep

    def noted(now: float) -> None:
        sweep(now)
        swept.append(now)

    monkeypatch.setattr(runner._loop, "_sweep", noted)
    wait(lambda: len(swept) > 2)
    assert not any(ear.is_quiet for ear in ears)
