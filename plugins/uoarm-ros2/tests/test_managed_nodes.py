"""Lifecycle nodes of rclpy in a process of their own, and the parameters of nodes."""

from __future__ import annotations

import re
import threading
from typing import Any

import pytest
from attrs import evolve
from endpoints import INT64, Make, Start, endpoint
from messages import default_of
from peers import MORTAL, Peer
from robots import robot
from tests.inbox import Inbox  # type: ignore[import-not-found]
from uoarm_ros2._managed_nodes import ManagedNode, NodeAccess, NodeRequirement, Transition
from uoarm_ros2._types import import_type

from uoarm.bridge import Bridge
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Endpoint, Health, Role
from uoarm.server.front_end import Operation, Supervision
from uoarm.testing import Collector, patience, wait

SET_BOOL = "std_srvs/srv/SetBool"


def numbers(*more: str, parameters: Any = None, **options: Any) -> Endpoint:
    options = {"node": "/camera", "activate": True, **options}
    at = endpoint(Role.OUTPUT, "/numbers", *(more or (INT64,)), **options)
    return evolve(at, parameters=parameters or {})


def opened(bridge: Bridge, at: Endpoint, inbox: Any) -> Any:
    structure = bridge.describe(at).message
    assert structure is not None
    return bridge.open_source(at, structure, inbox)


@pytest.fixture
def camera(peer: Start) -> Peer:
    there = peer("beside", "threads")
    there.do("manage", name="camera", topic="/numbers")
    return there


def test_a_node_is_configured_and_activated_on_request_and_deactivated_after(
    bridge: Bridge, camera: Peer
) -> None:
    inbox = Inbox()
    source = opened(bridge, numbers(parameters={"gain": 2.5, "late": 7}), inbox)
    inbox.wait_for(3)
    reports = camera.do("transitions", expected=2)
    assert reports == {"asked": ["configure", "activate"], "gains": [2.5], "writes": 2}
    source.close()
    asked = camera.do("transitions", expected=3)["asked"]
    assert asked == ["configure", "activate", "deactivate"]


def test_parameters_are_read_and_set_while_a_node_runs_with_the_rights_of_what_moves(
    peer: Start,
) -> None:
    peer("beside", "threads").do("manage", name="camera", topic="/numbers")
    functions = """
  get:
    components:
      - name: reader
        bridge: ros
        service: {endpoint: [/camera/get_parameters, rcl_interfaces/srv/GetParameters]}
  set:
    components:
      - name: writer
        bridge: ros
        service:
          endpoint: [/camera/set_parameters, rcl_interfaces/srv/SetParameters]
          lifetime: 60
"""
    value = {**default_of(import_type("rcl_interfaces/msg/ParameterValue")), "type": 3}
    with robot(functions) as manager:
        asked = {"parameters": [{"name": "gain", "value": {**value, "double_value": 4.5}}]}
        reply = manager.call("set", asked)
        assert reply == {"results": [{"successful": True, "reason": ""}]}
        read = manager.call("get", {"names": ["gain"]})
        assert read["values"][0]["double_value"] == 4.5
        reason = Supervision(lambda: manager.config).reason
        assert "a call of it has a lifetime" in reason(Operation.CALL, "set")
        assert reason(Operation.CALL, "get") == ""


def test_the_states_of_a_node_are_the_health_of_its_component(bridge: Bridge, camera: Peer) -> None:
    events = Inbox(bridge)
    opened(bridge, numbers(afterwards="cleanup"), Inbox())
    camera.do("trigger", transition="deactivate")
    event = events.event(Health.DEGRADED, "lifecycle node /camera is inactive (not asked for here)")
    assert (event.component, event.about) == ("thing", "lifecycle")
    camera.do("trigger", transition="activate")
    assert events.event(Health.OK, "lifecycle node /camera is active").about == "lifecycle"
    camera.do("trigger", transition="deactivate")
    camera.do("trigger", transition="shutdown")
    events.event(Health.LOST, "lifecycle node /camera is finalized")
    with pytest.raises(BridgeError, match="is finalized, which only a restart of it ends") as error:
        bridge.describe(numbers())
    assert error.value.reason is FailureReason.UNAVAILABLE


def test_a_node_that_is_kept_active_is_activated_again(bridge: Bridge, camera: Peer) -> None:
    source = opened(bridge, numbers(activate="keep", afterwards="cleanup"), Inbox())
    camera.do("trigger", transition="deactivate")
    asked = camera.do("transitions", expected=4)["asked"]
    assert asked == ["configure", "activate", "deactivate", "activate"]
    source.close()
    assert camera.do("transitions", expected=6)["asked"][4:] == ["deactivate", "cleanup"]


def test_closing_the_bridge_leaves_a_node_as_it_was_found(
    make_bridge: Make, camera: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    bridge = make_bridge()
    opened(bridge, numbers(afterwards="cleanup"), Inbox())
    monkeypatch.setattr("uoarm_ros2._bridge._LEAVE_SECONDS", patience())
    bridge.close(timeout=2 * patience())
    asked = camera.do("transitions", expected=4)["asked"]
    assert asked == ["configure", "activate", "deactivate", "cleanup"]


def test_a_node_is_left_before_a_waiting_caller_continues() -> None:
    asked: list[object] = []
    leaving, go = threading.Event(), threading.Event()

    def ask(service: str, _type: str, request: Any, _seconds: float) -> Any:
        state = {"label": ["inactive", "active"][asked.count(3) - asked.count(4)]}
        if "transition" in request:
            if request["transition"]["id"] == Transition.DEACTIVATE:
                leaving.set()
                assert go.wait(patience())
            asked.append(request["transition"]["id"])
        return {"current_state": state}

    access = NodeAccess(ask, lambda _: True, lambda *_: lambda: asked.append("deaf"), print)
    node = ManagedNode("/camera", access)
    node.acquire("thing", NodeRequirement("/camera", activate=True))
    node.begin_closing()
    assert leaving.wait(patience())
    go.set()
    node.join(patience())
    assert asked == [Transition.ACTIVATE, Transition.DEACTIVATE, "deaf"]


@pytest.mark.parametrize("state", ["inactive", "finalized"])
def test_what_was_reported_in_one_call_is_over_with_the_next(state: str) -> None:
    there, reports = ["inactive"], Collector()

    def ask(service: str, _type: str, request: Any, _seconds: float) -> Any:
        if "transition" in request:
            there[0] = (
                "active" if request["transition"]["id"] == Transition.ACTIVATE else "inactive"
            )
        return {"current_state": {"label": there[0]}}

    def report(health: Health, _cause: str, component: str) -> None:
        reports.deliver((health, component))

    node = ManagedNode("/lamp", NodeAccess(ask, lambda _: True, lambda *_: lambda: None, report))
    lamp = NodeRequirement("/lamp", activate=True)
    lease = node.acquire("thing", lamp)
    there[0] = state
    node.hint()
    reports.wait(1)
    node.release(lease)
    there[0] = "inactive"
    again = node.acquire("thing", lamp)
    trouble = Health.DEGRADED if state == "inactive" else Health.LOST
    assert reports.messages == [(trouble, "thing"), (Health.OK, "thing")]
    node.release(again)
    node.begin_closing()
    node.join(patience())


def test_a_node_that_does_not_answer_is_left_as_it_is_and_reported(
    make_bridge: Make,
    camera: Peer,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    bridge = make_bridge()
    opened(bridge, numbers(), Inbox())
    camera.freeze()
    monkeypatch.setattr("uoarm_ros2._bridge._LEAVE_SECONDS", 0.0)
    bridge.close(timeout=patience())
    left = re.compile("node /camera is left as it is: .*the bridge was closed")
    wait(lambda: left.search(caplog.text) is not None)


def test_a_call_finds_its_node_active_and_the_next_one_does_not_ask_again(
    bridge: Bridge, camera: Peer
) -> None:
    address = ("/numbers_switch", SET_BOOL)
    switch = endpoint(Role.SERVICE, *address, node="/camera", activate=True)
    switch = evolve(switch, parameters={"late": 3})
    assert bridge.describe(switch).request is not None
    for _ in range(5):
        reply = bridge.call(switch, {"data": True})
        assert reply == {"success": True, "message": "late 3"}
    asked = camera.do("transitions", expected=3)["asked"]
    assert (asked[:2], set(asked)) == (
        ["configure", "activate"],
        {"configure", "activate", "deactivate"},
    )


def test_a_transition_that_fails_is_the_error_of_the_request(bridge: Bridge, peer: Start) -> None:
    beside = peer("beside", "threads")
    for fails, words in {
        "activate": "is inactive (activate failed)",
        "configure!": "is unconfigured (configure failed)",
    }.items():
        name = fails.strip("!")
        beside.do("manage", name=name, topic="/numbers", fails=fails)
        at = numbers(node=f"/{name}")
        structure = bridge.describe(at).message
        assert structure is not None
        with pytest.raises(BridgeError) as error:
            bridge.open_source(at, structure, Inbox())
        assert f"lifecycle node /{name} {words}" in str(error.value)
    assert bridge.open_channels == 0


REFUSED: dict[str, dict[str, object]] = {
    "parameter gain of node /camera: expected 0 to 10, got 11": {"gain": 11},
    "parameter gain of node /camera: expected a number, got 'high'": {"gain": "high"},
    "expected 10 to 100 in steps of 10, got 55": {"rate": 55},
    "expected an integer of 64 bits, got 50.5": {"rate": 50.5},
    "parameter serial of node /camera: it is read-only, and has another": {"serial": "B2"},
    "the node says 'there is no camera on top'": {"camera": {"names": ["top"]}},
    "expected a list of texts, got [1]": {"camera": {"names": [1]}},
    "parameter gian of node /camera: it declares camera.names, gain, late, rate,": {"gian": 1},
}


def test_a_parameter_that_does_not_fit_says_so_and_nothing_is_set(
    bridge: Bridge, camera: Peer
) -> None:
    structure = bridge.describe(numbers()).message
    assert structure is not None
    for words, parameters in REFUSED.items():
        at = numbers(parameters={"late": 1, **parameters}, afterwards="leave")
        with pytest.raises(BridgeError) as error:
            bridge.open_source(at, structure, Inbox())
        assert words in str(error.value)
        assert error.value.reason is FailureReason.REFUSED
    assert bridge.open_channels == 0
    assert camera.do("transitions", expected=1) == {
        "asked": ["configure"],
        "gains": [1.0],
        "writes": 0,
    }


def test_only_what_has_another_value_is_written_to_a_plain_node_too(
    bridge: Bridge, camera: Peer
) -> None:
    camera.do("trigger", transition="configure")
    camera.do("trigger", transition="activate")
    parameters = {"gain": 1, "rate": 20, "serial": "A1", "camera": {"names": ["left"]}}
    first = opened(bridge, numbers(parameters=parameters, activate=False), Inbox())
    assert camera.do("transitions", expected=2)["writes"] == 1
    other = evolve(numbers(parameters={"rate": 30}, activate=False), component="another")
    with pytest.raises(BridgeError, match="rate of node /camera would be 30 for another, and is"):
        opened(bridge, other, Inbox())
    first.close()
    opened(bridge, other, Inbox())
    assert camera.do("transitions", expected=2)["writes"] == 2


def test_options_that_do_not_fit_a_node_are_reported(bridge: Bridge, peer: Start) -> None:
    peer("plain").do("advertise", topic="/numbers")
    with pytest.raises(BridgeError, match="no node /plain with a service get_state") as error:
        bridge.describe(numbers(node="/plain"))
    assert error.value.reason is FailureReason.NOT_FOUND
    at = evolve(numbers(node=""), component="my camera")
    with pytest.raises(BridgeError, match="'my camera' is not the name of a node"):
        bridge.describe(at)


def test_a_request_brings_the_node_up_and_a_dead_one_is_replaced(peer: Start) -> None:
    first, second = peer("one", "threads", **MORTAL), peer("two", "threads")
    first.do("manage", name="first", topic="/first")
    second.do("manage", name="second", topic="/second")
    functions = f"""
  numbers:
    components:
      - {{name: first, bridge: ros, priority: 2, parameters: {{gain: 3.0}},
         output: {{endpoint: [/first, {INT64}], options: {{activate: true}}}}}}
      - {{name: second, bridge: ros, parameters: {{gain: 4.0}},
         output: {{endpoint: [/second, {INT64}], options: {{activate: true}}}}}}
"""
    with robot(functions) as manager:
        connection = manager.request("numbers", timeout=2 * patience())
        connection.get(patience())
        assert second.do("transitions", expected=0)["asked"] == []
        first.kill()
        assert second.do("transitions", expected=2)["gains"] == [4.0]
        wait(lambda: connection.gaps)
        connection.close()
        assert second.do("transitions", expected=3)["asked"][2:] == ["deactivate"]
