"""What a client may do: roles hold for topics, services and what rosapi shows."""

from __future__ import annotations

import json
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from ros import Ros, Serve, url
from tests.server.serving import access_file  # type: ignore[import-not-found]
from websockets.exceptions import InvalidStatus

from uoarm.server import Server, make_token

ACCESS = """
version: 1
roles:
  viewer: {{see: ["*"], request: ["num*"]}}
  driver: {{see: ["echo"], request: ["echo"], send: ["echo"], call: ["add"]}}
  operator: {{see: ["*"], kill: ["numbers"]}}
  guesser: {{see: ["echo"], request: ["*"], send: ["*"], call: ["*"]}}
tokens:
  - {{name: screen, role: viewer, sha256: {viewer}}}
  - {{name: pad, role: driver, sha256: {driver}}}
  - {{name: desk, role: operator, sha256: {operator}}}
  - {{name: guess, role: guesser, sha256: {guesser}}}
"""
TOKENS = {name: make_token() for name in ("viewer", "driver", "operator", "guesser")}


@pytest.fixture
def guarded(serve: Serve, tmp_path: Path) -> Server:
    return serve(access=access_file(tmp_path, ACCESS, TOKENS))


def at(server: Server, role: str) -> Ros:
    return Ros(url(server, f"/rosbridge?token={TOKENS[role]}"))


def test_a_role_may_do_what_is_named_and_nothing_else(guarded: Server) -> None:
    with pytest.raises(InvalidStatus):
        Ros(url(guarded, "/rosbridge"))
    with at(guarded, "viewer") as viewer, at(guarded, "driver") as driver:
        for client, denied in (
            (viewer, {"op": "publish", "topic": "/uoarm/echo", "msg": {"value": 1}}),
            (viewer, {"op": "subscribe", "topic": "/uoarm/echo"}),
            (viewer, {"op": "advertise", "topic": "/chatter", "type": "x"}),
            (viewer, {"op": "advertise_service", "service": "/half", "type": "x"}),
            (driver, {"op": "subscribe", "topic": "/uoarm/numbers"}),
            (driver, {"op": "subscribe", "topic": "/chatter"}),
        ):
            assert client.refused(**denied).startswith("denied: "), denied
        viewer.send(op="call_service", id="1", service="/uoarm/add", args=[1, 2])
        assert viewer.receive()["result"] is False
        assert driver.call("/uoarm/add", [1, 2]) == {"value": 3}
        assert driver.call("/rosapi/topics")["topics"] == ["/uoarm/echo"]


ASKED: Mapping[str, Mapping[str, Any]] = {
    "subscribe": {"op": "subscribe", "topic": "/uoarm/numberz"},
    "publish": {"op": "publish", "topic": "/uoarm/numberz", "msg": {"value": 1}},
    "advertise": {"op": "advertise", "topic": "/uoarm/numberz", "type": "std_msgs/Int32"},
    "call_service": {"op": "call_service", "service": "/uoarm/numberz", "args": [1]},
    "unsubscribe": {"op": "unsubscribe", "topic": "/uoarm/numberz"},
    "send_action_goal": {"op": "send_action_goal", "action": "/uoarm/numberz",
                         "action_type": "a/B", "args": {}},
}  # fmt: skip


@pytest.mark.parametrize("asked", ASKED.values(), ids=ASKED.keys())
def test_no_error_names_a_function_that_the_role_does_not_see(
    guarded: Server, asked: Mapping[str, Any]
) -> None:
    with at(guarded, "guesser") as client:
        client.send(**asked, id="1")
        answer = client.receive()
        assert answer["id"] == "1"
        assert "numbers" not in json.dumps(answer)


def test_parameters_are_seen_and_set_by_those_who_may(guarded: Server) -> None:
    with at(guarded, "viewer") as viewer, at(guarded, "driver") as driver:
        viewer.send(op="call_service", id="1", service="/rosapi/set_param",
                    args={"name": "speed", "value": "1"})  # fmt: skip
        assert "may not send '/speed'" in viewer.receive()["values"]
        assert driver.call("/rosapi/get_param_names") == {"names": []}


ROSAPI = (
    "topics", "topics_and_raw_types", "services", "nodes", "topic_type", "topics_for_type",
    "service_type", "services_for_type", "service_node", "service_providers", "publishers",
    "subscribers", "node_details", "message_details", "service_request_details",
    "service_response_details", "get_param", "get_param_names", "has_param", "action_servers",
)  # fmt: skip


@pytest.mark.parametrize("service", ROSAPI)
def test_what_a_role_may_not_see_is_for_rosapi_as_if_it_were_not_there(
    guarded: Server, service: str
) -> None:
    """A name that is hidden and one that does not exist get the same answer."""
    with at(guarded, "operator") as operator:
        kind = operator.call("/rosapi/topic_type", {"topic": "/uoarm/numbers"})["type"]
        assert "numbers" in json.dumps(operator.call("/rosapi/topics"))
        with at(guarded, "driver") as driver:
            hidden, absent = (
                _ask_rosapi(driver, service, function, kind) for function in ("numbers", "nothing")
            )
    assert hidden.replace("numbers", "nothing") == absent
    assert "picture" not in hidden


def _ask_rosapi(client: Ros, service: str, function: str, kind: str) -> str:
    named = f"/uoarm/{function}"
    arguments = {
        "topic": named, "service": named, "node": f"/{function}", "name": named,
        "type": kind.replace("numbers", function),
    }  # fmt: skip
    client.send(op="call_service", id="1", service=f"/rosapi/{service}", args=arguments)
    return json.dumps(client.receive())


def test_what_is_denied_is_in_the_audit_log(
    guarded: Server, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO, "uoarm.audit"), at(guarded, "viewer") as viewer:
        viewer.refused(op="publish", topic="/uoarm/echo", msg={"value": 1})
        viewer.refused(op="advertise", topic="/chatter", type="x")
    reports = [
        json.loads(record.message) for record in caplog.records if record.name == "uoarm.audit"
    ]
    denied = [
        (report["role"], report["operation"], report["function"])
        for report in reports
        if report.get("allowed") is False
    ]
    assert denied == [("viewer", "send", "echo"), ("viewer", "send", "/chatter")]
