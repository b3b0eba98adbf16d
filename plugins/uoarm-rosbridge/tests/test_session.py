"""The rosbridge endpoint, message by message: what rosbridge_suite does silently is reported."""

from __future__ import annotations

import asyncio
import base64
import gc
import json
import threading
from contextlib import suppress
from typing import Any, NoReturn

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ros import Enter, Ros, Serve, end, url
from tests.server.robot import END, script  # type: ignore[import-not-found]
from tests.server.talk import eventually, opened  # type: ignore[import-not-found]
from uoarm_rosbridge._wire import Fragments, first_fields

from uoarm import RobotManager
from uoarm.errors import ControlMessageError
from uoarm.server import Limits, Server
from uoarm.server.front_end import Feed
from uoarm.server.publication import InputPublication
from uoarm.server.streams import FeedRegistry
from uoarm.testing import patience, slowness


def test_a_function_is_a_topic(enter: Enter, robot: RobotManager) -> None:
    client = enter()
    client.send(op="subscribe", topic="/uoarm/doubled", type="any/Type")
    opened(robot, 1)
    script.put({"value": 1}, {"value": 2})
    assert client.receive() == {"op": "publish", "topic": "/uoarm/doubled", "msg": {"value": 2}}
    assert client.messages(1) == [{"value": 4}]
    client.send(op="unsubscribe", topic="/uoarm/doubled")
    opened(robot, 0)


@pytest.mark.parametrize("op", ["subscribe", "advertise"])
def test_another_type_than_that_of_ros_is_reported(
    enter: Enter, robot: RobotManager, op: str
) -> None:
    client = enter()
    text = client.refused(op=op, id="1", topic="/uoarm/typed", type="std_msgs/String")
    assert "has the type 'std_msgs/msg/Int32', not 'std_msgs/String'" in text
    opened(robot, 0)
    client.send(op=op, topic="/uoarm/typed", type="std_msgs/Int32")
    opened(robot, 1)


@pytest.mark.parametrize(
    ("op", "topic", "first"),
    [
        ("subscribe", "/uoarm/typed", {"type": "std_msgs/Int32"}),
        ("advertise", "/uoarm/typed", {"type": "std_msgs/Int32"}),
        ("subscribe", "/uoarm/numbers", {"type": "std_msgs/Int32"}),
        ("subscribe", "/chatter", {}),
        ("subscribe", "/chatter", {"type": "std_msgs/Int32"}),
        ("advertise", "/chatter", {"type": "std_msgs/Int32"}),
    ],
)
def test_another_type_is_reported_also_the_second_time(
    enter: Enter, op: str, topic: str, first: dict[str, str]
) -> None:
    client, publisher = enter(), enter()
    if topic == "/chatter":
        publisher.send(op="advertise", topic=topic, type="std_msgs/Int32")
        assert publisher.call("/rosapi/get_time")
    client.send(op=op, id="1", topic=topic, **first)
    text = client.refused(op=op, id="2", topic=topic, type="std_msgs/String")
    assert "Int32', not 'std_msgs/String'" in text
    client.send(op=op, id="3", topic=topic, type="std_msgs/msg/Int32")
    assert client.call("/rosapi/get_time")


def test_another_type_is_reported_that_is_stated_before_the_topic_opens(
    enter: Enter, robot: RobotManager, monkeypatch: pytest.MonkeyPatch
) -> None:
    go_on, join = threading.Event(), FeedRegistry.join

    async def join_late(registry: FeedRegistry, *arguments: Any) -> Feed:
        await asyncio.to_thread(go_on.wait, patience())
        return await join(registry, *arguments)

    monkeypatch.setattr(FeedRegistry, "join", join_late)
    client = enter()
    client.send(op="subscribe", id="1", topic="/uoarm/typed")
    client.send(op="subscribe", id="2", topic="/uoarm/typed", type="std_msgs/String")
    assert client.call("/rosapi/get_time")
    go_on.set()
    report = client.receive()
    assert (report["op"], report["id"]) == ("status", "2")
    assert "Int32', not 'std_msgs/String'" in report["msg"]
    opened(robot, 1)
    client.send(op="unsubscribe", id="1", topic="/uoarm/typed")
    opened(robot, 0)


def test_another_type_than_that_of_the_publisher_is_reported(enter: Enter) -> None:
    client, publisher = enter(), enter()
    publisher.send(op="advertise", topic="/chatter", type="std_msgs/msg/String")
    publisher.send(op="publish", topic="/chatter", msg={"data": "a"}, latch=1)
    assert publisher.call("/rosapi/get_time")
    text = client.refused(op="subscribe", topic="/chatter", type="std_msgs/Int32")
    assert "has the type 'std_msgs/msg/String', not 'std_msgs/Int32'" in text
    client.send(op="subscribe", topic="/chatter", type="std_msgs/String")
    assert client.messages(1) == [{"data": "a"}]


@pytest.mark.parametrize("width", [2**60, 2**64, -(2**63) - 1, 10**30])
def test_octets_are_base64_and_wide_integers_numbers(
    enter: Enter, robot: RobotManager, width: int
) -> None:
    client = enter()
    client.send(op="subscribe", topic="/uoarm/picture")
    opened(robot, 1)
    script.put({"width": width, "data": b"\x00\xff"})
    assert client.messages(1) == [{"width": width, "data": base64.b64encode(b"\x00\xff").decode()}]


def test_cbor_where_it_is_asked_for(enter: Enter, robot: RobotManager) -> None:
    client = enter()
    client.send(op="subscribe", topic="/uoarm/picture", compression="cbor")
    opened(robot, 1)
    script.put({"width": 1, "data": bytes(5000)})
    assert client.messages(1) == [{"width": 1, "data": bytes(5000)}]


def unpacked(received: dict[str, Any]) -> Any:
    cv2 = pytest.importorskip("cv2")
    assert received["op"] == "png"
    octets = np.frombuffer(base64.b64decode(received["data"]), np.uint8)
    picture = cv2.imdecode(octets, cv2.IMREAD_COLOR)
    assert picture is not None
    # In a browser roslibjs makes a character of each octet.
    return json.loads(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB).tobytes().decode("latin-1"))


@pytest.mark.parametrize("size", [0, 1, 2, 3, 100, 50_000])
def test_png_where_it_is_asked_for(enter: Enter, robot: RobotManager, size: int) -> None:
    client = enter()
    client.send(op="subscribe", topic="/uoarm/picture", compression="png")
    opened(robot, 1)
    script.put({"width": 2**60, "data": bytes(size)})
    message = {"width": 2**60, "data": base64.b64encode(bytes(size)).decode()}
    assert unpacked(client.receive()) == {
        "op": "publish", "topic": "/uoarm/picture", "msg": message,
    }  # fmt: skip


def test_any_text_and_number_comes_as_png(enter: Enter) -> None:
    speaker, listener = enter(), enter()
    listener.send(op="subscribe", topic="/chatter", compression="png")
    listener.send(op="call_service", service="/rosapi/get_time")
    listener.receive()
    message = {"data": "Kia ora ä 中 \N{GRINNING FACE}", "number": 10**30, "null": None}
    speaker.send(op="publish", topic="/chatter", msg=message)
    assert unpacked(listener.receive())["msg"] == message


def test_a_function_s_input_is_a_topic(enter: Enter, robot: RobotManager) -> None:
    client, other = enter(), enter()
    other.send(op="subscribe", topic="/uoarm/echo")
    opened(robot, 1)
    client.send(op="advertise", topic="/uoarm/echo", type="any/Type")
    for value in range(50):
        client.send(op="publish", topic="/uoarm/echo", msg={"value": value})
    assert [message["value"] for message in other.messages(50)] == list(range(50))


def test_what_was_published_before_unadvertise_arrives(enter: Enter, robot: RobotManager) -> None:
    listener, client = enter(), enter()
    listener.send(op="subscribe", topic="/uoarm/echo")
    opened(robot, 1)
    client.send(op="publish", topic="/uoarm/echo", msg={"value": 7})
    client.send(op="unadvertise", topic="/uoarm/echo")
    assert listener.messages(1) == [{"value": 7}]
    opened(robot, 1)


@pytest.mark.parametrize("value", [300, -1, "x", None])
def test_what_does_not_fit_is_refused_and_not_wrapped(enter: Enter, value: object) -> None:
    text = enter().refused(op="publish", id="p1", topic="/uoarm/echo", msg={"value": value})
    assert text.startswith("message: ")
    assert "value" in text


def test_a_function_is_a_service(enter: Enter) -> None:
    client = enter()
    assert client.call("/uoarm/add", {"a": 1, "b": 2}) == {"value": 3}
    assert client.call("/uoarm/add", [4, 5]) == {"value": 9}


@pytest.mark.parametrize(
    ("service", "args", "said"),
    [
        ("/uoarm/broken", {"value": 3}, "cannot do 3"),
        ("/uoarm/add", {"a": "x", "b": 1}, "expected a number"),
        ("/uoarm/nothing", {}, "nothing"),
        ("/uoarm/numbers", {}, "a stream, not a service"),
        ("/elsewhere", {}, "there is no service"),
        ("/rosapi/fly", {}, "no service 'fly'"),
        ("/rosapi/get_param", {}, "expected a text as 'name'"),
        ("/rosapi/set_param", {"name": "x", "value": "{"}, "expected a JSON text"),
        ("/rosapi/set_param", {"name": "/uoarm/add", "value": "1"}, "belongs to the server"),
        ("", {}, "is no name"),
    ],
)
def test_a_call_that_fails_has_a_response(
    enter: Enter, service: str, args: object, said: str
) -> None:
    client = enter()
    client.send(op="call_service", id="7", service=service, args=args)
    response = client.receive()
    assert (response["op"], response["id"], response["result"]) == ("service_response", "7", False)
    assert said in response["values"]


@pytest.mark.parametrize("identity", [0, 7, -1, 1.5, True, "", "7"])
def test_an_id_of_any_kind_comes_back_with_the_answer(enter: Enter, identity: object) -> None:
    client = enter()
    for service, result in (("/uoarm/add", True), ("/uoarm/nothing", False)):
        client.send(op="call_service", id=identity, service=service, args=[1, 2])
        answer = client.receive()
        assert (answer["id"], answer["result"]) == (identity, result)
    client.send(op="send_action_goal", id=identity, action="/uoarm/add", args=[1, 2])
    assert client.receive()["id"] == identity
    client.send(op="subscribe", id=identity)
    status = client.receive()
    assert (status["op"], status["id"]) == ("status", identity)
    client.send(op="subscribe", id=identity, topic="/chatter")
    client.send(op="unsubscribe", id=identity, topic="/chatter")
    client.send(op="unsubscribe", id=identity, topic="/chatter")
    assert "has not subscribed" in client.receive()["msg"]


@pytest.mark.parametrize("identity", [[], {"a": 1}, 10**30, "x" * 2000])
def test_an_id_that_nothing_could_match_is_refused(enter: Enter, identity: object) -> None:
    client = enter()
    client.send(op="call_service", id=identity, service="/uoarm/add", args=[1, 2])
    answer = client.receive()
    assert answer["result"] is False
    assert "id" not in answer
    assert "id: expected a number or a text" in answer["values"]


@pytest.mark.parametrize("timeout", ["5", True, [1]])
def test_a_limit_of_a_call_that_is_no_number_is_refused(enter: Enter, timeout: object) -> None:
    client = enter()
    client.send(op="call_service", id=1, service="/uoarm/add", args=[1, 2], timeout=timeout)
    answer = client.receive()
    assert (answer["id"], answer["result"]) == (1, False)
    assert "call_service: timeout: expected a number, got" in answer["values"]


def test_services_between_clients_have_the_type_that_their_provider_states(enter: Enter) -> None:
    provider, caller = enter(), enter()
    provider.send(op="advertise_service", service="/half", type="std_srvs/SetBool")
    eventually(
        lambda: "/half" in caller.call("/rosapi/services")["services"], "the service is there"
    )
    caller.send(op="call_service", id=1, service="/half", type="std_srvs/srv/Trigger")
    assert (
        "has the type 'std_srvs/SetBool', not 'std_srvs/srv/Trigger'" in caller.receive()["values"]
    )
    caller.send(op="call_service", id=2, service="/half", type="std_srvs/srv/SetBool")
    assert provider.receive()["service"] == "/half"
    kinds = caller.call("/rosapi/services_for_type", {"type": "std_srvs/srv/SetBool"})
    assert kinds == {"services": ["/half"]}
    assert caller.call("/rosapi/service_node", {"service": "/half"}) == {
        "node": "/rosbridge_websocket"
    }


def test_a_client_knows_its_service_by_the_name_that_it_gave(enter: Enter) -> None:
    provider, caller = enter(), enter()
    provider.send(op="advertise_service", service="half", type="x/Half")
    assert "/half" in provider.call("/rosapi/services")["services"]
    caller.send(op="call_service", id=1, service="/half")
    asked = provider.receive()
    assert asked["service"] == "half"
    provider.send(op="service_response", service="half", id=asked["id"], result=True, values={})
    assert caller.receive()["service"] == "/half"
    provider.send(op="unadvertise_service", service="half")
    assert "/half" not in provider.call("/rosapi/services")["services"]


def test_a_topic_with_and_without_a_slash_is_subscribed_by_both_names(enter: Enter) -> None:
    client = enter()
    for topic in ("/chatter", "chatter"):
        client.send(op="subscribe", topic=topic)
    client.send(op="publish", topic="chatter", type="x/Y", msg={"n": 1})
    assert sorted(client.receive()["topic"] for _ in range(2)) == ["/chatter", "chatter"]
    client.send(op="unsubscribe", topic="/chatter")
    client.send(op="publish", topic="/chatter", msg={"n": 2})
    assert client.receive()["topic"] == "chatter"


def test_what_clients_have_is_at_the_node_of_rosbridge(enter: Enter) -> None:
    speaker, listener = enter(), enter()
    speaker.send(op="advertise", topic="/chatter", type="std_msgs/String")
    listener.send(op="subscribe", topic="/chatter")
    node = "/rosbridge_websocket"
    eventually(
        lambda: (
            listener.call("/rosapi/publishers", {"topic": "/chatter"}) == {"publishers": [node]}
        ),
        "it is advertised",
    )
    assert listener.call("/rosapi/subscribers", ["chatter"]) == {"subscribers": [node]}
    details = listener.call("/rosapi/node_details", {"node": node})
    assert details["publishing"] == details["subscribing"] == ["/chatter"]
    assert {node, "/rosapi"} <= set(listener.call("/rosapi/nodes")["nodes"])


@pytest.mark.parametrize("kind", ["rosapi/TopicType", "rosapi_msgs/srv/TopicType"])
def test_rosapi_knows_its_own_services(enter: Enter, kind: str) -> None:
    client = enter()
    assert client.call("rosapi/services_for_type", {"type": kind}) == {
        "services": ["/rosapi/topic_type"]
    }
    answered = client.call("/rosapi/service_type", {"service": "rosapi/topic_type"})
    assert answered == {"type": "rosapi_msgs/srv/TopicType"}
    assert client.call("/rosapi/service_node", {"service": "/rosapi/topic_type"}) == {
        "node": "/rosapi"
    }
    [request] = client.call("/rosapi/service_request_details", {"type": kind})["typedefs"]
    assert (request["type"], request["fieldnames"]) == ("rosapi_msgs/TopicType_Request", ["topic"])
    stamp = client.call("/rosapi/service_response_details", {"type": "rosapi/GetTime"})["typedefs"]
    assert [item["type"] for item in stamp] == [
        "rosapi_msgs/GetTime_Response", "builtin_interfaces/Time",
    ]  # fmt: skip


def test_every_service_of_rosapi_answers_with_the_fields_that_it_says_it_has(enter: Enter) -> None:
    client = enter()
    client.call("/rosapi/set_param", {"name": "x", "value": "1"})
    arguments = {
        "topic": "/uoarm/numbers", "service": "/uoarm/add", "node": "/adder", "type": "Picture",
        "name": "x", "value": "1", "action": "/uoarm/add",
    }  # fmt: skip
    listed = client.call("/rosapi/services")["services"]
    others = (
        "request_details",
        "response_details",
        "goal_details",
        "result_details",
        "feedback_details",
    )
    for service in listed:
        if not service.startswith("/rosapi/") or service.endswith(others):
            continue
        kind = client.call("/rosapi/service_type", {"service": service})["type"]
        [said, *_] = client.call("/rosapi/service_response_details", {"type": kind})["typedefs"]
        assert set(client.call(service, arguments)) == set(said["fieldnames"])


def test_a_slow_call_holds_up_nothing(enter: Enter) -> None:
    client = enter()
    client.send(op="call_service", id="slow", service="/uoarm/slow", args={"value": 1})
    assert client.call("/uoarm/add", [1, 1]) == {"value": 2}
    script.gate.set()
    assert client.receive()["id"] == "slow"


@pytest.mark.parametrize(
    ("frame", "said"),
    [
        ("42", "expected an object"),
        ("{{{", "not JSON"),
        ('{"x": ' * 5000, "nested"),
        ("{}", "'op' is missing"),
        ('{"op": 5}', "'op' is missing"),
        ('{"op": "dance"}', "unknown op 'dance'; expected one of advertise"),
        ('{"op": "Request", "type": "camera", "id": "1"}', "whose clients connect at /"),
        ('{"op": "publish", "topic": "/t"}', "'msg' is missing"),
        ('{"op": "subscribe", "topic": 5}', "topic: expected a text"),
        ('{"op": "subscribe", "topic": "/t", "throttle_rate": -1}', "throttle_rate"),
        ('{"op": "subscribe", "topic": "/t", "compression": "zip"}', "'zip' is not served"),
        ('{"op": "subscribe", "topic": "/a b"}', "no name"),
        ('{"op": "png", "data": ""}', "png is not taken"),
        ('{"op": "auth", "mac": "x"}', "show a token in the handshake"),
        ('{"op": "cancel_action_goal", "action": "/a", "id": "1"}', "no goal '1' under way"),
        ('{"op": "unadvertise_action", "action": "/a"}', "does not provide"),
        ('{"op": "advertise_action", "action": "/uoarm/add", "type": "x"}', "belongs to"),
        ('{"op": "action_feedback", "action": "/a", "id": "1", "values": {}}', "works on no goal"),
        (
            '{"op": "action_result", "action": "/a", "id": "1", "status": 4, "result": true}',
            "works on no goal",
        ),
        ('{"op": "unsubscribe", "topic": "/t"}', "has not subscribed"),
        ('{"op": "unadvertise", "topic": "/t"}', "does not publish"),
        ('{"op": "unadvertise_service", "service": "/t"}', "does not provide"),
        ('{"op": "service_response", "id": "1", "result": true}', "no call waits"),
        ('{"op": "service_response", "id": "1", "result": 1}', "result: expected true or false"),
        ('{"op": "set_level", "level": "loud"}', "expected one of info"),
        ('{"op": "subscribe", "topic": "/uoarm/nothing"}', "nothing"),
        ('{"op": "advertise", "topic": "/uoarm/nothing", "type": "x"}', "no function"),
        ('{"op": "advertise_service", "service": "/uoarm/add", "type": "x"}', "belongs to"),
        (b"\x80\x04", "a binary frame"),
    ],
)
def test_every_mistake_is_reported(enter: Enter, frame: str | bytes, said: str) -> None:
    client = enter()
    client.socket.send(frame)
    status = client.receive()
    assert (status["op"], status["level"]) == ("status", "error")
    assert said in status["msg"]
    assert client.call("/rosapi/get_time")["time"]["secs"] > 0


def test_a_client_can_ask_for_no_status(enter: Enter) -> None:
    client = enter()
    client.send(op="set_level", level="none")
    client.send(op="dance")
    assert client.call("/rosapi/has_param", {"name": "x"}) == {"exists": False}


def test_clients_publish_to_one_another(enter: Enter) -> None:
    speaker, listener, late = enter(), enter(), enter()
    listener.send(op="subscribe", topic="/chatter", type="std_msgs/String")
    listener.call("/rosapi/topics")
    speaker.send(op="advertise", topic="/chatter", type="std_msgs/String", latch=True)
    speaker.send(op="publish", topic="/chatter", msg={"data": "hello"})
    assert listener.messages(1) == [{"data": "hello"}]
    late.send(op="subscribe", topic="/chatter")
    assert late.messages(1) == [{"data": "hello"}]
    assert "/chatter" in late.call("/rosapi/topics")["topics"]
    assert late.refused(op="advertise", topic="/chatter", type="x/Y").startswith("message: ")
    speaker.send(op="unadvertise", topic="/chatter")
    speaker.call("/rosapi/topics")
    after = enter()
    after.send(op="subscribe", topic="/chatter")
    assert "/chatter" in after.call("/rosapi/topics")["topics"]


def test_a_topic_is_published_until_its_last_advertisement_is_taken_back(enter: Enter) -> None:
    speaker = enter()

    def is_there() -> bool:
        return "/chatter" in speaker.call("/rosapi/topics")["topics"]

    for identity in ("a", "b", "c"):
        speaker.send(op="advertise", id=identity, topic="/chatter", type="std_msgs/String")
    speaker.send(op="unadvertise", id="b", topic="/chatter")
    assert is_there()
    assert "does not" in speaker.refused(op="unadvertise", id="b", topic="/chatter")
    speaker.send(op="unadvertise", id="a", topic="/chatter")
    assert is_there()
    speaker.send(op="unadvertise", id="c", topic="/chatter")
    assert not is_there()
    for identity in ("a", "b"):
        speaker.send(op="advertise", id=identity, topic="/chatter", type="std_msgs/String")
    speaker.send(op="unadvertise", topic="/chatter")  # without an id: all
    assert not is_there()
    for number in range(64):
        speaker.send(op="advertise", id=number, topic="/chatter", type="std_msgs/String")
    more = {"op": "advertise", "id": 64, "topic": "/chatter", "type": "std_msgs/String"}
    assert speaker.refused(**more).startswith("limit: ")


def test_clients_provide_services_to_one_another(enter: Enter) -> None:
    provider, caller, rival = enter(), enter(), enter()
    provider.send(op="advertise_service", service="/half", type="x/Half")
    assert "/half" in provider.call("/rosapi/services")["services"]
    caller.send(op="call_service", id="1", service="/half", args={"x": 4})
    request = provider.receive()
    assert (request["op"], request["args"]) == ("call_service", {"x": 4})
    forged = rival.refused(op="service_response", id=request["id"], result=True, values={})
    assert "no call waits" in forged
    assert "another client" in rival.refused(op="advertise_service", service="/half", type="y")
    provider.send(
        op="service_response", id=request["id"], service="/half", values={"x": 2}, result=True
    )
    assert caller.receive()["values"] == {"x": 2}


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        ('{"op": "service_response", "id": "ID", "values": {}}', "'result' is missing"),
        ('{"op": "service_response", "id": "other", "result": true}', "no call waits"),
        ('{"op": "service_response", "id": "ID", "values": {}, "result": {}}', "true or false"),
        ("{", "the last answer of the client that provides it"),
    ],
)
def test_a_client_that_waits_learns_which_answer_was_refused(
    enter: Enter, answer: str, why: str
) -> None:
    provider, caller = enter(), enter()
    provider.send(op="advertise_service", service="/half", type="x/Half")
    provider.call("/rosapi/services")
    caller.send(op="call_service", id="1", service="/half", timeout=0.5 * slowness())
    request = provider.receive()
    provider.socket.send(answer.replace("ID", request["id"]))
    response = caller.receive()
    assert (response["result"], response["id"]) == (False, "1")
    assert "did not answer within" in response["values"]
    assert why in response["values"]


def test_a_provider_that_goes_fails_those_who_wait(server: Server) -> None:
    with Ros(url(server)) as caller:
        with Ros(url(server)) as provider:
            provider.send(op="advertise_service", service="/half", type="x/Half")
            provider.call("/rosapi/services")
            caller.send(op="call_service", id="1", service="/half")
            provider.receive()
        response = caller.receive()
        assert response["result"] is False
        assert "has gone" in response["values"]
        assert "/half" not in caller.call("/rosapi/services")["services"]


def test_throttling_without_a_queue_drops_and_with_one_keeps(
    enter: Enter, robot: RobotManager
) -> None:
    dropping, keeping = enter(), enter()
    dropping.send(op="subscribe", topic="/uoarm/numbers", throttle_rate=3_600_000)
    keeping.send(op="subscribe", topic="/uoarm/numbers", throttle_rate=20, queue_length=2)
    opened(robot, 1)
    keeping.call("/rosapi/topics")
    dropping.call("/rosapi/topics")
    script.put(*({"value": value} for value in range(10)))
    assert keeping.messages(3) == [{"value": 0}, {"value": 8}, {"value": 9}]
    assert dropping.messages(1) == [{"value": 0}]
    dropping.send(op="set_level", level="none")
    assert dropping.call("/rosapi/get_param_names") == {"names": []}


def test_subscriptions_end_by_id(enter: Enter, robot: RobotManager) -> None:
    client = enter()
    client.send(op="subscribe", id="a", topic="/uoarm/numbers")
    client.send(op="subscribe", id="b", topic="/uoarm/numbers")
    opened(robot, 1)
    client.send(op="unsubscribe", id="a", topic="/uoarm/numbers")
    client.call("/rosapi/topics")
    script.put({"value": 1})
    assert client.messages(1) == [{"value": 1}]
    client.send(op="unsubscribe", id="b", topic="/uoarm/numbers")
    opened(robot, 0)


def test_the_densest_compression_that_is_asked_for_holds(enter: Enter, robot: RobotManager) -> None:
    client, topic = enter(), "/uoarm/picture"
    client.send(op="subscribe", id="none", topic=topic)
    client.send(op="subscribe", id="cbor", topic=topic, compression="cbor")
    opened(robot, 1)
    message = {"width": 1, "data": bytes(300)}

    def received() -> dict[str, Any]:
        client.call("/rosapi/get_time")  # what was sent before has its effect
        script.put(message)
        return client.receive()

    dense = {"op": "publish", "topic": topic, "msg": message}
    assert received() == dense
    client.send(op="subscribe", id="png", topic=topic, compression="png")
    assert received() == dense
    client.send(op="unsubscribe", id="cbor", topic=topic)
    text = {"width": 1, "data": base64.b64encode(bytes(300)).decode()}
    assert unpacked(received())["msg"] == text
    client.send(op="unsubscribe", id="png", topic=topic)
    assert received() == dense | {"msg": text}


def test_the_shortest_fragments_that_are_asked_for_come(enter: Enter, robot: RobotManager) -> None:
    client = enter()
    for identity, size in (("1", 0), ("2", 100), ("3", 200)):
        client.send(op="subscribe", id=identity, topic="/uoarm/picture", fragment_size=size)
    opened(robot, 1)
    client.call("/rosapi/get_time")
    script.put({"width": 1, "data": bytes(300)})
    assert len(client.receive()["data"]) == 100


@pytest.mark.parametrize("topic", ["/chatter", "/uoarm/navigate/status"])
def test_a_compression_that_is_refused_leaves_the_others(
    enter: Enter, robot: RobotManager, topic: str
) -> None:
    client = enter()
    client.send(op="subscribe", id="1", topic=topic)
    client.call("/rosapi/get_time")
    text = client.refused(op="subscribe", id="2", topic=topic, compression="cbor-raw")
    assert "ask for cbor instead of cbor-raw" in text
    client.send(op="unsubscribe", id="1", topic=topic)
    opened(robot, 0)


def test_fragments_both_ways(enter: Enter, robot: RobotManager) -> None:
    client = enter()
    client.send(op="subscribe", topic="/uoarm/picture", fragment_size=100)
    opened(robot, 1)
    script.put({"width": 1, "data": bytes(300)})
    pieces = [client.receive()]
    pieces += [client.receive() for _ in range(pieces[0]["total"] - 1)]
    assert all(len(item["data"]) <= 100 for item in pieces)
    assert [item["num"] for item in pieces] == list(range(len(pieces)))
    whole = json.loads("".join(item["data"] for item in pieces))
    assert len(base64.b64decode(whole["msg"]["data"])) == 300
    text = json.dumps({"op": "call_service", "id": "f", "service": "/uoarm/add", "args": [1, 2]})
    halves = [text[:20], text[20:]]
    for number in (1, 0):
        client.send(op="fragment", id="x", data=halves[number], num=number, total=2)
    assert client.receive()["values"] == {"value": 3}


@pytest.mark.parametrize(
    "fields",
    [
        {"op": "call_service", "service": "/uoarm/add", "args": [1, 2]},
        {"op": "send_action_goal", "action": "/uoarm/add", "args": [1, 2]},
    ],
)
def test_an_answer_comes_in_fragments(enter: Enter, fields: dict[str, Any]) -> None:
    client = enter()
    client.send(id="x" * 300, fragment_size=100, **fields)
    pieces = [client.receive()]
    pieces += [client.receive() for _ in range(pieces[0]["total"] - 1)]
    assert len(pieces) > 3
    assert {item["id"] for item in pieces} == {pieces[0]["id"]}
    whole = json.loads("".join(item["data"] for item in pieces))
    assert (whole["id"], whole["values"]) == ("x" * 300, {"value": 3})


def test_the_level_of_status_messages_can_be_set_back(enter: Enter) -> None:
    client = enter()
    client.send(op="set_level", level="none")
    client.send(op="dance")
    client.send(op="set_level", level="warning")
    assert "unknown op" in client.refused(op="dance", id="second")


@pytest.mark.parametrize(
    "options", [{}, {"compression": "cbor"}, {"throttle_rate": 3_600_000, "queue_length": 10}]
)
def test_the_end_of_a_function_is_reported_after_its_last_message(
    enter: Enter, robot: RobotManager, options: dict[str, object]
) -> None:
    client = enter()
    if not options:
        script.put({"value": 1}, {"value": 2}, END)  # it has finished before it is received
    client.send(op="subscribe", id="s", topic="/uoarm/numbers", **options)
    if options:
        opened(robot, 1)
        script.put({"value": 1}, {"value": 2}, END)
    assert client.messages(2) == [{"value": 1}, {"value": 2}]
    status = client.receive()
    assert status["id"] == "s"
    assert "finished" in status["msg"]


@pytest.mark.parametrize("op", ["subscribe", "publish"])
def test_an_opening_that_fails_unexpectedly_is_reported(
    enter: Enter, robot: RobotManager, monkeypatch: pytest.MonkeyPatch, op: str
) -> None:
    def fail(*asked: object, **options: object) -> NoReturn:
        raise ValueError("a mistake of a bridge")

    monkeypatch.setattr(robot, "request", fail)
    text = enter().refused(op=op, id="1", topic="/uoarm/echo", msg={"value": 1})
    assert text == "internal: the server failed; its log says more (UOA-708)"


def test_an_input_whose_function_ended_leaves_nothing(enter: Enter, robot: RobotManager) -> None:
    client = enter()
    client.send(op="publish", topic="/uoarm/echo", msg={"value": 1})
    opened(robot, 1)
    end(robot)
    report = client.receive()["msg"]
    if report.startswith("closed: "):  # the message itself, where it was still on its way
        report = client.receive()["msg"]
    assert "/uoarm/echo has closed" in report
    eventually(lambda: not publications(), "the publication is gone")


def test_an_input_whose_function_ends_as_it_opens_fails_what_waits(
    enter: Enter, robot: RobotManager, monkeypatch: pytest.MonkeyPatch
) -> None:
    join = FeedRegistry.join

    async def late(registry: FeedRegistry, *asked: Any, **options: Any) -> Feed:
        feed = await join(registry, *asked, **options)
        await asyncio.to_thread(end, robot)
        await asyncio.to_thread(eventually, lambda: feed.end is not None, "it has ended")
        return feed

    monkeypatch.setattr(FeedRegistry, "join", late)
    client = enter()
    client.send(op="publish", topic="/uoarm/echo", msg={"value": 1})
    for _ in range(2):  # the topic's end, and the message that is not sent
        assert "/uoarm/echo has closed" in client.receive()["msg"]
    eventually(lambda: not publications(), "the publication is gone")


def publications() -> list[object]:
    gc.collect()
    return [object_ for object_ in gc.get_objects() if isinstance(object_, InputPublication)]


def test_rosapi_shows_functions_and_components(enter: Enter) -> None:
    client = enter()
    topics = client.call("/rosapi/topics")
    found = dict(zip(topics["topics"], topics["types"], strict=True))
    assert found["/uoarm/numbers"] == "Number"
    assert client.call("/rosapi/topic_type", {"topic": "/uoarm/numbers"}) == {"type": "Number"}
    assert "/uoarm/numbers" in client.call("/rosapi/topics_for_type", {"type": "Number"})["topics"]
    assert "/uoarm/add" in client.call("/rosapi/services")["services"]
    assert client.call("/rosapi/service_type", {"service": "/uoarm/add"}) == {"type": "Pair"}
    assert "/adder" in client.call("/rosapi/nodes")["nodes"]
    details = client.call("/rosapi/node_details", {"node": "/echo"})
    assert details["subscribing"] == details["publishing"] == ["/uoarm/echo"]
    assert client.call("/rosapi/publishers", {"topic": "/uoarm/numbers"}) == {
        "publishers": ["/numbers"]
    }
    raw = client.call("/rosapi/topics_and_raw_types")
    text = dict(zip(raw["topics"], raw["typedefs_full_text"], strict=True))["/uoarm/picture"]
    assert text == "int64 width\nuint8[] data\n"
    for name in ("/uoarm/add", "Pair"):
        providers = client.call("/rosapi/service_providers", {"service": name})["providers"]
        assert providers == ["/adder"]
    assert client.call("/rosapi/get_ros_version")["version"] == 2
    default = client.call("/rosapi/get_param", {"name": "x", "default_value": "7"})
    assert default["value"] == "7"
    picture = client.call("/rosapi/message_details", {"type": "Picture"})["typedefs"][0]
    assert picture["fieldnames"] == ["width", "data"]
    assert picture["fieldtypes"] == ["int64", "uint8"]
    assert picture["fieldarraylen"] == [-1, 0]
    request = client.call("/rosapi/service_request_details", {"type": "Pair"})["typedefs"][0]
    assert request["fieldtypes"] == ["float64", "float64"]


def test_its_own_port_serves_rosbridge_on_every_path(serve: Serve) -> None:
    server = serve(front_end_ports={"rosbridge": 0})
    with Ros(f"ws://127.0.0.1:{server.ports[1]}/") as client:
        assert client.call("/uoarm/add", [1, 2]) == {"value": 3}


def test_a_client_that_goes_leaves_nothing(server: Server, robot: RobotManager) -> None:
    with Ros(url(server)) as client:
        client.send(op="subscribe", topic="/uoarm/numbers")
        client.send(op="subscribe", topic="/chatter")
        client.send(op="advertise", topic="/uoarm/echo", type="x")
        client.send(op="advertise", topic="/talk", type="x")
        opened(robot, 2)
    opened(robot, 0)
    with Ros(url(server)) as other:
        eventually(
            lambda: not {"/chatter", "/talk"} & set(other.call("/rosapi/topics")["topics"]),
            "its topics are gone",
        )


def test_topics_are_limited(serve: Serve) -> None:
    server = serve(Limits(streams=1))
    with Ros(url(server)) as client:
        client.send(op="subscribe", topic="/a")
        assert client.refused(op="subscribe", topic="/b").startswith("limit: ")


piece = st.fixed_dictionaries(
    {
        "id": st.sampled_from(["a", "b"]),
        "data": st.text(max_size=5) | st.none(),
        "num": st.integers(-1, 4) | st.floats(0, 3),
        "total": st.integers(-1, 5),
    }
)


@given(st.lists(piece, max_size=30))
def test_no_fragments_at_all_break_the_collector(pieces: list[dict[str, Any]]) -> None:
    fragments = Fragments(700, 1.0)
    for item in pieces:
        with suppress(ControlMessageError):
            fragments.add(item)
        assert 0 <= fragments.octets <= 700


def test_unfinished_messages_are_bounded_in_memory_and_counted_until_they_are_whole() -> None:
    fragments = Fragments(10_000, 1.0)
    for place in range(60):
        fragments.add({"id": "a", "data": "", "num": place, "total": 1000})
    with pytest.raises(ControlMessageError, match="10,000 octets wait"):
        fragments.add({"id": "a", "data": "x" * 5000, "num": 60, "total": 1000})
    assert fragments.octets == 0
    assert fragments.add({"id": "b", "data": "x", "num": 1, "total": 2}) is None
    assert fragments.octets > 0
    assert fragments.add({"id": "b", "data": "y", "num": 0, "total": 2}) == "yx"
    assert fragments.octets == 0


names = st.sampled_from(["/uoarm/numbers", "/t", "/uoarm/add", "/uoarm/navigate", "/uoarm/"])
wild = st.dictionaries(
    st.sampled_from(["id", "topic", "service", "action", "status", "feedback", "type", "msg",
                     "args", "values", "result", "level", "throttle_rate",
                     "queue_length", "fragment_size", "compression", "latch"]),
    st.none() | st.booleans() | st.integers(-5, 5) | st.text(max_size=5)
    | names | st.lists(st.integers(0, 3), max_size=2)
    | st.dictionaries(st.just("value"), st.integers()),
    max_size=6,
)  # fmt: skip
likely = st.fixed_dictionaries(
    {},
    optional={
        "topic": names,
        "compression": st.sampled_from(["none", "png", "cbor", "cbor-raw"]),
        "msg": st.dictionaries(st.sampled_from(["value", "x"]), st.integers()),
    },
)
operation = st.sampled_from(
    ["advertise", "unadvertise", "publish", "subscribe", "unsubscribe", "call_service",
     "advertise_service", "unadvertise_service", "service_response", "fragment", "status",
     "send_action_goal", "cancel_action_goal", "advertise_action", "unadvertise_action",
     "action_feedback", "action_result"]
)  # fmt: skip


# The server's thread makes random ping payloads while hypothesis draws in this one.
@pytest.mark.filterwarnings("ignore:Do not use the .random. module")
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(steps=st.lists(st.tuples(operation, wild, likely), max_size=6))
def test_no_operations_at_all_break_the_endpoint(
    server: Server, steps: list[tuple[str, dict[str, Any], dict[str, Any]]]
) -> None:
    with Ros(url(server)) as client:
        for op, fields, more in steps:
            client.send(**{**fields, **more, "op": op})
        client.send(op="call_service", id="last one", service="/rosapi/get_time")
        reports = client.receive()
        while reports.get("id") != "last one":
            assert "its log says more" not in str(reports)
            reports = client.receive()


def test_a_message_in_pieces_that_is_not_finished_in_time_is_let_go(serve: Serve) -> None:
    server = serve(Limits(message_seconds=0.3 * slowness()))
    with Ros(url(server)) as client:
        client.send(op="fragment", id="m", data="x" * 100_000, num=0, total=2)
        eventually(lambda: server.held_octets > 100_000, "it is held")
        reports = client.receive()
        assert (reports["op"], reports["level"]) == ("status", "error")
        assert "message 'm' was not finished within" in reports["msg"]
        eventually(lambda: server.held_octets < 10_000, "it was let go")


@pytest.mark.parametrize(
    ("numbers", "rest", "why"),
    [
        ([], "", "was not finished within"),
        ([2, 3, 4, 5], "x" * 50_000, "more than 200,000 octets wait"),
        ([1], "x", "piece 1 of 7 fits no message"),
        ([2, 3, 4, 5, 6], "x", "JSON"),
    ],
)
def test_a_call_in_pieces_that_is_refused_is_answered(
    serve: Serve, numbers: list[int], rest: str, why: str
) -> None:
    seconds = 30 if numbers else 0.3 * slowness()
    server = serve(Limits(message_seconds=seconds, message_bytes=100_000))
    call = json.dumps({"op": "call_service", "id": "mine", "service": "/uoarm/add", "args": {}})
    with Ros(url(server)) as client:
        for number, data in [(0, call[:20]), (1, call[20:-1]), *((at, rest) for at in numbers)]:
            client.send(op="fragment", id="f", data=data, num=number, total=7)
        answer = client.receive()
    assert (answer["op"], answer["id"], answer["result"]) == ("service_response", "mine", False)
    assert why in answer["values"]


def test_pieces_find_no_room_where_others_and_their_sender_have_too_much(serve: Serve) -> None:
    server = serve(Limits(message_bytes=200_000, total_memory_bytes=200_000))
    with Ros(url(server)) as client, Ros(url(server)) as other:
        reports = {"op": "service_response"}
        for number in range(5):
            if reports["op"] == "service_response":
                client.send(op="fragment", id="m", data="x" * 50_000, num=number, total=9)
                client.send(op="call_service", service="/rosapi/get_time")
                reports = client.receive()
        assert "holds as much as it may" in reports["msg"]
        assert other.call("/rosapi/get_time")


@pytest.mark.parametrize(
    ("op", "kind", "answer"),
    [
        ("call_service", "service", "service_response"),
        ("send_action_goal", "action", "action_result"),
    ],
)
def test_a_call_that_is_too_much_to_be_read_has_its_answer(
    enter: Enter, op: str, kind: str, answer: str
) -> None:
    client = enter()
    client.send(op=op, id="call:1", **{kind: "/uoarm/add"}, args={"a": [0] * 600_000})
    failed = client.receive()
    assert (failed["op"], failed["id"], failed[kind]) == (answer, "call:1", "/uoarm/add")
    assert failed["result"] is False
    assert "500,000 values" in failed["values"]


@pytest.mark.parametrize(
    ("frame", "fields"),
    [
        (
            '{"op":"publish","id":3 , "topic" : "/é","msg":[[',
            {"op": "publish", "id": 3, "topic": "/é"},
        ),
        ('{"op":"a\\\\u0041","id":"1"}', {}),
        ('{"op":1.5,"id":"1"}', {}),
        ('{"op":1e5,"id":"1"}', {}),
        ('{"op":true,"id":"1"}', {}),
        ('{"msg":{"op":"call_service"', {}),
        ('{"op":"' + "x" * 2_000 + '"}', {}),
        ('{"op":"a\nb"}', {}),
        ("", {}),
        (b'{"op":"publish"}', {}),
    ],
)
def test_what_cannot_be_read_has_its_first_fields(
    frame: str | bytes, fields: dict[str, object]
) -> None:
    assert first_fields(frame) == fields
