"""What a bridge shares between calls and channels, and what it lets go of."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Any

import pytest
from peers import DOMAIN
from uoarm_ros2 import _shared_ends
from uoarm_ros2._graph import Graph
from uoarm_ros2._middleware import Participant, Peer
from uoarm_ros2._qos import Policies
from uoarm_ros2._services import Server
from uoarm_ros2._settings import Address, Settings
from uoarm_ros2._shared_ends import SharedEnds
from uoarm_ros2._types import import_type

from uoarm.model import Endpoint, Role
from uoarm.testing import patience

SET_BOOL = "std_srvs/srv/SetBool"


@pytest.fixture
def participant() -> Iterator[Participant]:
    made = Participant(DOMAIN, "")
    yield made
    made.close(patience())


def test_the_client_of_a_node_goes_when_nobody_asks_any_more(
    participant: Participant, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nodes with names that are never seen again come and go: a client for each would pile up."""
    station, native = participant.station("asking"), import_type(SET_BOOL)
    station.server(native, "/asked", lambda _, answer: answer(native.Response(success=True)))  # type: ignore[attr-defined]
    shared = SharedEnds(station, Graph(station, 0.0), lambda: participant.station("replies"))
    waited_for: Any = shared.replies()._entities

    def ask() -> object:
        return shared.ask("/asked", SET_BOOL, {"data": True}, patience())

    assert ask() == {"success": True, "message": ""}
    shared.tick()
    assert len(waited_for) == 1
    monkeypatch.setattr(_shared_ends, "_ASKED_SECONDS", -1.0)
    shared.tick()
    assert not waited_for
    assert ask() == {"success": True, "message": ""}


def test_what_waits_to_be_handled_is_forgotten_when_nobody_takes_it(
    participant: Participant,
) -> None:
    """A handler that looks whether something waits, and then takes it, must find it."""
    station = participant.station("serving")
    at = Endpoint("ros", "thing", Role.SERVICE, ("/served", SET_BOOL))
    served = Server(station, at, "/served", SET_BOOL, lambda _: {}, 1, lambda *_: None)
    locked: list[bool] = []

    class Waiting(deque[Any]):
        def clear(self) -> None:
            locked.append(served._lock.locked())

    served._waiting = Waiting()
    served.close()
    assert locked == [True]


class Vanishing:
    """A station whose topic has a publisher at the first look only."""

    def __init__(self) -> None:
        self.there = [(Peer("/talker", "std_msgs/msg/Int64", Policies()),)]

    def topic_name(self, name: str) -> str:
        return name

    def publishers(self, topic: str) -> tuple[Peer, ...]:
        return self.there.pop() if self.there else ()

    def subscriptions(self, topic: str) -> tuple[Peer, ...]:
        return ()

    def topics(self) -> dict[str, list[str]]:
        return {}


def test_a_topic_that_goes_after_the_look_is_settled_by_that_look() -> None:
    station: Any = Vanishing()
    topic = Graph(station, 0.0).topic(Address("/gone"), Role.OUTPUT, Settings())
    assert topic.type == "std_msgs/msg/Int64"
