"""The loop over a node never turns without work: each cause that ends a wait is taken, or rests."""

from __future__ import annotations

import itertools
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from endpoints import Start
from peers import DOMAIN, Peer
from tests.inbox import Inbox  # type: ignore[import-not-found]
from uoarm_ros2._middleware import NodeRunner, Participant, _actions, _loop
from uoarm_ros2._middleware._wait_set import WaitSet
from uoarm_ros2._qos import Policies
from uoarm_ros2._types import import_type

from uoarm.bridge import Bridge
from uoarm.testing import patience, wait

INT64 = import_type("std_msgs/msg/Int64")
IMAGE = import_type("sensor_msgs/msg/Image")
CALL: Any = import_type("test_msgs/srv/BasicTypes")
FIBONACCI: Any = import_type("test_msgs/action/Fibonacci")
_numbers = itertools.count(1)
FEW = 3
"""Turns for nothing that one cause may cost: the one that finds it, and what happens beside it."""


@pytest.fixture
def runner(monkeypatch: pytest.MonkeyPatch) -> Iterator[NodeRunner]:
    """A station that looks at events by the clock only once in the test's life."""
    monkeypatch.setattr(_loop, "_EVENT_SECONDS", 10 * patience())
    participant = Participant(DOMAIN, "")
    yield participant.start_node("loop")
    participant.close(2.0)


class Ear:
    """A subscription that notes its messages and its events, and waits without its events."""

    def __init__(
        self,
        runner: NodeRunner,
        talker: Peer,
        policies: Policies | None = None,
        *,
        native: type = INT64,
        **advertised: Any,
    ) -> None:
        self.events: Counter[str] = Counter()
        self.publishers = 0
        self.inbox = Inbox()
        self.topic = f"/loop_{next(_numbers)}"  # ends of other tests may not be gone yet
        names = ("matched", "message_lost", "incompatible_qos", "liveliness", "deadline")
        runner.subscribe(
            native,
            self.topic,
            policies or Policies(depth=100),
            self.inbox,
            events={name: self._notify(name) for name in names},
        )
        self._runner, self._talker = runner, talker
        talker.do("advertise", topic=self.topic, **advertised)
        wait(lambda: self.publishers == 1)
        self.wait_for_messages()
        self.empty = runner.turns.empty

    def _notify(self, name: str) -> Callable[[Any], None]:
        def notify(info: Any) -> None:
            self.events.update([name])
            if name == "matched":
                self.publishers = info.current_count

        return notify

    def wait_for_messages(self) -> None:
        """Have messages come until the loop waits for them alone."""
        before = len(self.inbox.messages)
        self._talker.do("publish", topic=self.topic, first=1, count=2)
        self.inbox.wait_for(before + 2)

    def turned_for_nothing(self) -> int:
        return self._runner.turns.empty - self.empty


def test_an_event_that_nothing_waits_for_costs_one_turn(runner: NodeRunner, peer: Start) -> None:
    ear = Ear(runner, peer("talker"))
    other = peer("other")
    other.do("advertise", topic=ear.topic)
    wait(lambda: ear.publishers == 2)
    ear.wait_for_messages()
    other.do("unadvertise", topic=ear.topic)
    wait(lambda: ear.publishers == 1)
    assert ear.turned_for_nothing() <= FEW * sum(ear.events.values())


def test_a_publisher_with_another_quality_of_service_costs_one_turn(
    runner: NodeRunner, peer: Start
) -> None:
    ear = Ear(runner, peer("talker"))
    peer("other").do("advertise", topic=ear.topic, reliability="best_effort")
    wait(lambda: ear.events["incompatible_qos"] == 1)
    assert ear.turned_for_nothing() <= FEW * sum(ear.events.values())


def test_a_deadline_that_is_missed_costs_one_turn_each(runner: NodeRunner, peer: Start) -> None:
    ear = Ear(runner, peer("talker"), Policies(depth=100, deadline=0.2), deadline=0.2)
    wait(lambda: ear.events["deadline"] >= 2)
    assert ear.turned_for_nothing() <= FEW * sum(ear.events.values())


def test_a_publisher_whose_lease_ends_costs_one_turn(runner: NodeRunner, peer: Start) -> None:
    policies = Policies(depth=100, liveliness="manual_by_topic", lease_duration=0.2)
    ear = Ear(runner, peer("talker"), policies, lease=0.2)
    before = ear.events["liveliness"]
    ear.wait_for_messages()
    wait(lambda: ear.events["liveliness"] > before)
    assert ear.turned_for_nothing() <= FEW * sum(ear.events.values())


def test_messages_that_are_lost_cost_one_turn_each(runner: NodeRunner, peer: Start) -> None:
    """Large ones in fragments, faster than sockets take them, with nothing sent again."""
    talker = peer("talker", FASTDDS_BUILTIN_TRANSPORTS="UDPv4")
    policies = Policies(reliability="best_effort", depth=5)
    ear = Ear(
        runner, talker, policies, native=IMAGE, kind="Image", reliability="best_effort", depth=5
    )

    def lost() -> bool:
        talker.do("publish", topic=ear.topic, first=1, count=50, size=2**20)
        return ear.events["message_lost"] > 0

    wait(lost)
    assert ear.turned_for_nothing() <= FEW * sum(ear.events.values())


def test_messages_in_fragments_cost_no_turn(runner: NodeRunner, peer: Start) -> None:
    talker = peer("talker", FASTDDS_BUILTIN_TRANSPORTS="UDPv4")
    ear = Ear(runner, talker, native=IMAGE, kind="Image")
    talker.do("publish", topic=ear.topic, first=1, count=20, size=2**20)
    ear.inbox.wait_for(22)
    assert ear.turned_for_nothing() <= FEW + FEW * sum(ear.events.values())


def test_the_guard_costs_no_turn_for_nothing(runner: NodeRunner) -> None:
    wait(lambda: runner.turns.all > 1)
    before = runner.turns.empty
    for _ in range(100):
        done = threading.Event()
        runner.call_soon(done.set)
        assert done.wait(patience())
    assert runner.turns.empty - before <= FEW


def test_a_service_and_its_client_cost_no_turn_for_nothing(runner: NodeRunner) -> None:
    server = runner.server(CALL, "/loop_call", lambda _, reply: reply(CALL.Response()))
    client = runner.client(CALL, "/loop_call")
    wait(client.service_is_ready)
    before = runner.turns.empty
    for _ in range(100):
        done = threading.Event()
        client.call_async(CALL.Request()).add_done_callback(lambda _, done=done: done.set())
        assert done.wait(patience())
    assert runner.turns.empty - before <= FEW
    runner.discard(client)
    runner.discard(server)


def test_an_action_and_its_timer_cost_no_turn_for_nothing(
    runner: NodeRunner, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The server's timer says when the result of a goal need not be kept any more."""
    monkeypatch.setattr(_actions, "_KEPT_SECONDS", 1)
    goals: list[Any] = []
    server = runner.goal_server(
        FIBONACCI, "/loop_action", goals.append, may_cancel=lambda _: True, cancel=goals.remove
    )
    client = runner.action_client(FIBONACCI, "/loop_action")
    wait(client.server_is_ready)
    before = runner.turns.empty
    accepted = client.send_goal_async(FIBONACCI.Goal(order=1))
    wait(lambda: goals)
    server.accept(goals[0])
    wait(accepted.done)
    ended = accepted.result().get_result_async()
    server.end(goals[0].id, "succeeded")
    wait(ended.done)
    wait(lambda: not server._goals)
    assert runner.turns.empty - before <= FEW
    runner.discard(client)
    runner.discard(server)


def test_many_that_are_opened_and_closed_leave_the_loop_its_time(
    runner: NodeRunner, monkeypatch: pytest.MonkeyPatch
) -> None:
    spans: list[float] = []

    class Slow(WaitSet):
        def __init__(self, *given: Any) -> None:
            began = time.monotonic()
            super().__init__(*given)
            threading.Event().wait(0.005)  # as with some thousand entities
            spans.append(time.monotonic() - began)

    monkeypatch.setattr(_loop, "WaitSet", Slow)
    began, topic = time.monotonic(), f"/loop_{next(_numbers)}"
    while len(spans) < 40:
        runner.discard(runner.subscribe(INT64, topic, Policies(), Inbox(), events={}))
    assert sum(spans) < 0.5 * (time.monotonic() - began)


def test_what_is_discarded_leaves_nothing_with_the_node(runner: NodeRunner) -> None:
    entities = runner.node.default_callback_group.entities
    before = len(entities)
    runner.discard(runner.subscribe(INT64, "/loop_gone", Policies(), Inbox(), events={}))
    runner.discard(runner.advertise(INT64, "/loop_gone", Policies(), events={}))
    runner.discard(runner.client(CALL, "/loop_gone_call"))
    runner.discard(runner.server(CALL, "/loop_gone_call", lambda _, reply: None))
    assert len(entities) == before


def test_what_ends_every_wait_and_is_never_taken_makes_the_loop_rest(
    runner: NodeRunner, peer: Start
) -> None:
    ear = Ear(runner, peer("talker"))
    entity = next(iter(runner._entities.values()))[0]
    entity.take = lambda: False  # type: ignore[method-assign]
    ear._talker.do("publish", topic=ear.topic, first=1, count=1)
    turns, began = runner.turns.empty, time.monotonic()
    wait(lambda: runner.turns.empty > turns + 20)
    in_a_row, seconds = runner.turns.empty - turns, time.monotonic() - began
    assert in_a_row <= 10 + seconds / 0.02


def test_the_bridge_says_how_often_it_turned_for_nothing(bridge: Bridge) -> None:
    facts = bridge.facts()
    assert set(facts) == {"empty_turns"}
    assert isinstance(facts["empty_turns"], int)
    bridge.close()
    assert set(bridge.facts()) == {"empty_turns"}
