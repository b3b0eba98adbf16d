"""Actions over rosbridge: functions that take goals, services as actions, goals between clients."""

from __future__ import annotations

from typing import Any

import pytest
from components import Walker, cancelled
from ros import Enter, Ros, Serve, end, url
from tests.server.robot import script  # type: ignore[import-not-found]
from tests.server.talk import eventually  # type: ignore[import-not-found]

from uoarm import RobotManager
from uoarm.server import Limits, Server

SUCCEEDED, CANCELED, ABORTED = 4, 5, 6


def send(client: Ros, goal: object, *, action: str = "/uoarm/navigate", **more: object) -> None:
    client.send(**{"op": "send_action_goal", "id": "g", "action": action, "args": goal, **more})


def result(client: Ros) -> dict[str, Any]:
    reports = client.receive()
    assert reports["op"] == "action_result", reports
    return reports


def test_a_function_that_takes_goals_is_an_action(enter: Enter, robot: RobotManager) -> None:
    with_feedback, without = enter(), enter()
    send(with_feedback, {"value": 2}, feedback=1)
    action = {"action": "/uoarm/navigate", "id": "g"}
    for step in range(2):
        reports = {"op": "action_feedback", "values": {"step": step}, **action}
        assert with_feedback.receive() == reports
    ended = {"op": "action_result", "status": SUCCEEDED, "result": True, **action}
    assert result(with_feedback) == {**ended, "values": {"walked": 2}}
    send(without, [3])
    assert result(without)["values"] == {"walked": 3}


def test_goals_of_many_clients_run_side_by_side(enter: Enter) -> None:
    clients = [enter() for _ in range(5)]
    for number, client in enumerate(clients):
        send(client, {"value": 0}, id=f"waits {number}")
        send(client, {"value": number + 1})
    for number, client in enumerate(clients):
        assert result(client)["values"] == {"walked": number + 1}
    for number, client in reversed(list(enumerate(clients))):
        client.send(op="cancel_action_goal", action="/uoarm/navigate", id=f"waits {number}")
        reports = result(client)
        assert (reports["id"], reports["status"]) == (f"waits {number}", CANCELED)


def test_a_goal_is_cancelled_at_once_or_later(enter: Enter) -> None:
    client = enter()
    for _ in range(20):
        send(client, {"value": 0})
        client.send(op="cancel_action_goal", action="/uoarm/navigate", id="g")
        assert result(client)["status"] == CANCELED


def test_what_comes_before_a_goal_is_accepted_is_not_lost(enter: Enter) -> None:
    client = enter()
    send(client, {"value": Walker.HURRY}, feedback=True)
    steps = [client.receive()["values"]["step"] for _ in range(Walker.HURRY)]
    assert steps == list(range(Walker.HURRY))
    assert result(client)["values"] == {"walked": Walker.HURRY}


def test_feedback_that_cannot_be_written_is_reported_once_and_is_no_result(enter: Enter) -> None:
    client = enter()
    send(client, {"value": Walker.FAR}, feedback=True)
    status = client.receive()
    assert (status["op"], status["level"], status["id"]) == ("status", "error", "g")
    assert status["msg"].startswith("message: ")
    assert result(client)["values"] == {"walked": Walker.FAR}


def test_all_goals_of_a_client_are_cancelled_by_the_service_of_ros(enter: Enter) -> None:
    client, other = enter(), enter()
    send(other, {"value": 0})
    for identity in "ab":
        send(client, {"value": 0}, id=identity)
    client.send(op="call_service", service="/uoarm/navigate/_action/cancel_goal", args={})
    reports = [client.receive() for _ in range(3)]
    assert {report.get("id") for report in reports} == {"a", "b", None}
    other.send(op="cancel_action_goal", action="/uoarm/navigate", id="g")
    assert result(other)["status"] == CANCELED


@pytest.mark.parametrize(
    ("action", "goal", "said"),
    [
        ("/uoarm/navigate", {"value": -1}, "rejected the goal"),
        ("/uoarm/navigate", {"value": "far"}, "value"),
        ("/uoarm/navigate", [1, 2], "at most 1 arguments"),
        ("/uoarm/numbers", {}, "a stream, not a service"),
        ("/uoarm/nothing", {}, "there is no function"),
        ("/uoarm/broken", {"value": 3}, "cannot do 3"),
        ("/nowhere", {}, "there is no action"),
        ("", {}, "is no name"),
    ],
)
def test_a_goal_that_fails_has_a_result(enter: Enter, action: str, goal: object, said: str) -> None:
    client = enter()
    send(client, goal, action=action)
    reports = result(client)
    assert (reports["id"], reports["action"]) == ("g", action)
    assert (reports["result"], reports["status"]) == (False, 0)
    assert said in reports["values"]
    send(client, {"value": 1})
    assert result(client)["result"] is True


def test_a_service_is_an_action_without_feedback_that_cannot_be_cancelled(enter: Enter) -> None:
    client = enter()
    send(client, {"value": 7}, action="/uoarm/slow", feedback=True)
    said = client.refused(op="cancel_action_goal", action="/uoarm/slow", id="g")
    assert "cannot be cancelled" in said
    script.gate.set()
    reports = result(client)
    assert (reports["values"], reports["status"], reports["result"]) == (
        {"value": 7},
        SUCCEEDED,
        True,
    )


def test_an_id_is_one_goal_at_a_time_and_goals_are_limited(serve: Serve) -> None:
    with Ros(url(serve(Limits(streams=1)))) as client:
        send(client, {"value": 0})
        send(client, {"value": 1})
        assert "is under way" in result(client)["values"]
        send(client, {"value": 1}, id="h")
        assert "1 goals are under way" in result(client)["values"]


def test_a_client_that_goes_cancels_its_goals_and_closes_the_function(
    server: Server, enter: Enter, robot: RobotManager
) -> None:
    with Ros(url(server)) as client:
        send(client, {"value": 0})
        send(client, {"value": 1}, id="h")
        assert result(client)["id"] == "h"
    eventually(lambda: cancelled == ["goal 1"], "its goal is cancelled")
    eventually(lambda: not robot.status().connections, "the function is closed")


def test_the_end_of_a_function_ends_its_goals(enter: Enter, robot: RobotManager) -> None:
    client = enter()
    send(client, {"value": 0})
    send(client, {"value": 1}, id="h")
    assert result(client)["id"] == "h"
    end(robot)
    reports = result(client)
    assert (reports["id"], reports["result"]) == ("g", False)
    send(client, {"value": 1})
    assert result(client)["values"] == {"walked": 1}


def test_clients_work_on_goals_of_one_another(enter: Enter) -> None:
    provider, client, rival = enter(), enter(), enter()
    provider.send(op="advertise_action", action="/walk", type="x/Walk")
    assert "/walk" in provider.call("/rosapi/action_servers")["action_servers"]
    assert "another client" in rival.refused(op="advertise_action", action="/walk", type="y")
    send(client, {"far": 1}, action="/walk", feedback=True)
    asked = provider.receive()
    assert (asked["op"], asked["args"], asked["action_type"]) == (
        "send_action_goal", {"far": 1}, "x/Walk",
    )  # fmt: skip
    goal = {"action": "/walk", "id": asked["id"]}
    assert "works on no goal" in rival.refused(op="action_feedback", values={}, **goal)
    provider.send(op="action_feedback", values={"step": 1}, **goal)
    assert client.receive()["values"] == {"step": 1}
    client.send(op="cancel_action_goal", action="/walk", id="g")
    assert provider.receive() == {"op": "cancel_action_goal", **goal}
    said = provider.refused(op="action_result", status=99, result=True, values={}, **goal)
    assert "expected one of" in said
    provider.send(op="action_result", values={"at": 1}, status=CANCELED, result=True, **goal)
    reports = result(client)
    assert (reports["values"], reports["status"], reports["result"]) == ({"at": 1}, CANCELED, True)


def test_a_client_knows_its_action_by_the_name_that_it_gave(enter: Enter) -> None:
    provider, client = enter(), enter()
    provider.send(op="advertise_action", action="walk", type="x/Walk")
    assert "/walk" in provider.call("/rosapi/action_servers")["action_servers"]
    send(client, {"far": 1}, action="/walk")
    asked = provider.receive()
    assert asked["action"] == "walk"
    client.send(op="cancel_action_goal", action="/walk", id="g")
    goal = {"action": "walk", "id": asked["id"]}
    assert provider.receive() == {"op": "cancel_action_goal", **goal}
    provider.send(op="action_result", values={}, status=CANCELED, result=True, **goal)
    assert result(client)["status"] == CANCELED
    provider.send(op="unadvertise_action", action="walk")
    assert "/walk" not in provider.call("/rosapi/action_servers")["action_servers"]


def test_a_provider_that_fails_withdraws_or_goes_fails_the_goal(server: Server) -> None:
    with Ros(url(server)) as client:
        with Ros(url(server)) as provider:
            for end in ("abort", "withdraw", "go"):
                provider.send(op="advertise_action", action="/walk", type="x/Walk")
                provider.call("/rosapi/get_time")
                send(client, {}, action="/walk")
                goal = {"action": "/walk", "id": provider.receive()["id"]}
                if end == "abort":
                    provider.send(op="action_result", status=ABORTED, result=False, **goal)
                    assert "ended aborted" in result(client)["values"]
                elif end == "withdraw":
                    provider.send(op="unadvertise_action", action="/walk")
                    assert "unadvertised" in result(client)["values"]
        assert "has gone" in result(client)["values"]


def test_what_takes_goals_is_listed(enter: Enter) -> None:
    servers = enter().call("/rosapi/action_servers")["action_servers"]
    assert {"/uoarm/navigate", "/uoarm/add"} <= set(servers)
    assert "/uoarm/numbers" not in servers
