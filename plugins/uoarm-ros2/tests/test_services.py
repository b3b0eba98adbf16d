"""Services and actions with the other end in another process, dead ends included."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from functools import partial
from types import SimpleNamespace
from typing import Any

import pytest
from endpoints import INT64, Make, Start, endpoint, known, sink, source
from messages import default_of
from peers import DOMAIN, MORTAL
from robots import HOSTED, robot
from tests.inbox import Inbox  # type: ignore[import-not-found]
from uoarm_ros2 import _services
from uoarm_ros2._actions import Action
from uoarm_ros2._discovery import Ros2Graph
from uoarm_ros2._middleware import GoalRequest, Participant
from uoarm_ros2._services import Disagreement, OtherServers, _reason_of, _with_disagreement, fitting
from uoarm_ros2._types import (
    ArrayType,
    RecordField,
    RecordType,
    ScalarType,
    Shape,
    StringType,
    import_type,
)

from uoarm import RobotManager
from uoarm.bridge import Bridge
from uoarm.errors import (
    BridgeError,
    BridgeTimeoutError,
    CommandRefusedError,
    FailureReason,
    MessageError,
)
from uoarm.model import Health, Role
from uoarm.testing import Background, ManualClock, patience, wait

BASIC = "test_msgs/srv/BasicTypes"
SET_BOOL = "std_srvs/srv/SetBool"
FIBONACCI = "test_msgs/action/Fibonacci"


def request(**fields: object) -> dict[str, Any]:
    native: Any = import_type(BASIC)
    return {**default_of(native.Request), **fields}


def service(*address: str, **options: Any) -> Any:
    return endpoint(Role.SERVICE, *address, **options)


def test_a_call_is_answered(make_bridge: Make, peer: Start) -> None:
    bridge, server = make_bridge(), peer("server")
    server.do("serve", name="/increment")
    found = bridge.describe(service("/increment"))
    assert found.request is not None
    assert found.reply is not None
    assert found.request.native_type == f"{BASIC}_Request"
    for number in (0, 2**62, -(2**63)):
        reply = bridge.call(service("/increment", BASIC), request(int64_value=number))
        assert reply["int64_value"] == number + 1
    asked = request(string_value="h\N{SNOWMAN}i")
    assert bridge.call(service("/increment", BASIC), asked)["string_value"] == "i\N{SNOWMAN}h"


def test_calls_overlap(bridge: Bridge, peer: Start) -> None:
    server = peer("server", "threads")
    server.do("serve", name="/slow", delay=0.2)

    def call(number: int) -> Any:
        return bridge.call(service("/slow", BASIC), request(int64_value=number))["int64_value"]

    calls = [Background(partial(call, number)) for number in range(4)]
    assert [call.result() for call in calls] == [1, 2, 3, 4]


def test_a_late_answer_is_a_time_out_and_harms_no_other_call(bridge: Bridge, peer: Start) -> None:
    server = peer("server")
    server.do("serve", name="/slow", delay=0.5)
    with pytest.raises(BridgeTimeoutError):
        bridge.call(service("/slow", BASIC), request(), timeout=0.3)
    assert bridge.call(service("/slow", BASIC), request(int64_value=4))["int64_value"] == 5


def test_a_server_that_is_killed_in_mid_call_ends_the_call(bridge: Bridge, peer: Start) -> None:
    peer("server", **MORTAL).do("die", name="/mortal")
    with pytest.raises(BridgeError, match="went away in mid-call") as caught:
        bridge.call(service("/mortal", BASIC), request())
    assert caught.value.reason is FailureReason.UNAVAILABLE


def test_what_cannot_be_called_says_why(bridge: Bridge, peer: Start) -> None:
    server = peer("server")
    server.do("serve", name="/here")
    with pytest.raises(BridgeError, match="no server of /nowhere") as caught:
        bridge.describe(service("/nowhere", BASIC))
    assert caught.value.reason is FailureReason.NOT_FOUND
    near = rf"no server of /heer on the graph of domain {DOMAIN}; did you mean '/here'\?"
    with pytest.raises(BridgeError, match=near):
        bridge.describe(service("/heer", BASIC))
    with pytest.raises(BridgeError, match=f"has type {BASIC}, not {SET_BOOL}"):
        bridge.describe(service("/here", SET_BOOL))
    with pytest.raises(MessageError, match=r"\$\.int64_value: expected an integer"):
        bridge.call(service("/here", BASIC), request(int64_value="1"))
    with pytest.raises(BridgeError, match="an output takes a type package/msg/Name"):
        bridge.describe(endpoint(Role.OUTPUT, "/here", BASIC))


def test_a_hasty_call_does_not_say_that_there_is_no_server(
    bridge: Bridge, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uoarm.bridge._bridge._GRACE_SECONDS", patience())
    hasty = service("/nowhere", BASIC)
    with pytest.raises(
        BridgeTimeoutError, match=r"a server of /nowhere was not seen within 0\.1 s"
    ):
        bridge.call(hasty, request(), timeout=0.2)
    with pytest.raises(BridgeError, match="no server of /nowhere"):
        bridge.call(hasty, request())


def test_ros_calls_what_we_serve(bridge: Bridge, peer: Start) -> None:
    client = peer("client")

    def handler(message: Any) -> Any:
        if not message["data"]:
            raise ValueError("off is not possible")
        return {"success": True, "message": "on"}

    events = Inbox(bridge)
    channel = bridge.serve(service("/switch", SET_BOOL), handler)
    answer = client.do("call", name="/switch", value=True)
    assert answer == {"success": True, "message": "on"}
    answer = client.do("call", name="/switch", value=False)
    assert answer == {"success": False, "message": "off is not possible"}
    assert events.event(Health.DEGRADED, "off is not possible").channel is channel
    # The client has its answer a moment before it is counted.
    wait(lambda: channel.facts() == {"answered": 1, "failed": 1, "refused": 0, "waiting": 0})
    assert client.do("call", name="/switch", value=True)["success"]
    assert events.event(Health.OK, "serving /switch: a message passed").channel is channel


def test_a_failure_whose_text_ros_2_cannot_carry_is_answered_all_the_same(
    bridge: Bridge, peer: Start
) -> None:
    client = peer("client")

    def handler(message: Any) -> Any:
        raise ValueError("no file \udcff\0, see above")

    bridge.serve(service("/switch", SET_BOOL), handler)
    answer = client.do("call", name="/switch", value=True)
    assert answer == {"success": False, "message": "no file \\udcff, see above"}


@pytest.mark.parametrize(
    ("success", "message", "wanted"),
    [
        ("bool", StringType(), "näh"),
        ("bool", StringType(bound=2), "n"),
        ("bool", StringType(wide=True, bound=2), "nä"),
        ("int32", StringType(), None),
        ("bool", ArrayType(StringType()), None),
        ("bool", RecordType("a/msg/B", object, (), {}), None),
    ],
)
def test_only_what_is_made_for_it_says_why_a_handler_failed(
    success: str, message: Shape, wanted: str | None
) -> None:
    """Another value than the type has ends the process."""
    fields = ("success", ScalarType(success)), ("message", message)
    members = tuple(RecordField(name, shape) for name, shape in fields)
    reason = _reason_of(RecordType("a/srv/B_Response", object, members, {}))
    assert (reason and fitting("näh", reason)) == wanted


@pytest.mark.parametrize("is_action", [False, True], ids=["service", "action"])
def test_another_server_of_what_we_serve_is_reported_while_it_is_there(
    bridge: Bridge, peer: Start, monkeypatch: pytest.MonkeyPatch, is_action: bool
) -> None:
    monkeypatch.setattr(_services, "_LEASE_SECONDS", 0.0)
    events = Inbox(bridge)
    name = "/moved" if is_action else "/increment"
    channel = bridge.serve(
        service(name, FIBONACCI if is_action else BASIC), lambda message: message
    )
    other = peer("other")
    other.do("act" if is_action else "serve", name=name)
    event = events.event(Health.DEGRADED, f"{name} is served by ")
    assert event.channel is channel
    other.end()
    assert events.event(Health.OK, f"{name} has no other server").channel is channel


def test_a_server_that_is_started_again_beside_what_is_left_of_it_is_no_other() -> None:
    reports: list[str] = []
    nodes = ["/us"]
    runner: Any = SimpleNamespace(
        server_count=lambda _: len(nodes),
        servers=lambda _: [SimpleNamespace(node=node) for node in nodes],
    )
    clock = ManualClock()
    others = OtherServers(
        runner, lambda: frozenset({"/us"}), "/x", "/x", lambda _, text: reports.append(text), clock
    )
    both = "/x is served by /it, too: clients take the reply that is first"
    for there, seconds, wanted in (
        (["/us"], 0.0, []),
        (["/us", "/us"], 29.0, []),
        (["/us"], 1.0, []),
        (["/us", "/it"], 29.0, []),
        (["/us", "/it"], 2.0, [both]),
        (["/us", "/it"], 99.0, [both]),
        (["/us"], 0.0, [both, "/x has no other server any more"]),
    ):
        nodes[:] = there
        others.tick()
        clock.advance(seconds)
        others.tick()
        assert reports == wanted


def test_what_cannot_be_served_says_so(bridge: Bridge) -> None:
    with pytest.raises(BridgeError, match="needs a type") as caught:
        bridge.serve(service("/x"), lambda message: message)
    assert caught.value.reason is FailureReason.UNSUPPORTED


def test_a_handler_may_call_and_a_receiver_may_call(bridge: Bridge, peer: Start) -> None:
    server, client, talker = peer("server"), peer("client"), peer("talker")
    server.do("serve", name="/increment")
    talker.do("advertise", topic="/numbers")
    inbox = Inbox()

    def ask(number: int) -> int:
        reply = bridge.call(service("/increment", BASIC), request(int64_value=number))
        return int(reply["int64_value"])

    source(
        bridge,
        endpoint(Role.OUTPUT, "/numbers", INT64),
        lambda message: inbox(ask(message["data"])),
    )
    assert talker.do("subscriptions", topic="/numbers", expected=1) == 1
    talker.do("publish", topic="/numbers", count=3)
    assert inbox.wait_for(3) == [2, 3, 4]
    bridge.serve(service("/switch", SET_BOOL), lambda _: {"success": True, "message": str(ask(40))})
    answer = client.do("call", name="/switch", value=True)
    assert answer["message"] == "41"


def test_requests_are_handled_at_once_as_many_as_the_option_says(
    bridge: Bridge, peer: Start
) -> None:
    """Each handler waits for the other one: one after the other, neither would ever answer."""
    together = threading.Barrier(2, timeout=patience())
    most, inside, lock = 0, 0, threading.Lock()

    def handle(_: object) -> dict[str, Any]:
        nonlocal most, inside
        with lock:
            inside += 1
            most = max(most, inside)
        together.wait()
        with lock:
            inside -= 1
        return {"success": True, "message": "met"}

    channel = bridge.serve(service("/meet", SET_BOOL, at_once=2), handle)
    clients = [peer(f"client_{number}") for number in range(4)]
    for client in clients:
        client.start("call", name="/meet", value=True)
    assert [client.receive()["message"] for client in clients] == ["met"] * 4
    assert most == 2
    # The client has its answer a moment before it is counted.
    wait(lambda: channel.facts() == {"answered": 4, "failed": 0, "refused": 0, "waiting": 0})


def test_an_action_is_a_call(make_bridge: Make, peer: Start) -> None:
    bridge, server = make_bridge(), peer("server", "threads")
    server.do("act", name="/fibonacci", period=0.01)
    found = bridge.describe(service("/fibonacci", FIBONACCI))
    assert found.request is not None
    assert isinstance(found.request.schema, Mapping)
    assert found.request.schema["required"] == ["order"]
    reply = bridge.call(service("/fibonacci", FIBONACCI), {"order": 6})
    assert list(reply["sequence"]) == [0, 1, 1, 2, 3, 5, 8]
    with pytest.raises(BridgeError, match="rejected the goal") as caught:
        bridge.call(service("/fibonacci", FIBONACCI), {"order": -1})
    assert caught.value.reason is FailureReason.REFUSED
    with pytest.raises(BridgeError, match="ended aborted"):
        bridge.call(service("/fibonacci", FIBONACCI), {"order": 13})


def test_an_action_that_is_given_up_is_cancelled(bridge: Bridge, peer: Start) -> None:
    server = peer("server", "threads")
    server.do("act", name="/fibonacci", period=0.05)
    bridge.call(service("/fibonacci", FIBONACCI), {"order": 2})  # it is known
    while server.do("goals_begun") == 1:  # one may be given up before it has begun
        with pytest.raises(BridgeTimeoutError):
            bridge.call(service("/fibonacci", FIBONACCI), {"order": 2000}, timeout=0.5)

    def are_cancelled() -> bool:
        first, *others = server.do("goal_ends")
        begun: int = server.do("goals_begun")
        return first == "completed" and len(others) == begun - 1

    wait(are_cancelled)
    assert set(server.do("goal_ends")[1:]) == {"canceled"}


def test_a_goal_that_is_accepted_after_its_call_was_given_up_is_cancelled() -> None:
    participant = Participant(DOMAIN, "")
    try:
        runner = participant.start_node("late")
        asked: list[GoalRequest] = []
        cancelled: list[bytes] = []
        goals = runner.goal_server(
            import_type(FIBONACCI),
            "/late",
            asked.append,
            may_cancel=lambda _: True,
            cancel=cancelled.append,
        )
        action = Action(runner, Ros2Graph(runner, 0.0), "/late", FIBONACCI)
        action.wait(patience())
        with pytest.raises(BridgeTimeoutError, match="did not answer in time"):
            action.call({"order": 3}, 0.1, 0.1, lambda _: nullcontext())
        wait(lambda: asked != [])
        goals.accept(asked[0])
        wait(lambda: cancelled == [asked[0].id])
    finally:
        participant.close(patience())


def reaching(*, is_hosted: bool) -> RobotManager:
    """A robot whose arm moves by an action."""
    options = f"endpoint: [/fibonacci, {FIBONACCI}], lifetime: 3600"
    reach = f"  reach: {{components: [{{name: arm, bridge: ros, service: {{{options}}}}}]}}"
    return robot(reach, host=HOSTED if is_hosted else "")


@pytest.mark.parametrize("is_hosted", [False, True])
def test_an_action_that_an_emergency_stop_ends_is_cancelled(
    peer: Start, *, is_hosted: bool
) -> None:
    server = peer("server", "threads")
    server.do("act", name="/fibonacci", period=0.05)
    with reaching(is_hosted=is_hosted) as manager:
        limit = 2 * patience()
        calling = Background(partial(manager.call, "reach", {"order": 2000}, timeout=limit))
        server.do("goal_begun")
        (outcome,) = manager.stop_all().inputs
        with pytest.raises(CommandRefusedError, match="the emergency stop cancelled the call"):
            calling.result()
        assert (outcome.component, outcome.stopped) == ("arm", True)
    assert server.do("goal_ends") == ["canceled"]


@pytest.mark.parametrize("is_hosted", [False, True])
def test_an_emergency_stop_cancels_a_goal_as_soon_as_it_is_accepted(
    peer: Start, *, is_hosted: bool
) -> None:
    server = peer("server", "threads")
    server.do("act", name="/fibonacci", period=0.05, gated=True)
    with reaching(is_hosted=is_hosted) as manager:
        limit = 4 * patience()
        calling = Background(partial(manager.call, "reach", {"order": 2000}, timeout=limit))
        assert server.do("goal_asked")

        def is_cancelled() -> bool:  # no goal ends before it is accepted; a host may answer later
            (outcome,) = manager.stop_all(timeout=0.5).inputs
            assert (outcome.component, outcome.stopped) == ("arm", False)
            return "was cancelled, and has not ended yet" in outcome.cause

        wait(is_cancelled)
        server.do("accept_goals")
        assert server.do("goal_ends") == ["canceled"]
        with pytest.raises(CommandRefusedError, match="the emergency stop cancelled the call"):
            calling.result()


def test_a_goal_that_is_cancelled_before_it_is_sent_is_never_sent() -> None:
    participant = Participant(DOMAIN, "")
    try:
        runner = participant.start_node("early")
        asked: list[GoalRequest] = []
        runner.goal_server(
            import_type(FIBONACCI),
            "/early",
            asked.append,
            may_cancel=lambda _: True,
            cancel=lambda _: None,
        )
        action = Action(runner, Ros2Graph(runner, 0.0), "/early", FIBONACCI)

        def cancelling(cancel: Callable[[], object]) -> Any:
            assert cancel() is True  # as for a call that was cancelled before
            return nullcontext()

        with pytest.raises(BridgeError, match="cancelled before it was sent") as caught:
            action.call({"order": 3}, patience(), patience(), cancelling)
        assert caught.value.reason is FailureReason.REFUSED
        action.send({"order": 4}, object())  # the first that comes
        wait(lambda: asked != [])
        assert [goal_request.goal.order for goal_request in asked] == [4]
    finally:
        participant.close(patience())


def test_an_action_is_four_streams(make_bridge: Make, peer: Start) -> None:
    bridge, server = make_bridge(), peer("server", "threads")
    server.do("act", name="/fibonacci", period=0.02)
    feedback, results, statuses = Inbox(), Inbox(), Inbox()
    for part, inbox in (("feedback", feedback), ("result", results), ("status", statuses)):
        source(bridge, endpoint(Role.OUTPUT, "/fibonacci", FIBONACCI, port=part), inbox)
    goal = sink(bridge, endpoint(Role.INPUT, "/fibonacci", FIBONACCI, port="goal"))
    cancel = sink(bridge, endpoint(Role.INPUT, "/fibonacci", FIBONACCI, "cancel"))
    goal.send({"order": 5})
    ended = results.wait_for(1)[0]
    assert ended["status"] == "succeeded"
    assert list(ended["result"]["sequence"]) == [0, 1, 1, 2, 3, 5]
    reports = feedback.wait_for(4)  # a topic of its own: the result may be here before the last
    assert [len(report["feedback"]["sequence"]) for report in reports] == [3, 4, 5, 6]
    assert {report["goal_id"] for report in reports} == {ended["goal_id"]}
    goal.send({"order": 1000})
    accepted = statuses.wait_until(
        lambda item: item["status"] == "accepted" and item["goal_id"] != ended["goal_id"]
    )
    cancel.send({"goal_id": accepted["goal_id"]})
    assert results.wait_for(2)[1]["status"] == "canceled"
    goal.send({"order": -1})
    assert statuses.wait_until(lambda item: item["status"] == "rejected")
    with pytest.raises(MessageError, match=r"\$\.order: expected an integer"):
        goal.send({"order": "five"})


def test_goals_whose_input_closes_are_cancelled_and_those_of_another_go_on(
    bridge: Bridge, peer: Start
) -> None:
    """No one is left who could cancel them: what they move stops."""
    server = peer("server", "threads")
    server.do("act", name="/fibonacci", period=0.05)
    at = partial(endpoint, Role.INPUT, "/fibonacci", FIBONACCI, port="goal")
    left, staying = sink(bridge, at()), sink(bridge, at())
    staying.send({"order": 2000})
    server.do("goal_begun")
    left.send({"order": 2000})
    left.close()  # also where it is not accepted yet
    assert server.do("goal_ends") == ["canceled"]
    staying.close()
    wait(lambda: server.do("goal_ends") == ["canceled", "canceled"])


def test_goals_of_a_killed_server_are_lost(bridge: Bridge, peer: Start) -> None:
    events, statuses = Inbox(bridge), Inbox()
    server = peer("server", "threads", **MORTAL)
    server.do("act", name="/fibonacci")
    channel = source(bridge, endpoint(Role.OUTPUT, "/fibonacci", FIBONACCI, "status"), statuses)
    goal = sink(bridge, endpoint(Role.INPUT, "/fibonacci", FIBONACCI))
    goal.send({"order": 1000})
    statuses.wait_until(lambda item: item["status"] == "accepted")
    server.kill()
    assert statuses.wait_until(lambda item: item["status"] == "lost")
    assert events.event(Health.LOST, "action /fibonacci: its server is gone").channel is channel


def looks(bridge: Bridge, monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """Note which threads look who serves: that of a call does before it has waited for long."""
    graph, looked = bridge._graph, set[str]()  # type: ignore[attr-defined]
    servers = graph.servers

    def look(name: str) -> frozenset[bytes]:
        found: frozenset[bytes] = servers(name)
        looked.add(threading.current_thread().name)
        return found

    monkeypatch.setattr(graph, "servers", look)
    return looked


def test_goals_of_a_server_that_another_one_replaces_are_lost(
    bridge: Bridge, peer: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    """There is a server all the time: who is killed is forgotten when the next one is known."""
    statuses = Inbox()
    server, successor = peer("server", "threads", **MORTAL), peer("successor", "threads")
    server.do("act", name="/fibonacci")
    source(bridge, endpoint(Role.OUTPUT, "/fibonacci", FIBONACCI, "status"), statuses)
    goal = sink(bridge, endpoint(Role.INPUT, "/fibonacci", FIBONACCI))
    goal.send({"order": 100_000})
    statuses.wait_until(lambda item: item["status"] == "accepted")
    looked = looks(bridge, monkeypatch)
    at = service("/fibonacci", FIBONACCI)
    calling = Background(partial(bridge.call, at, {"order": 100_000}, timeout=1e6))
    wait(lambda: server.do("goals_begun") == 2)
    wait(lambda: looked - {"ros2 uoarm_ros"})
    successor.do("act", name="/fibonacci")
    graph = bridge._graph  # type: ignore[attr-defined]  # of DDS
    wait(lambda: len(graph.servers("/fibonacci/_action/send_goal")) == 2)
    server.kill()
    assert statuses.wait_until(lambda item: item["status"] == "lost")
    with pytest.raises(BridgeError, match="went away in mid-call"):
        calling.result()
    goal.send({"order": 3})
    assert statuses.wait_until(lambda item: item["status"] == "succeeded")


def test_a_goal_that_was_not_answered_when_its_server_died_is_lost(
    bridge: Bridge, peer: Start
) -> None:
    statuses = Inbox()
    server = peer("server", "threads", **MORTAL)
    server.do("act", name="/fibonacci", gated=True)
    source(bridge, endpoint(Role.OUTPUT, "/fibonacci", FIBONACCI, "status"), statuses)
    goal = sink(bridge, endpoint(Role.INPUT, "/fibonacci", FIBONACCI))
    goal.send({"order": 3})
    server.do("goal_asked")
    server.kill()
    (lost,) = statuses.wait_for(1)
    assert lost["status"] == "lost"
    assert len(bytes.fromhex(lost["goal_id"])) == 16


def test_a_call_whose_server_another_one_replaces_ends(
    bridge: Bridge, peer: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    server, successor = peer("server", **MORTAL), peer("successor")
    server.do("serve", name="/slow", delay=1e6)
    looked = looks(bridge, monkeypatch)
    calling = Background(partial(bridge.call, service("/slow", BASIC), request(), timeout=1e6))
    assert server.do("request_begun")
    wait(lambda: looked - {"ros2 uoarm_ros"})
    successor.do("serve", name="/slow")
    graph = bridge._graph  # type: ignore[attr-defined]  # of DDS
    wait(lambda: len(graph.servers("/slow")) == 2)
    server.kill()
    with pytest.raises(BridgeError, match="service /slow went away in mid-call"):
        calling.result()


class EarlyAnswers:
    """A client's handle that has sent only when the answer has been taken, or will not be."""

    def __init__(self, handle: Any) -> None:
        self._handle = handle
        self._taken = {"goal": threading.Event(), "result": threading.Event()}

    def __getattr__(self, name: str) -> Any:
        did = getattr(self._handle, name)
        verb, _, rest = name.partition("_")
        taken = self._taken.get(rest.partition("_")[0])
        if verb not in {"send", "take"} or taken is None:
            return did

        def do(*given: Any) -> Any:
            done = did(*given)
            if verb == "send":
                taken.wait(2)
            elif all(done):
                taken.set()
            return done

        return do


def test_an_answer_that_comes_while_its_goal_is_sent_is_not_thrown_away() -> None:
    participant = Participant(DOMAIN, "")
    try:
        runner, replies = participant.start_node("serving"), participant.start_node("asking")
        native: Any = import_type(FIBONACCI)

        def accept(asked: GoalRequest) -> None:
            server.accept(asked)
            server.end(asked.id, "succeeded", native.Result(sequence=[7]))

        server = runner.goal_server(
            native, "/early", accept, may_cancel=lambda _: True, cancel=lambda _: None
        )
        action = Action(replies, Ros2Graph(replies, 0.0), "/early", FIBONACCI)
        client: Any = action._client
        wait(action.ready)
        client._client_handle = EarlyAnswers(client._client_handle)
        given = action.call({"order": 3}, patience(), patience(), lambda _: nullcontext())
        assert [*given["sequence"]] == [7]
    finally:
        participant.close(patience())


def test_the_graph_is_discovered_without_predefining(bridge: Bridge, peer: Start) -> None:
    robot = peer("robot", "threads")
    robot.do("advertise", topic="/numbers")
    robot.do("subscribe", topic="/speed")
    robot.do("serve", name="/increment")
    robot.do("act", name="/fibonacci")
    known(bridge, "/robot")
    (found,) = (component for component in bridge.discover() if component.name == "/robot")
    seen = {at.address: (at.role, what) for at, what in found.endpoints}
    assert seen["/numbers", INT64][0] is Role.OUTPUT
    assert (
        seen["/numbers", INT64][1].message
        == bridge.describe(endpoint(Role.OUTPUT, "/numbers", INT64)).message
    )
    assert seen["/speed", INT64][0] is Role.INPUT
    assert seen["/increment", BASIC][0] is Role.SERVICE
    assert seen["/increment", BASIC][1].request is not None
    assert seen["/fibonacci", FIBONACCI][1].reply is not None
    assert not any("_action" in address[0] for address in seen)


def test_nodes_that_come_and_go_are_events(bridge: Bridge, peer: Start) -> None:
    events = Inbox(bridge)
    visitor = peer("visitor", **MORTAL)
    assert events.event(Health.OK, "node /visitor appeared").component == "/visitor"
    visitor.kill()
    assert events.event(Health.LOST, "node /visitor left").component == "/visitor"


@pytest.mark.parametrize("otherwise", ["", "service /x is not the same everywhere: /b has X"])
def test_who_did_not_answer_may_mean_something_else(otherwise: str) -> None:
    late = BridgeTimeoutError("service /x did not answer in time")
    agreement: Any = SimpleNamespace(look=lambda: Disagreement(otherwise))
    assert str(_with_disagreement(late, agreement)) == f"{late}{otherwise and '; '}{otherwise}"
