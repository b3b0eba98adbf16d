"""Services, actions, parameters and discovery with real nodes of rospy and actionlib."""

from __future__ import annotations

import threading
from contextlib import closing
from typing import Any

import pytest
from endpoints import bridge_to, input_, output, service
from peers import Master, Peer
from tests.inbox import Inbox  # type: ignore[import-not-found]
from tests.no_threads import no_threads  # type: ignore[import-not-found]
from uoarm_ros1 import _bridge, _master, _node, _subscription
from uoarm_ros1._master import call_api

from uoarm.bridge import ServiceStructures
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, MessageError
from uoarm.model import Health, MessageStructure, Role
from uoarm.testing import Background, Collector, ResourceSnapshot, patience, slowness, wait

SET = "std_srvs/SetBool"
ADD = "actionlib/TwoIntsAction"
OURS = {"success": True, "message": "ours"}
ANY = MessageStructure(True)


def test_a_service_is_described_by_what_its_server_says(master: Master, lasting: Peer) -> None:
    lasting.do("serve", service="/set", type=SET)
    with bridge_to(master) as bridge:
        described: Any = bridge.describe(service("/set"))
        assert described.request.native_type == "std_srvs/SetBoolRequest"
        reply = bridge.call(service("/set"), {"data": True})
        assert reply == {"success": True, "message": "data is True"}
        with pytest.raises(MessageError, match=r"\$\.data: expected true or false"):
            bridge.call(service("/set"), {"data": 1})
        with pytest.raises(BridgeError, match="is served as std_srvs/SetBool"):
            bridge.describe(service("/set", "std_srvs/Trigger"))


def test_a_service_of_another_definition_is_refused_with_both_sums(
    master: Master, lasting: Peer
) -> None:
    lasting.do("serve", service="/summed", type=SET)
    with bridge_to(master) as bridge:
        at = service("/summed", SET, definition="bool data\n---\nbool success\n")
        with pytest.raises(BridgeError, match="09fb03525b03e7ea1fd3992bafd87e16"):
            bridge.describe(at)


def test_a_service_without_a_server_is_named_and_its_coming_is_said(master: Master) -> None:
    with bridge_to(master) as bridge:
        reports = Inbox(bridge)
        with pytest.raises(BridgeError, match="no node serves /nowhere") as caught:
            bridge.describe(service("/nowhere"))
        assert caught.value.reason is FailureReason.NOT_FOUND
        peer = master.peer("coming")
        wait(lambda: bridge._lost._seen, "it is not looked for")  # type: ignore[attr-defined]
        # A look that finds no node comes first: what was there before is no return.
        lost: Any = bridge
        wait(
            lambda: lost._lost._seen[("nowhere", "services", "/nowhere")] is not None,
            "it was not looked for",
        )
        peer.do("serve", service="/nowhere", type=SET)
        assert reports.event(Health.OK, "/nowhere").component == "nowhere"
        assert bridge.describe(service("/nowhere")).request is not None
        peer.kill()


def test_a_server_that_was_started_again_is_called_again(master: Master) -> None:
    first = master.peer("serving")
    first.do("serve", service="/again", type=SET)
    with bridge_to(master) as bridge:
        at = service("/again")
        assert bridge.call(at, {"data": True})["success"]
        first.kill()
        with pytest.raises(BridgeError) as caught:
            bridge.call(at, {"data": True})
        assert caught.value.reason is FailureReason.UNAVAILABLE
        second = master.peer("serving")
        second.do("serve", service="/again", type=SET)
        assert bridge.call(at, {"data": False})["message"] == "data is False"
        second.kill()


class Quits(dict[str, Any]):
    """A reply that ends whatever thread writes it."""

    def items(self) -> Any:
        raise SystemExit

    __getitem__ = __iter__ = items  # type: ignore[assignment]


def test_what_gets_no_thread_is_refused_and_leaves_nothing(master: Master, lasting: Peer) -> None:
    before = ResourceSnapshot()
    refused = pytest.raises(BridgeError, match="can't start new thread")
    with no_threads("uoarm-ros1-watch"), refused, bridge_to(master):
        pass
    before.check()
    lasting.do("advertise", topic="/threads", type="std_msgs/String")
    with bridge_to(master) as bridge:
        at, inbox = output("/threads"), Collector()
        structure = bridge.describe(at).message
        assert structure is not None
        with no_threads("uoarm-ros1-/threads"), refused:
            bridge.open_source(at, structure, inbox)
        with closing(bridge.open_source(at, structure, inbox)):
            lasting.publish("/threads", type="std_msgs/String", values={"data": "x"})
            inbox.wait(1, patience())
        structures = ServiceStructures(MessageStructure({}), MessageStructure({}))
        channel = bridge.serve(service("/threaded", SET), lambda message: message, structures)
        with no_threads("uoarm-ros1-/threaded"), pytest.raises(BridgeError):
            bridge.call(service("/threaded"), {"data": True}, timeout=patience())
        assert channel.facts()["clients"] == 0


def test_a_call_that_still_connects_ends_as_the_bridge_closes(master: Master) -> None:
    """As those that wait for a reply: more than the kernel connects to a server that is stopped."""
    peer = master.peer("stopped")
    peer.do("serve", service="/stopped", type=SET)
    with bridge_to(master) as bridge:
        at = service("/stopped")
        bridge.call(at, {"data": True}, timeout=patience())
        peer.freeze()
        limit = 4 * patience()
        calls = [
            Background(lambda: bridge.call(at, {"data": True}, timeout=limit)) for _ in range(20)
        ]
        under_way = bridge._pending_calls
        wait(lambda: len(under_way) == 20)
        bridge.close(timeout=patience())
        for call in calls:
            with pytest.raises(BridgeError, match=r"the call was cancelled|the bridge was closed"):
                call.result()
        wait(lambda: not len(under_way), "a call goes on", patience())
    peer.kill()


def test_a_function_is_served_to_clients_of_ros(master: Master, lasting: Peer) -> None:
    calls: list[Any] = []

    def answer(request: Any) -> Any:
        calls.append(request)
        if not request["data"]:
            raise ValueError("it must be on")
        reply = {"success": True, "message": "Kia ora"}
        return reply if len(calls) == 1 else Quits(reply)

    with bridge_to(master) as bridge:
        served = bridge.serve(service("/served", SET), answer)
        ask = {"service": "/served", "type": SET}
        reply = lasting.do("call", **ask, values={"data": True})
        assert reply == {"success": True, "message": "Kia ora"}
        failed = lasting.do("call", **ask, values={"data": False})
        assert "it must be on" in failed["error"]
        unwritten = lasting.do("call", **ask, values={"data": True})
        assert "SystemExit" in unwritten["error"]
        wrong = lasting.do("call", service="/served", type="std_srvs/Trigger", values={})
        assert "std_srvs/SetBool" in wrong["error"]
        assert served.facts()["refused"] == 1
        served.close()
        gone = lasting.do("call", **ask, values={"data": True})
        assert "error" in gone
    assert calls == [{"data": True}, {"data": False}, {"data": True}]


def test_an_action_is_a_call(master: Master, lasting: Peer) -> None:
    lasting.do("act", action="/add", type=ADD)
    with bridge_to(master) as bridge:
        described: Any = bridge.describe(service("/add"))
        assert described.request.schema["required"] == ["a", "b"]
        assert described.reply.schema["required"] == ["sum"]
        at = service("/add", ADD)
        assert bridge.call(at, {"a": 2, "b": 40}) == {"sum": 42}
        feedback: Any = bridge.describe(output("/add/feedback")).message
        assert "feedback" in feedback.schema["properties"]


def test_an_action_that_fails_says_how(master: Master) -> None:
    peer = master.peer("acting")
    peer.do("act", action="/abort", type=ADD, how="abort")
    peer.do("act", action="/waiting", type=ADD, how="wait")
    with bridge_to(master) as bridge:
        goal = {"a": 1, "b": 2}
        with pytest.raises(BridgeError, match="the goal was aborted: it cannot"):
            bridge.call(service("/abort", ADD), goal)
        with pytest.raises(BridgeError, match="there is no server of action /none"):
            bridge.describe(service("/none", ADD))
        with pytest.raises(BridgeTimeoutError):
            bridge.call(service("/waiting", ADD), goal, timeout=slowness())
        caller: Any = bridge

        def goals() -> Any:
            waiting = caller._callers.get(("/waiting", ADD))
            return waiting and waiting._goals

        wait(lambda: not goals(), "the goal that was given up is waited for")
        cancelled = Background(lambda: bridge.call(service("/waiting", ADD), goal, number=5))
        wait(goals, "the goal was not sent")
        wait(lambda: bridge.cancel_call(5), "it cannot be cancelled")
        with pytest.raises(
            BridgeError, match=r"the goal was (preempted: it was asked to stop|recalled)"
        ):
            cancelled.result()
        garbled = Background(lambda: bridge.call(service("/waiting", ADD), goal))
        wait(goals, "the goal was not sent")
        caller._callers[("/waiting", ADD)]._take_result(b"\1\0", "/acting")
        with pytest.raises(BridgeError, match="lost: what its server sends cannot be read"):
            garbled.result()
        lost = Background(lambda: bridge.call(service("/waiting", ADD), goal))
        wait(goals, "the goal was not sent")
        peer.kill()
        with pytest.raises(BridgeError, match="the goal was lost"):
            lost.result()


def test_goals_have_the_time_of_a_simulation(master: Master, lasting: Peer) -> None:
    """A server counts by it: a goal that is stamped otherwise is of another year."""
    peer = master.peer("simulating")
    peer.do("advertise", topic="/clock", type="rosgraph_msgs/Clock", latch=True)
    values = {"clock": {"secs": 100, "nsecs": 5}}
    peer.do("publish", topic="/clock", type="rosgraph_msgs/Clock", values=values)
    lasting.do("act", action="/simulated/add", type=ADD)
    lasting.do("subscribe", topic="/simulated/add/goal", type="actionlib/TwoIntsActionGoal")
    with bridge_to(master, use_sim_time=True) as bridge:
        node: Any = bridge
        wait(lambda: node._clock.stamp()["secs"], "the clock is not taken")
        at = service("/simulated/add", ADD)
        assert bridge.call(at, {"a": 1, "b": 2}) == {"sum": 3}
        (goal,) = lasting.wait_for("came", bool, topic="/simulated/add/goal")
        assert goal["goal_id"]["stamp"] == goal["header"]["stamp"] == values["clock"]
    peer.kill()


def test_a_function_answers_goals_of_actionlib(master: Master, lasting: Peer) -> None:
    holding, begun = threading.Event(), threading.Event()

    def add(goal: Any) -> Any:
        if goal["a"] < 0:
            raise ValueError("no negative numbers")
        if goal["a"] == 7:
            begun.set()
            holding.wait(patience())
        return {"sum": goal["a"] + goal["b"]}

    with bridge_to(master) as bridge:
        bridge.serve(service("/ours/add", ADD, at_once=1), add)
        ask = {"action": "/ours/add", "type": ADD, "timeout": patience()}
        done = lasting.do("send_goal", **ask, values={"a": 1, "b": 2})
        assert done == {"state": 3, "text": "", "result": {"sum": 3}}
        failed = lasting.do("send_goal", **ask, values={"a": -1, "b": 2})
        assert (failed["state"], failed["text"]) == (4, "ValueError: no negative numbers")

        # A function that runs cannot be interrupted: its goal ends as preempted when it has ended.
        def release() -> None:
            begun.wait(patience())
            holding.set()

        threading.Thread(target=release).start()
        stopped = lasting.do("send_goal", **ask, values={"a": 7, "b": 2}, cancel=True)
        assert stopped["state"] in {2, 3}
        described: Any = bridge.describe(service("/ours/add", ADD))
        assert described.reply is not None


def test_a_cancellation_up_to_a_time_holds_for_goals_that_come_after_it(
    master: Master, lasting: Peer
) -> None:
    goal, cancel, result = (f"/early/add/{part}" for part in ("goal", "cancel", "result"))
    with bridge_to(master) as bridge:
        served: Any = bridge.serve(service("/early/add", ADD), lambda _: {"sum": 3})
        for topic, kind in (
            (goal, "actionlib/TwoIntsActionGoal"),
            (cancel, "actionlib_msgs/GoalID"),
        ):
            lasting.do("advertise", topic=topic, type=kind)
        lasting.do("subscribe", topic=result, type="actionlib/TwoIntsActionResult")
        assert served._publications[0].wait(bool, patience())
        status = {"topic": "/early/add/status", "type": "actionlib_msgs/GoalStatusArray"}
        lasting.do("subscribe", **status)
        stamp = {"secs": 100, "nsecs": 5}
        lasting.publish(cancel, type="actionlib_msgs/GoalID", values={"stamp": stamp, "id": "x"})
        lasting.wait_for(
            "came", lambda came: came and came[-1]["status_list"], topic=status["topic"]
        )
        for identity, nsecs in (("at", 5), ("after", 6)):
            goal_id = {"stamp": {**stamp, "nsecs": nsecs}, "id": identity}
            values = {"goal_id": goal_id, "goal": {"a": 1, "b": 2}}
            lasting.publish(goal, type="actionlib/TwoIntsActionGoal", values=values)
        came = lasting.wait_for("came", lambda came: len(came) == 2, topic=result)
        ends = {item["status"]["goal_id"]["id"]: item["status"]["status"] for item in came}
        assert ends == {"at": 8, "after": 3}


def test_parameters_are_read_watched_and_set(master: Master, lasting: Peer) -> None:
    lasting.do("set_param", name="/robot/speed", value=1.5)
    with bridge_to(master) as bridge:
        at = output("/robot/speed", "parameter")
        message: Any = bridge.describe(at).message
        assert message.schema == {"type": "number"}
        collector = Collector()
        source = bridge.open_source(at, message, collector.deliver)
        assert source.latched
        assert collector.wait(1) == [1.5]
        lasting.do("set_param", name="/robot/speed", value=2.5)
        assert collector.wait(2) == [1.5, 2.5]
        sink = bridge.open_sink(input_("/robot/speed", "parameter"), ANY)
        sink.send(3.5)
        assert lasting.do("get_param", name="/robot/speed") == 3.5
        assert collector.wait(3)[-1] == 3.5
        with pytest.raises(MessageError, match="32 bits"):
            sink.send(2**40)
        whole = Collector()
        bridge.open_source(output("/robot", "parameter"), ANY, whole.deliver)
        assert whole.wait(1) == [{"speed": 3.5}]
        lasting.do("set_param", name="/robot/speed", value=4.5)
        assert whole.wait(2)[-1] == {"speed": 4.5}
        with pytest.raises(BridgeError, match="the parameter /robot/none is not set"):
            bridge.describe(output("/robot/none", "parameter"))


def test_a_large_graph_is_discovered_by_asking_each_thing_once(
    master: Master, lasting: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    peer = master.peer("large")
    for number in range(20):
        peer.do("advertise", topic=f"/large/{number}", type="std_msgs/Int32")
        lasting.do("subscribe", topic=f"/large/{number}", type="std_msgs/Int32")
    asked: list[str] = []

    def call(uri: str, method: str, *given: Any, **named: Any) -> Any:
        # Other tests have left topics of their own, on which the number must not depend.
        if method != "requestTopic" or given[1].startswith("/large/"):
            asked.append(method)
        return call_api(uri, method, *given, **named)

    with bridge_to(master, rosout=False, check=60) as bridge:
        for module in (_master, _node, _subscription):
            monkeypatch.setattr(module, "call_api", call)
        found = {component.name for component in bridge.discover()}
        assert {"/large", "/lasting"} <= found
    assert asked.count("getSystemState") == asked.count("getTopicTypes") == 1
    assert asked.count("requestTopic") < 3 * 20
    peer.kill()


def test_many_that_open_ask_for_the_graph_once_a_second_and_what_came_since_is_found(
    master: Master, monkeypatch: pytest.MonkeyPatch
) -> None:
    peer = master.peer("many")
    for number in range(20):
        peer.do("advertise", topic=f"/many/{number}", type="std_msgs/Int32")
    asked: list[str] = []

    def call(uri: str, method: str, *given: Any, **named: Any) -> Any:
        asked.append(method)
        return call_api(uri, method, *given, **named)

    with bridge_to(master, rosout=False, check=60) as bridge:
        for module in (_master, _node, _subscription):
            monkeypatch.setattr(module, "call_api", call)
        monkeypatch.setattr(_bridge, "_LATELY_SECONDS", 1000.0)
        for number in range(20):
            at = output(f"/many/{number}")
            assert bridge.describe(at).message is not None
            bridge.open_source(at, ANY, Collector().deliver)
        assert asked.count("getSystemState") == 1
        peer.do("advertise", topic="/many/later", type="std_msgs/Int32")
        assert bridge.describe(output("/many/later")).message is not None
        peer.kill()
        for _ in range(2):
            with pytest.raises(BridgeError, match="no publisher of /many/later answers"):
                bridge.describe(output("/many/later"))
    assert asked.count("getSystemState") == 4


def test_every_node_is_discovered_with_structures(master: Master) -> None:
    peer = master.peer("discovered")
    peer.do("advertise", topic="/found/out", type="sensor_msgs/Image")
    peer.do("subscribe", topic="/found/in", type="geometry_msgs/Twist")
    peer.do("serve", service="/found/set", type=SET)
    peer.do("act", action="/found/act", type=ADD)
    dead = master.peer("dead")
    dead.do("advertise", topic="/dead", type="std_msgs/Int32")
    dead.kill()
    with bridge_to(master) as bridge:
        found = {component.name: component for component in bridge.discover()}
        assert "/dead" not in found  # though it is registered still
        ports = {at.address: (at.role, known) for at, known in found["/discovered"].endpoints}
        role, image = ports["/found/out", "sensor_msgs/Image"]
        assert role is Role.OUTPUT
        assert image.message is not None
        role, twist = ports["/found/in", "geometry_msgs/Twist"]
        assert role is Role.INPUT
        assert twist.message is not None
        assert ports["/found/set",][1].request is not None
        assert ports["/found/act", ADD][1].request is not None
        assert not [address for address in ports if "rosout" in address[0]]
        assert not [address for address in ports if address[0].startswith("/found/act/")]
        for at, known in found["/discovered"].endpoints:
            assert bridge.describe(at) == known
    peer.kill()


def test_a_service_that_another_node_registers_later_is_degraded_until_that_ends(
    master: Master,
) -> None:
    peer = master.peer("later")
    with bridge_to(master) as bridge:
        bridge.serve(service("/both", SET), lambda _: OURS)
        reports = Inbox(bridge)
        peer.do("serve", service="/both", type=SET)
        event = reports.event(Health.DEGRADED, "clients of /both are sent to node /later")
        assert event.channel is not None
        peer.do("serve_no_more", service="/both")
        reports.event(Health.OK, "clients of /both are sent here again")
        assert bridge.call(service("/both"), {"data": True}) == OURS
    peer.kill()


def test_a_service_is_taken_back_from_a_node_that_was_killed(master: Master) -> None:
    peer = master.peer("brief")
    with bridge_to(master) as bridge:
        bridge.serve(service("/kept", SET), lambda _: OURS)
        reports = Inbox(bridge)
        peer.do("serve", service="/kept", type=SET)
        reports.event(Health.DEGRADED, "are sent to node /brief")
        peer.kill()
        reports.event(Health.OK, "clients of /kept are sent here again")
        assert bridge.call(service("/kept"), {"data": True}) == OURS
