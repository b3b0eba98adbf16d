"""Which orders a vehicle takes, and by which error it refuses the others, release by release."""

from __future__ import annotations

from typing import Any

import pytest
from uoarm_vda5050._orders import Order
from uoarm_vda5050._releases import RELEASES
from uoarm_vda5050._vehicle_state import Act, Drive, VehicleState

from fleet import goal
from uoarm.errors import MessageError

BOTH = pytest.mark.parametrize("release", ["2.1", "3.0"])
AT = {"x": 0.0, "y": 0.0, "mapId": "floor"}


def vehicle(release: str) -> VehicleState:
    made = VehicleState(RELEASES[release], frozenset({"pick"}))
    made.position = (0.0, 0.0, 0.0, "floor")
    return made


def order(release: str, *nodes: str, name: str = "one", **actions: str) -> Order:
    return Order.of(goal(*nodes, **actions), name, RELEASES[release], 100)


def errors(made: VehicleState) -> list[str]:
    return [error["errorType"] for error in made.errors.values()]


def drive(made: VehicleState) -> list[str]:
    done = []
    while (task := made.task) is not None:
        done.append(task.node_id if isinstance(task, Drive) else task.action_type)
        assert made.reached(task) if isinstance(task, Drive) else made.finished(task, "")
    return done


@BOTH
def test_an_order_is_carried_out_in_its_order(release: str) -> None:
    made = vehicle(release)
    assert made.order(order(release, "a", "b", "c", a="pick", c="pick").body)
    assert drive(made) == ["pick", "b", "c", "pick"]
    assert made.is_idle
    assert (made.last_node, made.last_sequence) == ("c", 4)


@pytest.mark.parametrize(
    ("release", "expected"),
    [
        (
            "2.1",
            {
                "edges": "validationError",
                "sequence": "validationError",
                "action": "orderError",
                "busy": "orderError",
                "far": "noRouteError",
                "old": "orderUpdateError",
                "gap": "orderUpdateError",
                "cancelled": "orderUpdateError",
                "mode": "orderError",
            },
        ),
        (
            "3.0",
            {
                "edges": "VALIDATION_FAILURE",
                "sequence": "VALIDATION_FAILURE",
                "action": "INVALID_ORDER_ACTION",
                "busy": "OTHER_ORDER_ACTIVE",
                "far": "START_NODE_OUT_OF_RANGE",
                "old": "OUTDATED_ORDER_UPDATE",
                "gap": "VALIDATION_FAILURE",
                "cancelled": "ORDER_UPDATE_FOLLOWING_CANCEL",
                "mode": "MOBILE_ROBOT_NOT_AVAILABLE",
                "differs": "SAME_ORDER_UPDATE_ID",
            },
        ),
    ],
)
def test_what_is_refused_has_the_error_of_the_release(
    release: str, expected: dict[str, str]
) -> None:
    first = order(release, "a", "b")
    second = order(release, "a", "b", name="two")
    nodes, edges = first.body["nodes"], first.body["edges"]
    update = first.extended(goal("b", "c"), RELEASES[release], 100).body
    gap = {**update, "nodes": [{**update["nodes"][0], "nodeId": "z"}, update["nodes"][1]]}
    far = {**nodes[0], "nodePosition": {**AT, "x": 7.0}}
    cases: dict[str, tuple[Any, ...]] = {
        "edges": ({**first.body, "edges": []},),
        "sequence": ({**first.body, "edges": [{**edges[0], "sequenceId": 7}]},),
        "action": (order(release, "a", b="x", *["b"]).body,),  # noqa: B026
        "busy": (first.body, second.body),
        "far": ({**first.body, "nodes": [far, nodes[1]]},),
        "old": ({**first.body, "orderUpdateId": 3}, update),
        "gap": (first.body, gap),
        "cancelled": (first.body, "cancel", update),
        "mode": ("manual", first.body),
        "differs": (first.body, {**first.body, "edges": [{**edges[0], "edgeId": "other"}]}),
    }
    for name, error in expected.items():
        made = vehicle(release)
        *before, last = cases[name]
        for item in before:
            if item == "cancel":
                made.instant({"actionId": "c", "actionType": "cancelOrder"})
            elif item == "manual":
                made.set_mode("MANUAL")
            else:
                assert made.order(item), name
        assert not made.order(last), name
        assert errors(made) == [error], name
        references = next(iter(made.errors.values()))["errorReferences"]
        assert {"referenceKey": "orderId", "referenceValue": last["orderId"]} in references


@BOTH
def test_the_same_order_again_is_ignored_and_a_refusal_ends_with_the_next_order(
    release: str,
) -> None:
    made, body = vehicle(release), order(release, "a", "b").body
    assert made.order(body)
    assert not made.order(body)
    assert errors(made) == []
    assert not made.order(order(release, "a", name="two").body)
    assert len(errors(made)) == 1
    drive(made)
    assert made.order(order(release, "b", name="three").body)
    assert errors(made) == []


@BOTH
def test_an_update_replaces_the_horizon_and_keeps_the_base(release: str) -> None:
    found, made = RELEASES[release], vehicle(release)
    nodes: list[dict[str, Any]] = [{"nodeId": "a"}, {"nodeId": "b"}, {"nodeId": "x"}]
    nodes[2] |= {"released": False, "actions": [{"actionType": "pick"}]}
    first = Order.of({"nodes": nodes}, "one", found, 100)
    assert made.order(first.body)
    assert drive(made) == ["b"]
    assert not made.is_idle, "it waits for its horizon"
    assert made.body()["newBaseRequest"] is True
    assert made.order(first.extended(goal("b", "c"), found, 100).body)
    assert made.body()["actionStates"] == [], "those of the former horizon are gone"
    assert drive(made) == ["c"]
    assert (made.update_id, made.last_sequence) == (1, 4)


@BOTH
def test_a_vehicle_that_moves_is_cancelled_once_it_stands(release: str) -> None:
    made = vehicle(release)
    made.order(order(release, "a", "b", b="pick").body)
    made.driving = True
    made.instant({"actionId": "c", "actionType": "cancelOrder"})
    assert made.task is None
    states = made.body()[made.release.instant_states]
    assert [state["actionStatus"] for state in states if state["actionId"] == "c"] == ["RUNNING"]
    assert made.body()["nodeStates"]
    made.driving = False
    assert made.stands()
    assert made.is_idle
    states = {state["actionId"]: state["actionStatus"] for state in made.body()["actionStates"]}
    assert states["one-2-0"] == "FAILED"
    made.instant({"actionId": "again", "actionType": "cancelOrder"})
    assert errors(made) == [made.release.errors.nothing]


@BOTH
def test_a_pause_holds_the_task_and_a_stale_task_is_refused(release: str) -> None:
    made = vehicle(release)
    made.order(order(release, "a", "b").body)
    task = made.task
    assert task is not None
    made.instant({"actionId": "p", "actionType": "startPause"})
    assert made.task is None
    assert not made.reached(task)
    made.instant({"actionId": "q", "actionType": "stopPause"})
    assert made.reached(task)
    assert not made.reached(task)


@BOTH
def test_an_order_is_carried_out_in_semiautomatic_mode(release: str) -> None:
    made = vehicle(release)
    made.set_mode("SEMIAUTOMATIC")
    assert made.order(order(release, "a", "b").body)
    assert drive(made) == ["b"]


def test_an_intervention_holds_the_order_until_the_vehicle_is_given_back() -> None:
    made = vehicle("3.0")
    made.order(order("3.0", "a", "b").body)
    made.set_mode("INTERVENED")
    assert made.task is None
    made.set_mode("SEMIAUTOMATIC")
    assert drive(made) == ["b"]


def test_a_failed_action_ends_the_order() -> None:
    made = vehicle("2.1")
    made.order(order("2.1", "a", "b", a="pick", b="pick").body)
    task = made.task
    assert isinstance(task, Act)
    assert made.failed(task, "nothing there")
    assert made.is_idle
    states = made.body()["actionStates"]
    assert [state["actionStatus"] for state in states] == ["FAILED", "FAILED"]
    assert states[0]["resultDescription"] == "nothing there"


@pytest.mark.parametrize(
    ("wanted", "text"),
    [
        ({"nodes": []}, "at least one node"),
        (goal(*map(str, range(200))), r"200 nodes; 100 are allowed \(max_nodes\)"),
        ({**goal("a", "b"), "edges": [{}, {}]}, "1 edges between them, got 2"),
        ({"nodes": [{"nodeId": "a", "released": False}]}, "first node is released"),
        ({"nodes": [{"nodeId": ""}]}, "has a nodeId"),
        (
            {"nodes": [{"nodeId": "a", "actions": [{"actionType": "x", "actionId": "1"}] * 2}]},
            "same actionId",
        ),
    ],
)
def test_what_can_be_no_order_is_refused_in_words(wanted: Any, text: str) -> None:
    with pytest.raises(MessageError, match=text):
        Order.of(wanted, "one", RELEASES["2.1"], 100)
