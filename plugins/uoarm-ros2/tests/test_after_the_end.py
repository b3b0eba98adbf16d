"""What is still under way, or asked, when a bridge is closed or its context is ended for it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from typing import Any

import pytest
from peers import DOMAIN
from uoarm_ros2._actions import Action
from uoarm_ros2._discovery import Ros2Graph, discovered
from uoarm_ros2._middleware import GoalRequest, NodeRunner, Participant
from uoarm_ros2._qos import Policies
from uoarm_ros2._services import ServiceClient
from uoarm_ros2._types import import_type

from uoarm.errors import BridgeError, FailureReason
from uoarm.testing import Background, patience, wait

FIBONACCI = "test_msgs/action/Fibonacci"
SET_BOOL = "std_srvs/srv/SetBool"
ACTION: Any = import_type(FIBONACCI)
TEXT: Any = import_type("std_msgs/msg/String")


@pytest.fixture
def participant() -> Iterator[Participant]:
    made = Participant(DOMAIN, "")
    yield made
    made.close(patience())


@pytest.fixture
def runner(participant: Participant) -> NodeRunner:
    return participant.start_node("ending")


def server(runner: NodeRunner, ask: Callable[[GoalRequest], None]) -> Any:
    return runner.goal_server(
        ACTION, "/slow", ask, may_cancel=lambda _: True, cancel=lambda _: None
    )


@pytest.mark.parametrize("how", ["closed", "ended by others"])
def test_the_graph_of_a_node_that_has_ended_is_no_exception_of_rclpy(
    participant: Participant, runner: NodeRunner, how: str
) -> None:
    if how == "closed":
        participant.close(patience())
    else:
        participant._context.shutdown()  # as rclpy's signal handlers do
    for ask in (runner.publishers, runner.subscriptions, runner.servers, runner.has_server):
        with pytest.raises(BridgeError) as caught:
            ask("/anything")
        assert (caught.value.reason is FailureReason.CLOSED) is (how == "closed")
    for listing in (runner.services, runner.actions):
        with pytest.raises(BridgeError):
            listing()


@pytest.mark.parametrize(
    "ask",
    [
        lambda runner: runner.topic_name("relative"),
        lambda runner: runner.service_name("relative"),
        lambda runner: runner.topics(),
        lambda runner: runner.own_definition("/anything", SET_BOOL, object),
        lambda runner: runner.subscribe(TEXT, "/late", Policies(), print, events={}),
        lambda runner: runner.advertise(TEXT, "/late", Policies(), events={}),
        lambda runner: runner.client(import_type(SET_BOOL), "/late"),
        lambda runner: runner.server(import_type(SET_BOOL), "/late", print),
        lambda runner: runner.action_client(ACTION, "/late"),
        lambda runner: server(runner, print),
        lambda runner: discovered("ros", runner.node, frozenset(), no_structure),
    ],
)
def test_a_request_to_a_closed_node_says_so(
    participant: Participant, runner: NodeRunner, ask: Callable[[NodeRunner], object]
) -> None:
    assert runner.topic_name("relative") == runner.service_name("relative") == "/relative"
    participant.close(patience())
    assert runner.stop(patience())  # its thread has put everything away
    with pytest.raises(BridgeError, match="the bridge was closed") as caught:
        ask(runner)
    assert caught.value.reason is FailureReason.CLOSED


def no_structure(kind: str, topic: str) -> Any:
    raise AssertionError((kind, topic))


def test_a_closed_participant_starts_no_node(participant: Participant) -> None:
    participant.close(patience())
    with pytest.raises(BridgeError) as caught:
        participant.start_node("late")
    assert caught.value.reason is FailureReason.CLOSED


def test_a_node_that_starts_while_the_participant_closes_is_ended(
    participant: Participant, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[NodeRunner] = []

    def meanwhile(*given: Any) -> NodeRunner:
        made.append(NodeRunner(*given))
        participant.close(patience())
        return made[0]

    monkeypatch.setattr("uoarm_ros2._middleware._participant.NodeRunner", meanwhile)
    with pytest.raises(BridgeError, match="closed"):
        participant.start_node("late")
    assert made[0].stop(patience())


def test_the_client_of_an_action_does_not_keep_the_node_on_the_graph(
    participant: Participant,
) -> None:
    other = Participant(DOMAIN, "")
    try:
        runner = other.start_node("leaving")
        client = runner.action_client(ACTION, "/slow")
        names = participant.start_node("watching").node.get_fully_qualified_node_names
        wait(lambda: "/leaving" in names())
    finally:
        other.close(patience())
    wait(lambda: "/leaving" not in names())
    assert client is not None  # it is held all the time


def test_a_goal_whose_bridge_closes_in_mid_call_fails(
    participant: Participant, runner: NodeRunner
) -> None:
    asked, reports = threading.Event(), []

    def cancelling(cancel: Callable[[], object]) -> Any:
        reports.append(cancel)
        return nullcontext()

    taken = []

    def accept(request: GoalRequest) -> None:
        taken.append(goals.accept(request))
        asked.set()

    goals = server(runner, accept)
    action = Action(runner, Ros2Graph(runner, 0.0), "/slow", FIBONACCI)
    call = Background(lambda: action.call({"order": 3}, patience(), patience(), cancelling))
    wait(lambda: asked.is_set() and reports != [])
    participant.close(patience())
    with pytest.raises(BridgeError) as caught:
        call.result()
    assert caught.value.reason is FailureReason.CLOSED
    assert reports[0]() is False  # no server can be reached any more


def test_a_call_whose_bridge_closes_in_mid_call_fails(
    participant: Participant, runner: NodeRunner
) -> None:
    asked = threading.Event()
    runner.server(import_type(SET_BOOL), "/slow", lambda *_: asked.set())
    caller = ServiceClient(runner, Ros2Graph(runner, 0.0), "/slow", SET_BOOL)
    call = Background(lambda: caller.call({"data": True}, patience(), patience()))
    assert asked.wait(patience())
    participant.close(patience())
    with pytest.raises(BridgeError) as caught:
        call.result()
    assert caught.value.reason is FailureReason.CLOSED


@pytest.mark.parametrize("how", ["closed", "ended by others"])
def test_a_goal_that_ends_after_its_server_is_reported_to_no_client(
    participant: Participant, runner: NodeRunner, how: str
) -> None:
    accepted: list[GoalRequest] = []

    def accept(request: GoalRequest) -> None:
        goals.accept(request)
        accepted.append(request)

    goals = server(runner, accept)
    client = runner.action_client(ACTION, "/slow")
    wait(client.server_is_ready)
    client.send_goal_async(ACTION.Goal(order=3))
    wait(lambda: accepted != [])
    if how == "closed":
        participant.close(patience())
        goals.feed(accepted[0].id, ACTION.Feedback())
        goals.reject(accepted[0])
        goals.accept(accepted[0])
    else:
        participant._context.shutdown()
    goals.end(accepted[0].id, "aborted")
