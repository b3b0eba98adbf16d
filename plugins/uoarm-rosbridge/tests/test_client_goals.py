"""Actions through a server: those of actionlib as one call, and functions offered as actions."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
from played import STRING, Played, asked, bridge_to, typedef
from ros import Ros, Serve, url
from tests.server.talk import eventually  # type: ignore[import-not-found]
from uoarm_rosbridge.client import _calls
from websockets.sync.server import ServerConnection

from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm.model import Endpoint, Message, Role
from uoarm.testing import Background, ManualClock, patience

LONG = min(patience(), 60)
ADD = Endpoint("far", "add", Role.SERVICE, ("/add", "actionlib/TwoIntsAction"))
PREEMPTED, SUCCEEDED, ABORTED, LOST = 2, 3, 4, 9
ACTIVE, WALKED, CANCELED = 1, 4, 5

HEADER = typedef("std_msgs/Header", seq=("uint32", -1), stamp=("time", -1), frame_id=("string", -1))
ID = typedef("actionlib_msgs/GoalID", stamp=("time", -1), id=("string", -1))
STATUS = typedef(
    "actionlib_msgs/GoalStatus",
    goal_id=("actionlib_msgs/GoalID", -1), status=("uint8", -1), text=("string", -1),
)  # fmt: skip
TYPES: dict[str, list[dict[str, object]]] = {
    "actionlib/TwoIntsActionGoal": [
        typedef(
            "actionlib/TwoIntsActionGoal",
            header=("std_msgs/Header", -1), goal_id=("actionlib_msgs/GoalID", -1),
            goal=("actionlib/TwoIntsGoal", -1),
        ),
        HEADER, ID, typedef("actionlib/TwoIntsGoal", a=("int64", -1), b=("int64", -1)),
    ],
    "actionlib/TwoIntsActionResult": [
        typedef(
            "actionlib/TwoIntsActionResult",
            header=("std_msgs/Header", -1), status=("actionlib_msgs/GoalStatus", -1),
            result=("actionlib/TwoIntsResult", -1),
        ),
        HEADER, STATUS, ID, typedef("actionlib/TwoIntsResult", sum=("int64", -1)),
    ],
    "actionlib_msgs/GoalStatusArray": [
        typedef(
            "actionlib_msgs/GoalStatusArray",
            header=("std_msgs/Header", -1), status_list=("actionlib_msgs/GoalStatus", 0),
        ),
        HEADER, STATUS, ID,
    ],
    "actionlib_msgs/GoalID": [ID],
}  # fmt: skip
NEVER = {"seq": 0, "stamp": {"secs": 0, "nsecs": 0}, "frame_id": ""}


class Actionlib:
    """The topics of an action server behind a played rosbridge server.

    Args:
        played: the server.
        missed: goals that do not reach it at first, as topics are not connected yet.
    """

    def __init__(self, played: Played, missed: int = 0) -> None:
        self._played, self._missed = played, missed
        self.goals: dict[str, Any] = {}
        self.cancelled: list[str] = []
        self.on_goal: Callable[[str], None] = lambda identity: None
        played.answers |= {
            "message_details": lambda given: {"typedefs": TYPES[given["type"]]},
            "publishers": {"publishers": ["/adder"]}, "subscribers": {"subscribers": ["/adder"]},
        }  # fmt: skip
        played.on = self._on

    def status(self, *states: tuple[str, int]) -> None:
        listed = [self._status(identity, status) for identity, status in states]
        message = {"header": NEVER, "status_list": listed}
        self._played.say(op="publish", topic="/add/status", msg=message)

    def result(self, identity: str, status: int, value: int, text: str = "") -> None:
        message = {
            "header": NEVER, "status": self._status(identity, status, text),
            "result": {"sum": value},
        }  # fmt: skip
        self._played.say(op="publish", topic="/add/result", msg=message)

    @staticmethod
    def _status(identity: str, status: int, text: str = "") -> dict[str, object]:
        goal_id = {"stamp": {"secs": 0, "nsecs": 0}, "id": identity}
        return {"goal_id": goal_id, "status": status, "text": text}

    def _on(self, socket: ServerConnection, fields: Any) -> None:
        del socket
        if fields["op"] == "publish" and fields["topic"] == "/add/goal":
            if self._missed:
                self._missed -= 1
                return
            identity = fields["msg"]["goal_id"]["id"]
            is_new = identity not in self.goals
            self.goals[identity] = fields["msg"]
            if is_new:
                self.on_goal(identity)
        elif fields["op"] == "publish":
            assert fields["topic"] == "/add/cancel"
            self.cancelled.append(fields["msg"]["id"])


def test_five_topics_are_one_call(played: Played) -> None:
    server = Actionlib(played)

    def answer(identity: str) -> None:
        goal = server.goals[identity]["goal"]
        server.status((identity, ACTIVE))
        server.result(identity, SUCCEEDED, goal["a"] + goal["b"])

    server.on_goal = answer
    with bridge_to(played.url) as bridge:
        description: Any = bridge.describe(ADD)
        assert list(description.request.schema["properties"]) == ["a", "b"]
        assert list(description.reply.schema["properties"]) == ["sum"]
        for number in range(3):
            assert bridge.call(ADD, {"a": number, "b": 2}) == {"sum": number + 2}
    assert len({fields["topic"] for fields in asked(played, "subscribe")}) == 2
    assert len(asked(played, "subscribe")) == 2
    stamps = [goal["goal_id"]["stamp"] for goal in server.goals.values()]
    assert stamps == [{"secs": 1, "nsecs": 2}] * 3  # of the server's clock, which may be simulated


def test_a_goal_is_sent_until_its_server_knows_it_and_no_longer(played: Played) -> None:
    """Nothing says when topics are connected; an id is one goal, however often it comes."""
    server = Actionlib(played, missed=2)
    server.on_goal = lambda identity: server.status((identity, ACTIVE))
    with bridge_to(played.url) as bridge:
        calling = Background(lambda: bridge.call(ADD, {"a": 1, "b": 2}))
        eventually(lambda: server.goals, "the goal comes")
        (identity,) = server.goals
        sent = [fields for fields in asked(played, "publish") if fields["topic"] == "/add/goal"]
        assert {fields["msg"]["goal_id"]["id"] for fields in sent} == {identity}
        server.result(identity, SUCCEEDED, 3)
        assert calling.result() == {"sum": 3}


@pytest.mark.parametrize(
    ("status", "word"),
    [
        (PREEMPTED, "preempted"),
        (ABORTED, "aborted"),
        (5, "rejected"),
        (8, "recalled"),
        (LOST, "lost"),
    ],
)
def test_a_goal_that_fails_says_how(played: Played, status: int, word: str) -> None:
    server = Actionlib(played)
    server.on_goal = lambda identity: server.result(identity, status, 0, "it cannot")
    with (
        bridge_to(played.url) as bridge,
        pytest.raises(BridgeError, match=f"the goal was {word}: it cannot") as caught,
    ):
        bridge.call(ADD, {"a": 1, "b": 2})
    assert caught.value.reason is FailureReason.RAISED


def test_a_goal_that_is_given_up_is_cancelled(
    played: Played, monkeypatch: pytest.MonkeyPatch
) -> None:
    server, clock = Actionlib(played), ManualClock()

    def run_and_be_late(identity: str) -> None:
        server.status((identity, ACTIVE))
        clock.advance(0.1)

    server.on_goal = run_and_be_late
    monkeypatch.setattr(_calls, "time", SimpleNamespace(monotonic=clock))
    monkeypatch.setattr("uoarm.bridge._bridge._GRACE_SECONDS", patience())
    with bridge_to(played.url) as bridge:
        with pytest.raises(BridgeTimeoutError, match=r"no result within 0\.1 s"):
            bridge.call(ADD, {"a": 1, "b": 2}, timeout=0.1)
        eventually(lambda: server.cancelled == list(server.goals), "it is cancelled")


def test_a_goal_that_its_server_forgets_is_lost(played: Played) -> None:
    """A server that was started again publishes its status, without the goal."""
    server = Actionlib(played)

    def forget(identity: str) -> None:
        server.status((identity, ACTIVE))
        server.status()

    server.on_goal = forget
    with (
        bridge_to(played.url) as bridge,
        pytest.raises(BridgeError, match="its server does not know it any more") as caught,
    ):
        bridge.call(ADD, {"a": 1, "b": 2})
    assert caught.value.reason is FailureReason.UNAVAILABLE


def test_a_server_that_says_nothing_loses_its_goals(played: Played) -> None:
    server = Actionlib(played)
    server.on_goal = lambda identity: server.status((identity, ACTIVE))
    with (
        bridge_to(played.url, silence=0.5) as bridge,
        pytest.raises(BridgeError, match=r"no status for 0\.5 s"),
    ):
        bridge.call(ADD, {"a": 1, "b": 2})


def test_a_result_that_does_not_come_is_not_waited_for(played: Played) -> None:
    server = Actionlib(played)
    server.on_goal = lambda identity: server.status((identity, SUCCEEDED))
    with (
        bridge_to(played.url, wait=0.5) as bridge,
        pytest.raises(BridgeError, match="its result did not come"),
    ):
        bridge.call(ADD, {"a": 1, "b": 2})


def test_goals_end_with_the_connection_and_the_next_ones_pass(played: Played) -> None:
    server = Actionlib(played)
    with bridge_to(played.url, grace=LONG) as bridge:
        calling = Background(lambda: bridge.call(ADD, {"a": 1, "b": 2}))
        eventually(lambda: server.goals, "the goal comes")
        played.sockets[-1].close()
        with pytest.raises(BridgeError, match="the goal was lost"):
            calling.result()
        server.on_goal = lambda identity: server.result(identity, SUCCEEDED, 7)

        def passes() -> bool:
            try:
                reply = bridge.call(ADD, {"a": 1, "b": 2})
            except BridgeError:
                return False
            assert reply == {"sum": 7}
            return True

        eventually(passes, "a goal passes again")


def test_nonsense_on_the_topics_of_an_action_fails_its_goals(played: Played) -> None:
    server = Actionlib(played)
    server.on_goal = lambda _: played.say(op="publish", topic="/add/status", msg={"x": [1]})
    with (
        bridge_to(played.url) as bridge,
        pytest.raises(BridgeError, match="what the server sends cannot be read"),
    ):
        bridge.call(ADD, {"a": 1, "b": 2})


def test_an_action_without_a_server_is_named_and_its_coming_is_said(played: Played) -> None:
    Actionlib(played)
    played.answers["publishers"] = {"publishers": ["/another"]}
    with bridge_to(played.url) as bridge:
        events: list[object] = []
        bridge.watch(events.append)
        with pytest.raises(BridgeError, match="there is no server of action /add") as caught:
            bridge.describe(ADD)
        assert caught.value.reason is FailureReason.NOT_FOUND
        played.answers["publishers"] = {"publishers": ["/adder"]}
        eventually(lambda: events, "it is there")


WALK = ("/walk", "x_msgs/action/Walk")
OFFERED = Endpoint("far", "walk", Role.SERVICE, WALK, options={"at_once": 1}, is_offered=True)
GOAL = {"typedefs": [{**STRING, "type": "x_msgs/Walk_Goal"}]}
RESULT = {"typedefs": [{**STRING, "type": "x_msgs/Walk_Result"}]}


def goal(played: Played, identity: str, text: object) -> None:
    played.say(op="send_action_goal", action="/walk", id=identity, args={"data": text})


def results(played: Played) -> dict[str, tuple[object, int, bool]]:
    return {
        fields["id"]: (fields["values"], fields["status"], fields["result"])
        for fields in asked(played, "action_result")
    }


@pytest.mark.parametrize("is_described", [True, False])
def test_a_function_answers_goals(played: Played, is_described: bool) -> None:
    """rosbridge_suite 2.1.0 describes no actions: then what a function takes is as it comes."""
    if is_described:
        played.answers |= {"action_goal_details": GOAL, "action_result_details": RESULT}
    running, gate = threading.Event(), threading.Event()

    def walk(message: Any) -> Message:
        if message["data"] == "fail":
            raise ValueError("it cannot")
        if message["data"] == "wait":
            running.set()
            gate.wait(patience())
        return {"data": f"walked {message['data']}"}

    with bridge_to(played.url) as bridge:
        channel = bridge.serve(OFFERED, walk)
        (advertised,) = asked(played, "advertise_action")
        assert (advertised["action"], advertised["type"]) == WALK
        for identity, text in (("1", "far"), ("2", "fail"), ("3", "wait")):
            goal(played, identity, text)
        assert running.wait(patience())
        goal(played, "4", "late")
        played.say(op="cancel_action_goal", action="/walk", id="4")
        played.say(op="cancel_action_goal", action="/walk", id="nothing")
        eventually(lambda: "4" in results(played), "a goal that waits ends at once")
        played.say(op="cancel_action_goal", action="/walk", id="3")
        played.say(op="call_service", service="/none", id="x")  # what comes is taken in order
        goal(played, "5", "far")
        eventually(lambda: channel.facts()["waiting"] == 1, "the cancellation was taken")
        gate.set()
        eventually(lambda: len(results(played)) == 5, "all end")
        ended = results(played)
        assert "it cannot" in str(ended.pop("2"))
        assert ended == {
            "1": ({"data": "walked far"}, WALKED, True),
            "3": ({"data": "walked wait"}, CANCELED, True),
            "4": ({}, CANCELED, True),
            "5": ({"data": "walked far"}, WALKED, True),
        }
        if is_described:
            goal(played, "6", 7)
            eventually(lambda: "6" in results(played), "a goal that does not fit is refused")
            assert results(played)["6"][2] is False
        channel.close()
        eventually(lambda: asked(played, "unadvertise_action"), "it is offered no more")


def test_a_server_that_knows_no_actions_refuses_with_its_words(played: Played) -> None:
    def on(socket: ServerConnection, fields: Any) -> None:
        if fields["op"] == "advertise_action":
            text = "Unknown operation: advertise_action"
            status = {"op": "status", "level": "error", "msg": text, "id": fields["id"]}
            socket.send(json.dumps(status))

    played.on = on
    with (
        bridge_to(played.url) as bridge,
        pytest.raises(BridgeError, match="Unknown operation: advertise_action") as caught,
    ):
        bridge.serve(OFFERED, lambda message: message)
    assert caught.value.reason is FailureReason.REFUSED


def test_goals_of_clients_of_our_own_server_are_answered(serve: Serve) -> None:
    address = url(serve())
    with bridge_to(address) as bridge, Ros(address) as client:
        bridge.serve(OFFERED, lambda message: {"walked": message})
        client.send(op="send_action_goal", action="/walk", id="g", args={"far": 1})
        answer = client.receive()
        assert (answer["op"], answer["values"], answer["status"], answer["result"]) == (
            "action_result", {"walked": {"far": 1}}, WALKED, True,
        )  # fmt: skip
