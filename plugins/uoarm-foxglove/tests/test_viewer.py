"""A viewer before a robot: channels, messages, publications, calls, rights and bounds."""

from __future__ import annotations

import asyncio
import gc
import json
import struct
import time
import weakref
from functools import partial
from pathlib import Path
from typing import Any, NoReturn
from unittest.mock import AsyncMock, MagicMock, Mock

import components
import pytest
from components import loose_script, numbers_script, pictures_script
from uoarm_foxglove import _catalogue
from uoarm_foxglove._catalogue import (
    ChannelCatalogue,
    InputTopic,
    ListingQuestion,
    VisibleListing,
)
from uoarm_foxglove._front_end import FoxgloveSession
from viewer import SUBPROTOCOLS, Serve, Viewer

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.server import Limits, ServerOptions, serve_in_thread
from uoarm.server.access import AccessRole, hash_token, make_token
from uoarm.server.front_end import BusyError
from uoarm.testing import MemoryBridge, wait

HEADER = b"\0\1\0\0"


def int32(number: int) -> bytes:
    return HEADER + struct.pack("<i", number)


@pytest.mark.parametrize("subprotocol", SUBPROTOCOLS)
def test_a_viewer_is_served_under_either_name(serve: Serve, subprotocol: str) -> None:
    with Viewer(serve(), subprotocol) as viewer:
        assert viewer.socket.subprotocol == subprotocol
        assert viewer.info["supportedEncodings"] == ["cdr", "json"]
        assert viewer.info["capabilities"] == [
            "clientPublish",
            "connectionGraph",
            "parameters",
            "parametersSubscribe",
            "services",
        ]


def test_a_viewer_of_ros_2_is_to_publish_its_types(robot: RobotManager) -> None:
    bridge = MemoryBridge()
    text = "{version: 1, bridges: {robot: {plugin: ros2}}, functions: {}}"
    with RobotManager(loads(text), bridges={"robot": bridge}) as of_ros:
        for manager, metadata in ((robot, {}), (of_ros, {"ROS_DISTRO": "jazzy"})):
            with (
                serve_in_thread(manager, ServerOptions(port=0)) as server,
                Viewer(server) as viewer,
            ):
                assert viewer.info["metadata"] == metadata
    bridge.close()


def test_every_output_is_a_channel_with_its_schema(serve: Serve) -> None:
    with Viewer(serve()) as viewer:
        numbers, loose = viewer.channel("/numbers"), viewer.channel("/loose")
        assert (numbers["encoding"], numbers["schemaEncoding"]) == ("cdr", "ros2msg")
        assert numbers["schemaName"] == "std_msgs/msg/Int32"
        assert numbers["schema"] == "int32 data\n"
        assert (loose["encoding"], loose["schemaEncoding"]) == ("json", "jsonschema")
        assert json.loads(loose["schema"])["properties"].keys() == {"any_number", "text"}
        assert {"/picture", "/doubled", "/echo", "/note"} < {*viewer.channels}


def test_a_robot_without_an_output_has_an_empty_list_of_channels(
    serve: Serve, robot: RobotManager
) -> None:
    robot.apply(loads("version: 1\nbridges: {python: {}}\nfunctions: {}"))
    with Viewer(serve()) as viewer:
        assert viewer.until("advertise")["channels"] == []


def test_a_schema_says_what_viewers_can_read_of_it(serve: Serve) -> None:
    with Viewer(serve()) as viewer:
        odd, level = viewer.channel("/odd"), viewer.channel("/level")
        fields = {"count": {"type": "integer"}, "perhaps": {"type": "number"}}
        assert json.loads(odd["schema"]) == {"type": "object", "properties": fields}
        assert (level["encoding"], level["schema"]) == ("json", "")


def test_a_viewer_that_can_be_shown_nothing_is_warned(
    serve: Serve, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def make(*_: object) -> NoReturn:
        raise ValueError("a fault of this catalogue")

    monkeypatch.setattr(ChannelCatalogue, "make", make)
    with Viewer(serve()) as viewer:
        assert "its log says more" in viewer.until("status")["message"]
    assert "a fault of this catalogue" in caplog.text


@pytest.mark.parametrize("turns", range(4))
async def test_a_viewer_that_goes_as_it_asks_is_shown_nothing_more(turns: int) -> None:
    catalogue = Mock(answer=AsyncMock(side_effect=BusyError("too busy")), identity="server")
    session = FoxgloveSession(Mock(), MagicMock(), catalogue)
    for _ in range(4):
        await asyncio.sleep(0)
    session._look_now.set()
    for _ in range(turns):
        await asyncio.sleep(0)
    session.close()
    for _ in range(4):
        await asyncio.sleep(0)
    assert session._showing.cancelled()


def test_of_a_role_that_asks_no_more_nothing_is_kept(robot: RobotManager) -> None:
    catalogue = ChannelCatalogue(Mock())

    def made(name: str) -> weakref.ref[VisibleListing]:
        catalogue._found = robot.config, {}
        question = ListingQuestion(AccessRole(name))
        return weakref.ref(catalogue.make([question])[question].listing)

    first, again = made("first"), made("first")
    assert first() is again(), "what is equal is not made again"
    made("second"), made("second")
    gc.collect()
    assert first() is None


def test_messages_come_in_the_encoding_of_their_channel(serve: Serve) -> None:
    with Viewer(serve()) as viewer:
        viewer.subscribe("/numbers", 4)
        viewer.subscribe("/loose", 5)
        before = time.time_ns()
        numbers_script.put({"data": 1}, {"data": -2})
        first, second = viewer.until(1), viewer.until(1)
        assert [first["data"], second["data"]] == [int32(1), int32(-2)]
        assert first["subscription"] == 4
        assert before <= first["stamp"] <= time.time_ns()
        loose_script.put({"text": "grün"})
        assert json.loads(viewer.until(1)["data"]) == {"text": "grün"}


def test_two_viewers_get_the_same_message_each_by_its_own_number(serve: Serve) -> None:
    def gets_one(viewer: Viewer) -> bool:
        numbers_script.put({"data": 3})  # what came before it had joined was not for it
        return viewer.has(1)

    server = serve()
    with Viewer(server) as one, Viewer(server) as other:
        viewers = {4: one, 9: other}
        for number, viewer in viewers.items():
            viewer.subscribe("/numbers", number)
        for viewer in viewers.values():
            wait(partial(gets_one, viewer), "it gets nothing")
        numbers_script.put({"data": 4})
        for number, viewer in viewers.items():
            while (got := viewer.until(1))["data"] != int32(4):
                assert (got["subscription"], got["data"]) == (number, int32(3))
            assert got["subscription"] == number


def test_octets_are_binary_in_cdr(serve: Serve) -> None:
    with Viewer(serve()) as viewer:
        assert viewer.channel("/picture")["schema"] == "int32 width\nuint8[] data\n"
        viewer.subscribe("/picture")
        pictures_script.put({"width": 2, "data": b"\x00\xff"})
        assert viewer.until(1)["data"] == int32(2) + struct.pack("<I", 2) + b"\x00\xff"


def test_the_end_of_a_function_is_reported_after_its_last_message(serve: Serve) -> None:
    numbers_script.put({"data": 1}, {"data": 2}, numbers_script.END)
    with Viewer(serve()) as viewer:
        viewer.subscribe("/numbers")
        assert [viewer.until(1)["data"] for _ in range(2)] == [int32(1), int32(2)]
        assert "/numbers has closed: " in viewer.until("status")["message"]
        assert "status" not in {other["op"] for other in viewer.others}


def test_no_more_comes_after_unsubscribing(serve: Serve, robot: RobotManager) -> None:
    with Viewer(serve()) as viewer:
        viewer.subscribe("/numbers")
        numbers_script.put({"data": 1})
        viewer.until(1)
        viewer.send("unsubscribe", subscriptionIds=[1])
        wait(lambda: not robot.status().connections, "it stays open")
        viewer.send("unsubscribe", subscriptionIds=[1])
        assert "there is no 1" in viewer.until("status")["message"]


@pytest.mark.parametrize(
    ("encoding", "octets"), [("json", b'{"data": 7}'), ("cdr", int32(7))], ids=["json", "cdr"]
)
def test_what_a_viewer_publishes_reaches_the_input(
    serve: Serve, encoding: str, octets: bytes
) -> None:
    with Viewer(serve()) as viewer:
        viewer.channel("/echo")
        viewer.send(
            "advertise",
            channels=[{"id": 3, "topic": "/echo", "encoding": encoding, "schemaName": "Int32"}],
        )
        viewer.publish(3, octets)
        wait(lambda: components.taken == [{"data": 7}], "nothing arrived")
        viewer.publish(3, b"{}" if encoding == "json" else HEADER)
        status = viewer.until("status")
        assert status["level"] == 2
        assert "data" in status["message"] or "cannot be read" in status["message"], status
        viewer.publish(3, octets)
        wait(lambda: len(components.taken) == 2, "the next one is lost")


def test_octets_of_another_type_of_ros_reach_no_input(serve: Serve) -> None:
    with Viewer(serve()) as viewer:
        viewer.channel("/echo")
        for number, name in enumerate(("std_msgs/msg/Float32", "std_msgs/Int32")):
            stated = {"topic": "/echo", "encoding": "cdr", "schemaName": name}
            viewer.send("advertise", channels=[{"id": number, **stated}])
        viewer.publish(0, HEADER + struct.pack("<f", 0.5))
        assert "expected a message of std_msgs/msg/Int32" in viewer.until("status")["message"]
        viewer.publish(1, int32(7))
        wait(lambda: components.taken == [{"data": 7}], "nothing arrived")


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"id": 1, "topic": "/nothing", "encoding": "json"}, "/nothing: there is no such input"),
        ({"id": 1, "topic": "/echo/in", "encoding": "json"}, "did you mean '/echo'?"),
        ({"id": 1, "topic": "/echo", "encoding": "protobuf"}, "expected cdr or json"),
        ({"id": -1, "topic": "/echo", "encoding": "json"}, "id: expected a number"),
        ({"id": 1, "encoding": "json"}, "topic: expected a text"),
    ],
)
def test_a_channel_that_cannot_be_advertised_is_refused(
    serve: Serve, fields: dict[str, object], text: str
) -> None:
    with Viewer(serve()) as viewer:
        viewer.channel("/echo")
        viewer.send("advertise", channels=[fields])
        assert text in viewer.until("status")["message"]
        viewer.publish(1, b"{}")
        assert "there is no channel 1" in viewer.until("status")["message"]


class Inputs(dict[str, InputTopic]):
    """Are looked up by name only: of a robot there may be thousands."""

    def __iter__(self) -> NoReturn:
        raise AssertionError("all inputs were looked at")


def test_a_wrong_topic_is_compared_with_no_other(
    serve: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = _catalogue.VisibleListing

    def listing(channels: Any, services: Any, inputs: Any, *more: Any) -> Any:
        return made(channels, services, Inputs(inputs), *more)

    monkeypatch.setattr(_catalogue, "VisibleListing", listing)
    with Viewer(serve()) as viewer:
        viewer.channel("/echo")
        viewer.send("advertise", channels=[{"id": 1, "topic": "/eco", "encoding": "json"}])
        assert "there is no such input" in viewer.until("status")["message"]


def test_a_service_is_called_and_its_failure_is_the_calls(serve: Serve) -> None:
    with Viewer(serve()) as viewer:
        pair = HEADER + struct.pack("<dd", 1, 2)
        viewer.call("/add", pair, number=8)
        reply = viewer.until(3)
        assert (reply["call"], reply["encoding"], reply["data"]) == (8, "cdr", int32(3))
        viewer.call("/broken", pair, number=9)
        failure = viewer.until("serviceCallFailure")
        assert failure["callId"] == 9
        assert "a fault of this service" in failure["message"]
        viewer.call("/add", HEADER)
        assert "cannot be read" in viewer.until("serviceCallFailure")["message"]
        viewer.call("/add", b"{}", "protobuf")
        assert "'protobuf' is not served" in viewer.until("serviceCallFailure")["message"]
        for length in (4, 33, 2**32 - 1):
            head = struct.pack("<BIII", 2, viewer.service("/add")["id"], 7, length)
            viewer.socket.send(head + b"cdr")
            failure = viewer.until("serviceCallFailure")
            assert failure["callId"] == 7
            assert f"'of {length:,} octets' is not served" in failure["message"]


def test_a_service_is_called_in_either_encoding_that_the_server_states(serve: Serve) -> None:
    with Viewer(serve()) as viewer:
        assert viewer.info["supportedEncodings"] == ["cdr", "json"]
        viewer.call("/add", b'{"a": 1, "b": 2}', "json")
        reply = viewer.until(3)
        assert (reply["encoding"], reply["data"]) == ("json", b'{"data":3}')
        viewer.call("/add", b"{}", "json")
        assert "'a' and 'b' are missing" in viewer.until("serviceCallFailure")["message"]


def test_the_graph_says_who_publishes_subscribes_and_serves(serve: Serve) -> None:
    with Viewer(serve()) as viewer:
        viewer.service("/add")
        viewer.send("subscribeConnectionGraph")
        graph = viewer.until("connectionGraphUpdate")
        assert {"name": "/numbers", "publisherIds": ["counter"]} in graph["publishedTopics"]
        assert {"name": "/numbers", "subscriberIds": ["doubler"]} in graph["subscribedTopics"]
        assert {"name": "/add", "providerIds": ["adder"]} in graph["advertisedServices"]


def test_of_a_topic_that_stays_the_graph_says_that_none_subscribes_it_any_more(
    serve: Serve, robot: RobotManager
) -> None:
    with Viewer(serve()) as viewer:
        viewer.send("subscribeConnectionGraph")
        viewer.until("connectionGraphUpdate")
        text = components.CONFIGURATION.replace("input: {from: numbers, ", "input: {")
        robot.apply(loads(text, origin=str(Path(__file__).parent / "robot.yaml")))
        graph = viewer.until("connectionGraphUpdate")
        assert graph["subscribedTopics"] == [{"name": "/numbers", "subscriberIds": []}]
        assert graph["publishedTopics"] == graph["removedTopics"] == []


def test_a_viewer_that_comes_back_knows_the_server(serve: Serve) -> None:
    server = serve()
    with Viewer(server) as first, Viewer(server) as second, Viewer(serve()) as other:
        assert first.info["sessionId"] == second.info["sessionId"] != other.info["sessionId"]
        assert first.channel("/numbers") == second.channel("/numbers")


def test_a_changed_robot_is_announced(serve: Serve, robot: RobotManager) -> None:
    with Viewer(serve()) as viewer:
        gone = viewer.channel("/loose")["id"]
        viewer.service("/add")
        text = components.CONFIGURATION.replace("  loose:", "  later:")
        robot.apply(loads(text, origin=str(Path(__file__).parent / "robot.yaml")))
        assert viewer.until("unadvertise")["channelIds"] == [gone]
        assert viewer.channel("/later")["id"] != gone


def test_another_type_is_announced_though_neither_has_a_schema(
    serve: Serve, robot: RobotManager
) -> None:
    with Viewer(serve()) as viewer:
        gone = viewer.channel("/level")
        text = components.CONFIGURATION.replace("components:level", "components:words")
        robot.apply(loads(text, origin=str(Path(__file__).parent / "robot.yaml")))
        assert viewer.until("unadvertise")["channelIds"] == [gone["id"]]
        viewer.until("advertise")
        assert viewer.channels["/level"]["schemaName"] == "str"


def test_a_role_sees_and_does_what_it_may(serve: Serve, tmp_path: Path) -> None:
    access, token = tmp_path / "access.yaml", make_token()
    access.write_text(
        "version: 1\n"
        "roles: {viewer: {see: [numbers, echo, add], request: [numbers]}}\n"
        f"tokens: [{{name: screen, role: viewer, sha256: {hash_token(token)}}}]\n",
        encoding="utf-8",
    )
    with Viewer(serve(access=access), query=f"?token={token}") as viewer:
        viewer.service("/add")
        assert {*viewer.channels} == {"/numbers", "/echo"}
        viewer.subscribe("/echo")
        assert "echo" in viewer.until("status")["message"]
        viewer.send("advertise", channels=[{"id": 1, "topic": "/echo", "encoding": "json"}])
        assert viewer.until("status")["level"] == 2
        viewer.call("/add", HEADER + struct.pack("<dd", 1, 2))
        assert "call" in viewer.until("serviceCallFailure")["message"]
        viewer.send("advertise", channels=[{"id": 1, "topic": "/note", "encoding": "json"}])
        message = viewer.until("status")["message"]
        assert "no such input" in message
        assert message.endswith(" (UOA-502)")
        viewer.send("subscribeConnectionGraph")
        assert "picture" not in json.dumps(viewer.until("connectionGraphUpdate"))


@pytest.mark.parametrize(
    "frame",
    ["[]", "{}", '{"op": 3}', '{"op": "subscribe"}', '{"op": "subscribe", "subscriptions": [1]}',
     '{"op": "unsubscribe", "subscriptionIds": [{}]}', '{"op": "advertise", "channels": [[]]}',
     '{"op": "getParameters"}', b"", b"\1", b"\2\0", b"\1\0\0\0\0"],
)  # fmt: skip
def test_a_message_that_is_wrong_is_answered_and_the_viewer_stays(
    serve: Serve, frame: str | bytes
) -> None:
    with Viewer(serve()) as viewer:
        viewer.channel("/numbers")  # so that there is a channel 1
        viewer.socket.send(frame)
        assert viewer.until("status")["level"] == 2
        viewer.subscribe("/numbers")
        numbers_script.put({"data": 1})
        assert viewer.until(1)["data"] == int32(1)


def test_a_viewer_that_does_not_read_gets_what_is_newest(serve: Serve, robot: RobotManager) -> None:
    server = serve(Limits(queue_messages=8))
    with Viewer(server) as viewer:
        viewer.subscribe("/picture")
        wait(lambda: pictures_script.started, "nothing plays")
        count, most = 200, 0
        for number in range(count):
            pictures_script.put({"width": number, "data": bytes(1_000_000)})
            most = max(most, server.held_octets)
        wait(
            lambda: sum(route.delivered for route in robot.status().routes) >= count,
            "not all were emitted",
        )
        seen: list[int] = []
        while not seen or seen[-1] != count - 1:
            seen.append(struct.unpack_from("<i", viewer.until(1)["data"], 4)[0])
        assert seen == sorted(seen)
        assert len(seen) < count
        # Eight wait for the viewer, some for the loop, and one is under way.
        assert most < 48_000_000


def test_many_messages_to_one_viewer_are_all_there(serve: Serve) -> None:
    count = 4_000
    with Viewer(serve(Limits(queue_messages=count, queue_seconds=600.0))) as viewer:
        viewer.subscribe("/numbers")
        wait(lambda: numbers_script.started, "nothing plays")
        for start in range(0, count, 50):
            numbers_script.put(*({"data": number} for number in range(start, start + 50)))
            assert [viewer.until(1)["data"] for _ in range(50)] == [
                int32(number) for number in range(start, start + 50)
            ]


def test_one_that_is_wrong_costs_none_of_those_beside_it(serve: Serve) -> None:
    with Viewer(serve()) as viewer:
        known = viewer.channel("/numbers")["id"]
        wrong = [{"id": number, "channelId": 4_000_000} for number in range(10, 20)]
        viewer.send("subscribe", subscriptions=[*wrong, {"id": 4, "channelId": known}])
        texts = [viewer.until("status")["message"] for _ in range(4)]
        assert texts == [
            *(
                f"subscribe: subscriptions.{place}: channelId: there is no 4000000 (UOA-502)"
                for place in range(3)
            ),
            "and 7 more are refused (UOA-502)",
        ]
        wait(lambda: numbers_script.started, "nothing plays")
        numbers_script.put({"data": 3})
        assert viewer.until(1)["subscription"] == 4
        stated = {"encoding": "json", "schemaName": ""}
        viewer.send(
            "advertise",
            channels=[{"id": 1, "topic": "/none", **stated}, {"id": 2, "topic": "/echo", **stated}],
        )
        assert "there is no such input" in viewer.until("status")["message"]
        viewer.send("unadvertise", channelIds=[1, 2])
        refused = "unadvertise: channelIds.0: id: there is no 1 (UOA-502)"
        assert viewer.until("status")["message"] == refused
        viewer.send("unadvertise", channelIds=[2])
        assert viewer.until("status")["message"] == refused.replace("no 1", "no 2")
        viewer.send("unsubscribe", subscriptionIds=[10, 4])
        assert viewer.until("status")["message"] == (
            "unsubscribe: subscriptionIds.0: id: there is no 10 (UOA-502)"
        )
        viewer.send("unsubscribe", subscriptionIds=[4])
        assert viewer.until("status")["message"] == (
            "unsubscribe: subscriptionIds.0: id: there is no 4 (UOA-502)"
        )
