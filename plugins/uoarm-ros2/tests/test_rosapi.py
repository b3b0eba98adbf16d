"""rosapi's answers about types of ROS 2, in every spelling that clients of rosbridge use."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from robots import rosbridge
from websockets.sync.client import connect

from uoarm.testing import patience

pytest.importorskip("uoarm_rosbridge", reason="pip install -e plugins/uoarm-rosbridge")

ACTION = "/fibonacci, test_msgs/action/Fibonacci"
FUNCTIONS = f"""
  drive:
    components:
      - name: base
        bridge: ros
        input: {{endpoint: [/cmd_vel, geometry_msgs/msg/Twist], options: {{peer: optional}}}}
  inertia:
    components:
      - name: imu
        bridge: ros
        output: {{endpoint: [/imu, sensor_msgs/msg/Imu], options: {{peer: optional}}}}
  flag:
    components:
      - name: flag
        bridge: ros
        service: {{endpoint: [/flag, std_srvs/srv/SetBool], options: {{peer: optional}}}}
  fibonacci:
    components:
      - name: fibonacci
        bridge: ros
        inputs:
          goal: {{endpoint: [{ACTION}], options: {{peer: optional}}}}
        outputs:
          status: {{endpoint: [{ACTION}], options: {{peer: optional}}}}
          feedback: {{endpoint: [{ACTION}], options: {{peer: optional}}}}
          result: {{endpoint: [{ACTION}], options: {{peer: optional}}}}
"""
Send = Callable[..., Any]


@pytest.fixture(scope="module")
def ask() -> Iterator[Send]:
    """Send an operation of rosbridge and return its answer."""
    with rosbridge(FUNCTIONS) as (manager, url), connect(url) as client:
        for component in ("base", "imu", "flag", "fibonacci"):
            manager.structures(component, timeout=patience())

        def ask(**fields: object) -> Any:
            client.send(json.dumps(fields))
            return json.loads(client.recv(timeout=patience()))

        yield ask


def call(ask: Send, question: str, **arguments: object) -> Any:
    answer = ask(op="call_service", id="c", service=f"/rosapi/{question}", args=arguments)
    assert answer["result"] is True, answer
    return answer["values"]


TOPICS = [
    ("/uoarm/drive", "geometry_msgs/msg/Twist"),
    ("/uoarm/inertia", "sensor_msgs/msg/Imu"),
]


@pytest.mark.parametrize(("topic", "kind"), TOPICS)
def test_topics_have_their_types_whether_they_are_fed_or_give(
    ask: Send, topic: str, kind: str
) -> None:
    listed = call(ask, "topics")
    assert dict(zip(listed["topics"], listed["types"], strict=True))[topic] == kind
    for spelling in (topic, topic.lstrip("/"), f"{topic}/default"):
        assert call(ask, "topic_type", topic=spelling) == {"type": kind}
    for spelling in (kind, kind.replace("/msg/", "/"), f"/{kind.replace('/msg/', '//')}"):
        assert call(ask, "topics_for_type", type=spelling) == {"topics": [topic]}
        details = call(ask, "message_details", type=spelling)["typedefs"]
        assert details[0]["type"] == kind.replace("/msg/", "/")
    assert call(ask, "topics_for_type", type=kind.replace("/msg/", "/srv/")) == {"topics": []}


def test_a_topic_that_is_only_fed_has_its_text_and_its_subscriber(ask: Send) -> None:
    raw = call(ask, "topics_and_raw_types")
    text = dict(zip(raw["topics"], raw["typedefs_full_text"], strict=True))["/uoarm/drive"]
    assert text.startswith("geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n===")
    assert text.endswith("MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n")
    assert call(ask, "subscribers", topic="/uoarm/drive") == {"subscribers": ["/base"]}
    assert call(ask, "publishers", topic="/uoarm/drive") == {"publishers": []}
    assert call(ask, "node_details", node="/base")["subscribing"] == ["/uoarm/drive"]


def test_types_are_described_as_rosbridge_describes_them(ask: Send) -> None:
    [twist, vector] = call(ask, "message_details", type="geometry_msgs/Twist")["typedefs"]
    assert twist == {
        "type": "geometry_msgs/Twist",
        "fieldnames": ["linear", "angular"],
        "fieldtypes": ["geometry_msgs/Vector3"] * 2,
        "fieldarraylen": [-1, -1],
        "examples": ["{}", "{}"],
        "constnames": [],
        "constvalues": [],
    }
    assert vector["fieldtypes"] == ["double"] * 3
    assert vector["examples"] == ["0.0"] * 3
    # Of a type that nothing here carries, but which is installed.
    [status] = call(ask, "message_details", type="sensor_msgs/NavSatStatus")["typedefs"]
    constants = dict(zip(status["constnames"], status["constvalues"], strict=True))
    assert constants["STATUS_NO_FIX"] == "-1"
    assert status["fieldtypes"] == ["int8", "uint16"]


@pytest.mark.parametrize("kind", ["std_srvs/srv/SetBool", "std_srvs/SetBool"])
def test_a_service_has_its_type_and_what_it_is_made_of(ask: Send, kind: str) -> None:
    assert call(ask, "service_type", service="uoarm/flag") == {"type": "std_srvs/srv/SetBool"}
    assert call(ask, "services_for_type", type=kind) == {"services": ["/uoarm/flag"]}
    assert call(ask, "service_providers", service=kind) == {"providers": ["/flag"]}
    [request] = call(ask, "service_request_details", type=kind)["typedefs"]
    assert request["type"] == "std_srvs/SetBool_Request"
    assert (request["fieldnames"], request["fieldtypes"]) == (["data"], ["boolean"])
    [response] = call(ask, "service_response_details", type=kind)["typedefs"]
    assert response["fieldnames"] == ["success", "message"]
    other = call(ask, "service_request_details", type="std_srvs/Trigger")["typedefs"]
    assert [item["type"] for item in other] == ["std_srvs/Trigger_Request"]


def test_an_action_has_its_type_and_what_it_is_made_of(ask: Send) -> None:
    kind = call(ask, "action_type", action="/uoarm/fibonacci")["type"]
    assert kind == "test_msgs/action/Fibonacci"
    [goal] = call(ask, "action_goal_details", type="test_msgs/Fibonacci")["typedefs"]
    assert goal["fieldnames"] == ["order"]
    assert call(ask, "action_result_details", type=kind)["typedefs"][0]["fieldarraylen"] == [0]
    assert call(ask, "action_feedback_details", type=kind)["typedefs"]
    known = call(ask, "interfaces")["interfaces"]
    assert {kind, "std_srvs/srv/SetBool", "geometry_msgs/msg/Twist"} <= set(known)


def test_a_call_and_a_goal_that_state_another_type_are_refused(ask: Send) -> None:
    answer = ask(
        op="call_service", id=7, service="/uoarm/flag", type="std_srvs/Trigger", args={"data": True}
    )
    assert (answer["id"], answer["result"]) == (7, False)
    assert (
        "service '/uoarm/flag' has the type 'std_srvs/srv/SetBool', not 'std_" in answer["values"]
    )
