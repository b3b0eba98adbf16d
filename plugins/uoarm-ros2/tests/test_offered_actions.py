"""Functions of another framework that are ROS 2 actions, with an unmodified client of rclpy."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import pytest
from endpoints import Make
from peers import DOMAIN, Peer
from tests.structures import closed  # type: ignore[import-not-found]

from uoarm import RobotManager
from uoarm.bridge import Bridge
from uoarm.config import loads
from uoarm.model import Endpoint, OfferState, Role
from uoarm.testing import Background, MemoryBridge, patience, wait

numbers = itertools.count()
FIBONACCI = "test_msgs/action/Fibonacci"
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6
CANCEL_REJECTED = 1


INTEGER = {"type": "integer", "minimum": -(2**31), "maximum": 2**31 - 1}
TEXT = {"type": "string"}
SEQUENCE = closed(sequence={"type": "array", "items": INTEGER})
STATES = {"type": "string", "enum": ["accepted", "rejected", "succeeded", "canceled", "aborted"]}
PORTS = {
    "goal": closed(order=INTEGER),
    "cancel": closed(goal_id=TEXT),
    "status": closed(goal_id=TEXT, status=STATES),
    "feedback": closed(goal_id=TEXT, feedback=SEQUENCE),
    "result": closed(goal_id=TEXT, status=STATES, result=SEQUENCE),
}
INPUTS = ("goal", "cancel")
ROBOT = """
version: 1
bridges: {{ros: {{plugin: ros2}}, one: {{plugin: memory}}}}
functions:
  count:
    components:
      - name: best
        bridge: one
        priority: 2
        inputs: {{goal: {{endpoint: [best_goal]}}, cancel: {{endpoint: [best_cancel]}}}}
        outputs: {{status: {{endpoint: [best_status]}}, feedback: {{endpoint: [best_feedback]}},
                  result: {{endpoint: [best_result]}}}}
      - name: next
        bridge: one
        priority: 1
        inputs: {{goal: {{endpoint: [next_goal]}}, cancel: {{endpoint: [next_cancel]}}}}
        outputs: {{status: {{endpoint: [next_status]}}, feedback: {{endpoint: [next_feedback]}},
                  result: {{endpoint: [next_result]}}}}
failover: {{limit: 1000}}
offer:
  ros:
    count:
      inputs: {{goal: &at {{endpoint: [{name}, test_msgs/action/Fibonacci]}}{cancel}}}
      outputs: {{status: *at, feedback: *at, result: *at}}
"""


class Counter:
    """A component that counts as its goals ask, when and as the test says."""

    def __init__(self, bridge: MemoryBridge, name: str) -> None:
        self._bridge = bridge
        self._name = name
        self.make()

    def make(self) -> None:
        self.begun = self.cancelled = 0
        self._outputs: dict[str, Any] = {}
        self._inputs: dict[str, Any] = {}
        for port, schema in PORTS.items():
            made = self._bridge.taker if port in INPUTS else self._bridge.emitter
            ports = self._inputs if port in INPUTS else self._outputs
            ports[port] = made(f"{self._name}_{port}", schema)

    def die(self) -> None:
        for port in PORTS:
            self._bridge.die(f"{self._name}_{port}")

    def taken(self, port: str) -> list[Any]:
        messages: list[Any] = self._inputs[port].taken.messages
        return messages

    def took(self, port: str, count: int) -> Any:
        return self._inputs[port].taken.wait(count)[count - 1]

    def status(self, name: str, status: str) -> None:
        self._outputs["status"].emit({"goal_id": name, "status": status})

    def feed(self, name: str, *numbers: int) -> None:
        wait(self._outputs["feedback"].channels)
        reports = {"goal_id": name, "feedback": {"sequence": list(numbers)}}
        self._outputs["feedback"].emit(reports)

    def end(self, name: str, status: str, *numbers: int) -> None:
        """Give the result, and how it ended; after a takeover each output is opened for itself."""
        wait(self._outputs["result"].channels)
        result = {"sequence": list(numbers)}
        self._outputs["result"].emit({"goal_id": name, "status": status, "result": result})
        self.status(name, status)


def meet(ros: Any, client: Peer, name: str) -> None:
    """Have a client meet a server, and the server the client: else its first answers are lost."""
    assert client.do("meet", name=name)
    node = ros._runner.node
    for service in ("send_goal", "cancel_goal", "get_result"):
        topic = f"rr{name}/_action/{service}Reply"
        wait(partial(node.get_subscriptions_info_by_topic, topic, no_mangle=True))


class Stage:
    """A robot that offers `count`, and an ordinary client of the action."""

    def __init__(self, ros: Bridge, client: Peer, *, cancel: bool = True) -> None:
        memory = MemoryBridge("one")
        self.best, self.next = Counter(memory, "best"), Counter(memory, "next")
        self.name = f"/count_{next(numbers)}"  # its own: the client has met those before
        text = ROBOT.format(name=self.name, cancel=", cancel: *at" if cancel else "")
        self.robot = RobotManager(loads(text), bridges={"ros": ros, "one": memory})
        self.client = client
        self.robot.offer()
        wait(lambda: self.state() is OfferState.OPEN)
        meet(ros, client, self.name)

    def state(self) -> OfferState:
        return self.robot.status().offers[0].state

    def pursue(self, counter: Counter, name: str, count: int = 1, order: int = 5) -> int:
        """Have the client send its goal, and the counter accept it under a name of its own."""
        self.client.start("pursue", name=self.name, order=order)
        assert counter.took("goal", count) == {"order": order}
        counter.status(name, "accepted")
        answer = self.client.receive()
        assert answer["accepted"]
        goal: int = answer["goal"]
        return goal

    def outcome(self, goal: int) -> tuple[int, list[int]]:
        answer = self.client.do("outcome", goal=goal)
        return answer["status"], answer["sequence"]


@pytest.fixture(scope="module")
def client() -> Iterator[Peer]:
    started = Peer("client", {"ROS_DOMAIN_ID": str(DOMAIN)})
    yield started
    started.end()


@pytest.fixture
def stage(make_bridge: Make, client: Peer) -> Iterator[Callable[..., Stage]]:
    made: list[Stage] = []

    def make(**how: Any) -> Stage:
        made.append(Stage(make_bridge(), client, **how))
        return made[-1]

    yield make
    for item in made:
        item.robot.close()


def test_goals_run_side_by_side_with_feedback_and_each_has_its_result(
    stage: Callable[..., Stage],
) -> None:
    there = stage()
    goals = [there.pursue(there.best, f"goal {number}", number) for number in (1, 2)]
    for number in (1, 2):
        there.best.feed(f"goal {number}", number)
        there.best.feed(f"goal {number}", number, number)
    for number, goal in enumerate(goals, 1):
        steps = there.client.do("feedback", goal=goal, expected=2)
        assert steps == [[number], [number, number]]
    there.best.end("goal 2", "succeeded", 2, 2, 2)
    there.best.end("goal 1", "aborted", 1)
    assert there.outcome(goals[1]) == (SUCCEEDED, [2, 2, 2])
    assert there.outcome(goals[0]) == (ABORTED, [1])


def test_a_goal_is_rejected_or_cancelled(stage: Callable[..., Stage]) -> None:
    there = stage()
    there.client.start("pursue", name=there.name, order=-1)
    there.best.took("goal", 1)
    there.best.status("goal 1", "rejected")
    assert not there.client.receive()["accepted"]
    goal = there.pursue(there.best, "goal 2", 2)
    assert there.client.do("give_up", goal=goal) == {"canceling": 1, "code": 0}
    assert there.best.took("cancel", 1) == {"goal_id": "goal 2"}
    there.best.end("goal 2", "canceled", 7)
    assert there.outcome(goal) == (CANCELED, [7])


def test_a_function_may_cancel_a_goal_by_itself(stage: Callable[..., Stage]) -> None:
    there = stage(cancel=False)
    goal = there.pursue(there.best, "goal")
    refused = {"canceling": 0, "code": CANCEL_REJECTED}
    assert there.client.do("give_up", goal=goal) == refused
    there.best.end("goal", "canceled")
    assert there.outcome(goal) == (CANCELED, [])


def test_goals_of_a_provider_that_dies_are_aborted_and_the_next_one_takes_others(
    stage: Callable[..., Stage],
) -> None:
    there = stage()
    goal = there.pursue(there.best, "goal")
    there.client.start("pursue", name=there.name, order=5)
    there.best.took("goal", 2)
    there.best.die()
    assert not there.client.receive()["accepted"]
    assert there.outcome(goal) == (ABORTED, [])
    goal = there.pursue(there.next, "goal")
    there.next.end("goal", "succeeded", 1)
    assert there.outcome(goal) == (SUCCEEDED, [1])


def test_goals_are_aborted_when_their_provider_is_gone(stage: Callable[..., Stage]) -> None:
    there = stage()
    there.next.die()
    goal = there.pursue(there.best, "goal")
    there.best.die()
    assert there.outcome(goal) == (ABORTED, [])
    wait(lambda: there.state() is not OfferState.OPEN)


class Work:
    """Works on all goals as they come, and has their provider die with what it has in hand."""

    def __init__(self, counters: tuple[Counter, Counter], goals_in_a_life: int) -> None:
        self.deaths = 0
        self._counters = counters
        self._life = goals_in_a_life
        self._over = threading.Event()
        self._thread = Background(self._run)

    def end(self) -> None:
        self._over.set()
        self._thread.result(patience())

    def _run(self) -> None:
        taken = 0
        while not self._over.wait(0.001):
            for counter in self._counters:
                goals, cancels = counter.taken("goal"), counter.taken("cancel")
                for number in range(counter.begun, len(goals)):
                    taken += 1
                    self._begin(counter, number, goals[number]["order"])
                counter.begun = len(goals)
                for cancel in cancels[counter.cancelled :]:
                    counter.end(cancel["goal_id"], "canceled")
                counter.cancelled = len(cancels)
                if taken >= self._life:
                    taken = 0
                    self.deaths += 1
                    counter.die()
                    counter.make()

    def _begin(self, counter: Counter, number: int, order: int) -> None:
        name = f"goal {self.deaths}.{number}"
        counter.status(name, "rejected" if order % 50 == 7 else "accepted")
        if order % 50 != 7 and order % 5 != 4:
            counter.feed(name, order)
            counter.end(name, "aborted" if order % 50 == 8 else "succeeded", order)


@pytest.mark.long
def test_each_of_a_thousand_goals_ends_whatever_dies(stage: Callable[..., Stage]) -> None:
    there = stage()
    work = Work((there.best, there.next), goals_in_a_life=40)
    try:
        ends = there.client.do("pursue_many", name=there.name, count=1000, at_once=8)
    finally:
        work.end()
    assert sum(ends.values()) == 1000
    assert work.deaths >= 20
    assert ends[str(SUCCEEDED)] > 500
    assert {"0", str(CANCELED), str(ABORTED)} <= set(ends)


def test_a_service_is_an_action_without_feedback(bridge: Bridge, client: Peer) -> None:
    entered, leave = threading.Event(), threading.Event()

    def count(goal: Any) -> Any:
        entered.set()
        assert leave.wait(patience())
        if goal["order"] < 0:
            raise ValueError("cannot count backwards")
        return {"sequence": list(range(goal["order"]))}

    at = Endpoint("ros", "offer", Role.SERVICE, ("/served", FIBONACCI), is_offered=True)
    channel = bridge.serve(at, count)
    meet(bridge, client, "/served")
    first = client.do("pursue", name="/served", order=3)
    assert entered.wait(patience())
    refused = {"canceling": 0, "code": CANCEL_REJECTED}
    assert client.do("give_up", goal=first["goal"]) == refused
    leave.set()
    second = client.do("pursue", name="/served", order=-1)
    ends = [client.do("outcome", goal=item["goal"]) for item in (first, second)]
    assert ends == [
        {"status": SUCCEEDED, "sequence": [0, 1, 2]},
        {"status": ABORTED, "sequence": []},
    ]
    # The client has its answer a moment before it is counted.
    wait(lambda: channel.facts() == {"answered": 1, "failed": 1, "refused": 0, "waiting": 0})
