"""What a bridge shares between calls and channels, and what it lets go of."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from peers import DOMAIN
from uoarm_ros2 import _bridge
from uoarm_ros2._bridge import SharedEntities
from uoarm_ros2._discovery import Ros2Graph
from uoarm_ros2._middleware import Participant, Peer
from uoarm_ros2._options import Ros2Address, Ros2Options
from uoarm_ros2._qos import Policies
from uoarm_ros2._types import import_type

from uoarm.model import Role
from uoarm.testing import patience

SET_BOOL = "std_srvs/srv/SetBool"


@pytest.fixture
def participant() -> Iterator[Participant]:
    made = Participant(DOMAIN, "")
    yield made
    made.close(patience())


def test_the_client_of_a_node_goes_once_it_is_unused(
    participant: Participant, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nodes with names that are never seen again come and go: a client for each would pile up."""
    runner, native = participant.start_node("asking"), import_type(SET_BOOL)
    runner.server(native, "/asked", lambda _, answer: answer(native.Response(success=True)))  # type: ignore[attr-defined]
    shared = SharedEntities(
        runner, Ros2Graph(runner, 0.0), lambda: participant.start_node("replies")
    )
    waited_for: Any = shared.replies()._entities

    def ask() -> object:
        return shared.ask("/asked", SET_BOOL, {"data": True}, patience())

    assert ask() == {"success": True, "message": ""}
    shared.tick()
    assert len(waited_for) == 1
    monkeypatch.setattr(_bridge, "_UNUSED_SECONDS", -1.0)
    shared.tick()
    assert not waited_for
    assert ask() == {"success": True, "message": ""}


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
    runner: Any = Vanishing()
    topic = Ros2Graph(runner, 0.0).topic(Ros2Address("/gone"), Role.OUTPUT, Ros2Options())
    assert topic.type == "std_msgs/msg/Int64"
