"""A connection that breaks: what stands is there again, nothing comes twice, a loss in time."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from itertools import count
from typing import Any

import pytest
from played import LISTEN, STRING, TALK, Played, asked, bridge_to
from tests.inbox import health_events  # type: ignore[import-not-found]
from tests.processes import ForkedProgram  # type: ignore[import-not-found]
from tests.server.talk import eventually  # type: ignore[import-not-found]
from uoarm_rosbridge.client._channels import ParameterSource
from websockets.protocol import State

from uoarm.bridge import Bridge
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, MessageError
from uoarm.model import Endpoint, Health, MessageStructure, Role
from uoarm.testing import Collector, Proxy, patience

LONG = min(patience(), 60)
SET = Endpoint("far", "set", Role.SERVICE, ("/set", "std_srvs/SetBool"), is_offered=True)
FLAG = {**STRING, "type": "std_srvs/SetBoolRequest", "fieldtypes": ["bool"]}
SPEED = Endpoint("far", "speed", Role.OUTPUT, ("/speed", "parameter"))


def structure(bridge: Bridge, endpoint: Endpoint = TALK) -> MessageStructure:
    made = bridge.describe(endpoint).message
    assert made is not None
    return made


def publish(played: Played, text: str) -> None:
    played.say(op="publish", topic="/chatter", msg={"data": text})


def test_what_stands_is_there_again_and_nothing_comes_twice(played: Played) -> None:
    details = {"typedefs": [FLAG]}
    played.answers |= {"service_request_details": details, "service_response_details": details}
    collector = Collector()
    with bridge_to(played.url, grace=LONG) as bridge:
        events = health_events(bridge)
        source = bridge.open_source(TALK, structure(bridge), collector.deliver)
        sink = bridge.open_sink(LISTEN, structure(bridge, LISTEN))
        bridge.serve(SET, lambda request: request)
        publish(played, "before")
        collector.wait(1)
        played.stop()
        eventually(lambda: events, "the break is reported")
        with pytest.raises(BridgeError, match="no connection to"):
            sink.send({"data": "lost"})
        played.start()
        eventually(lambda: len(events) == 2, "its end is reported")
        assert [event.health for event in events] == [Health.DEGRADED, Health.OK]
        assert {event.channel for event in events} == {None}
        for operation in ("subscribe", "advertise", "advertise_service"):
            eventually(lambda: len(asked(played, operation)) > 1, f"{operation} again")  # noqa: B023 - now
            first, second = asked(played, operation)
            assert first == second
        publish(played, "after")
        assert collector.wait(2) == [{"data": "before"}, {"data": "after"}]
        sink.send({"data": "x"})
        eventually(lambda: len(asked(played, "publish")) == 1, "the sink sends again")
        played.say(op="call_service", service="/set", id="1", args={"data": True})
        eventually(lambda: asked(played, "service_response"), "the service is served again")
        assert source.facts()["interruptions"] == 1


FORKED = """
import sys
from uoarm.bridge import Registry
from uoarm.model import BridgeSpec, Endpoint, Role

bridge = Registry().create(BridgeSpec("far", "rosbridge", {"url": sys.argv[1], "wait": 60}))
talk = Endpoint("far", "talker", Role.OUTPUT, ("/chatter",))
source = bridge.open_source(talk, bridge.describe(talk).message, print)
"""


def test_a_child_that_is_forked_holds_no_connection(played: Played) -> None:
    with ForkedProgram(FORKED, played.url) as forked:
        assert forked.read() == "forked"
        (socket,) = played.sockets
        forked.kill_parent()
        eventually(lambda: socket.protocol.state is State.CLOSED, "the server sees its end")


def test_what_was_closed_meanwhile_is_not_there_again(played: Played) -> None:
    with bridge_to(played.url, grace=LONG) as bridge:
        events = health_events(bridge)
        source = bridge.open_source(TALK, structure(bridge), Collector().deliver)
        played.stop()
        eventually(lambda: events, "the break is reported")
        source.close()
        played.start()
        eventually(lambda: len(events) == 2, "its end is reported")
        assert len(asked(played, "subscribe")) == 1


def test_a_message_that_stands_is_not_delivered_again(played: Played) -> None:
    """A server sends what is latched with each subscription."""
    latched, plain = Collector(), Collector()
    keeping = Endpoint("far", "map", Role.OUTPUT, ("/chatter",), options={"latch": True})

    def stand(socket: Any, fields: Any) -> None:
        if fields["op"] == "subscribe":
            message = {"op": "publish", "topic": "/chatter", "msg": {"data": "map"}}
            socket.send(json.dumps(message))

    played.on = stand
    with bridge_to(played.url, grace=LONG) as bridge:
        events = health_events(bridge)
        made = structure(bridge)
        bridge.open_source(keeping, made, latched.deliver)
        assert latched.wait(1) == [{"data": "map"}]
        bridge.open_source(TALK, made, plain.deliver)
        played.stop()
        played.start()
        eventually(lambda: len(events) == 2, "the break, and its end")
        assert plain.wait(1) == [{"data": "map"}]  # it does not say that it is latched
        publish(played, "new")
        publish(played, "new")
        assert latched.wait(3) == [{"data": "map"}, {"data": "new"}, {"data": "new"}]


def test_a_break_that_lasts_is_a_loss_once(played: Played) -> None:
    with bridge_to(played.url, grace=0.2) as bridge:
        events = health_events(bridge)
        bridge.open_source(TALK, structure(bridge), Collector().deliver)
        played.stop()
        eventually(lambda: len(events) == 2, "it is lost")
        played.start()
        eventually(lambda: len(events) == 3, "it is back")
        assert [event.health for event in events] == [Health.DEGRADED, Health.LOST, Health.OK]
        assert all(played.url in event.cause for event in events)


def test_a_server_that_hangs_is_reported_and_not_logged_by_the_library(
    played: Played, caplog: pytest.LogCaptureFixture
) -> None:
    port = int(played.url.rpartition(":")[2])
    with Proxy(port) as proxy, bridge_to(f"ws://127.0.0.1:{proxy.port}", silence=2.0) as bridge:
        events = health_events(bridge)
        bridge.open_source(TALK, structure(bridge), Collector().deliver)
        proxy.hold(to_client=True)
        eventually(lambda: events, "its silence is reported")
        assert events[0].health is Health.DEGRADED
        assert events[0].cause.endswith(": no answer to pings for 2 s")
    assert "keepalive ping failed" not in {record.getMessage() for record in caplog.records}


def test_a_server_that_is_another_one_now_loses_what_has_another_type(played: Played) -> None:
    with bridge_to(played.url, grace=LONG) as bridge:
        events = health_events(bridge)
        source = bridge.open_source(TALK, structure(bridge), Collector().deliver)
        other = {**STRING, "fieldtypes": ["int32"]}
        played.answers["message_details"] = {"typedefs": [other]}
        played.stop()
        played.start()
        eventually(lambda: any(event.channel is source for event in events), "it is lost")
        event = next(event for event in events if event.channel is source)
        assert event.health is Health.LOST
        assert "another type" in event.cause


def test_nodes_that_come_back_after_the_connection_are_waited_for(played: Played) -> None:
    looks: list[object] = []

    def value(arguments: object) -> object:
        looks.append(arguments)
        return {"value": "7"}

    played.answers["get_param"] = value
    with bridge_to(played.url, grace=LONG) as bridge:
        events = health_events(bridge)
        bridge.open_source(SPEED, structure(bridge, SPEED), Collector().deliver)
        bridge.open_source(TALK, structure(bridge), Collector().deliver)
        played.answers["publishers"] = {"publishers": []}
        played.sockets[-1].close()
        eventually(lambda: len(events) == 2, "the break, and its end")
        looks.clear()
        eventually(lambda: len(looks) > 2, "it was looked twice")
        assert [event.health for event in events] == [Health.DEGRADED, Health.OK]


def test_nodes_that_do_not_come_back_are_lost(played: Played) -> None:
    with bridge_to(played.url, grace=0.2) as bridge:
        events = health_events(bridge)
        source = bridge.open_source(TALK, structure(bridge), Collector().deliver)
        played.answers["publishers"] = {"publishers": []}
        played.sockets[-1].close()
        eventually(lambda: source in {event.channel for event in events}, "it is lost")
        # On a busy machine the connection itself may be away for longer than the grace, too.
        causes = {event.cause for event in events if event.channel is source}
        assert causes == {"disconnected: /chatter: no node publishes it"}


def test_a_call_that_breaks_fails_at_once_and_is_not_sent_again(played: Played) -> None:
    call = Endpoint("far", "set", Role.SERVICE, ("/set",))
    details = {"typedefs": [FLAG]}
    played.answers |= {
        "service_type": {"type": "std_srvs/SetBool"}, "service_request_details": details,
        "service_response_details": details,
    }  # fmt: skip

    def vanish(socket: Any, fields: Any) -> None:
        if fields.get("service") == "/set":
            socket.close()

    played.on = vanish
    played.answers["set"] = {"data": True}
    with bridge_to(played.url, grace=LONG) as bridge:
        played.answers.pop("set")
        with pytest.raises(BridgeError) as caught:
            bridge.call(call, {"data": True})
        assert caught.value.reason in {FailureReason.UNAVAILABLE, FailureReason.RAISED}
        calls = [fields for fields in asked(played, "call_service") if fields["service"] == "/set"]
        assert len(calls) == 1


@contextmanager
def hanging(values: object, times: int) -> Iterator[Callable[[object], object]]:
    """Give an answer that at first does not come, and holds up what comes after its question.

    That is what rosbridge_suite does, with all of a connection, for as long as a node hangs.

    Args:
        values: that come at once after some `times`.
        times: how often they do not come until the end.
    """
    released, numbers = threading.Event(), count(1)

    def answer(_: object) -> object:
        if next(numbers) <= times:
            released.wait()
        return values

    try:
        yield answer
    finally:
        released.set()


def test_a_question_without_an_answer_holds_up_no_message(played: Played) -> None:
    is_asked = threading.Event()
    with hanging({"subscribers": []}, times=1000) as answer, bridge_to(played.url) as bridge:
        sink = bridge.open_sink(LISTEN, structure(bridge, LISTEN))

        def hang(given: object) -> object:
            is_asked.set()
            return answer(given)

        played.answers["subscribers"] = hang
        assert is_asked.wait(patience())
        sink.send({"data": "Kia ora"})
        eventually(lambda: asked(played, "publish"), "the message comes")


def test_a_bridge_whose_rosapi_does_not_answer_is_degraded_until_it_does(played: Played) -> None:
    with hanging({"type": "std_msgs/String"}, times=1) as answer:
        played.answers["topic_type"] = answer
        with bridge_to(played.url, wait=0.5) as bridge:
            events = health_events(bridge)
            with pytest.raises(BridgeTimeoutError):
                bridge.describe(TALK)
            eventually(lambda: len(events) > 1, "it is asked again")
    assert [event.health for event in events[:2]] == [Health.DEGRADED, Health.OK]
    assert "does rosapi still run" in events[0].cause
    assert events[1].cause == f"rosapi of {played.url} answers again"


def test_questions_after_one_without_an_answer_are_answered(played: Played) -> None:
    with hanging({"type": "std_msgs/String"}, times=1) as answer:
        played.answers["topic_type"] = answer
        with bridge_to(played.url, wait=0.5) as bridge:
            with pytest.raises(BridgeTimeoutError, match=r"within 0.5 s: does rosapi still run"):
                bridge.describe(TALK)

            def passes() -> bool:
                try:
                    return bridge.describe(TALK).message is not None
                except BridgeError as error:
                    assert "closed the connection" not in str(error), "it is left on purpose"
                    return False

            eventually(passes, "another connection is made")


def test_calls_after_one_without_a_reply_are_replied_to(played: Played) -> None:
    details = {"typedefs": [FLAG]}
    played.answers |= {"service_request_details": details, "service_response_details": details}
    played.answers["service_type"] = {"type": "std_srvs/SetBool"}
    service = Endpoint("far", "set", Role.SERVICE, ("/set",))
    with hanging({"data": True}, times=1) as answer:
        played.answers["set"] = answer
        with bridge_to(played.url, wait=0.5) as bridge:
            # The second is of the manager, where the call began late on a busy machine.
            with pytest.raises(BridgeTimeoutError, match=r"no reply within|did not finish within"):
                bridge.call(service, {"data": True}, timeout=0.5)

            def passes() -> bool:
                with suppress(BridgeError):
                    reply = bridge.call(service, {"data": True}, timeout=0.5)
                    return bool(reply == {"data": True})
                return False

            eventually(passes, "another connection is made")


def test_a_parameter_that_is_gone_is_lost_alone_and_comes_back(played: Played) -> None:
    played.answers["get_param"] = {"value": "7"}
    with bridge_to(played.url) as bridge:
        events, made = health_events(bridge), structure(bridge, SPEED)
        speed = bridge.open_source(SPEED, made, Collector().deliver)
        bridge.open_source(TALK, structure(bridge), Collector().deliver)
        played.answers["get_param"] = {"value": ""}
        eventually(lambda: events, "the parameter is lost")
        assert (events[0].channel, events[0].health) == (speed, Health.LOST)
        played.answers["publishers"] = {"publishers": []}
        eventually(lambda: len(events) == 2, "the topic is looked at as well")
        speed.close()
        played.answers["get_param"] = {"value": "8"}
        eventually(lambda: len(events) == 3, "it is there again")
        assert (events[2].component, events[2].health) == ("speed", Health.OK)


def test_a_parameter_is_another_where_its_json_is(played: Played) -> None:
    """To Python 1, 1.0 and true are equal, and NaN is not itself."""
    played.answers["get_param"] = {"value": "7"}
    with bridge_to(played.url, check=LONG) as bridge:
        collector = Collector()
        source = bridge.open_source(SPEED, structure(bridge, SPEED), collector.deliver)
        assert isinstance(source, ParameterSource)
        for value in ("1", "1.0", "true", "[NaN]", "[NaN]", "[1]", "[true]", "[true]"):
            played.answers["get_param"] = {"value": value}
            source.look()
    assert str(collector.messages) == "[7, 1, 1.0, True, [nan], [1], [True]]"


def test_a_message_that_is_too_large_is_a_loss_with_its_limit(played: Played) -> None:
    """It would come again with each connection: that is no break which passes."""
    with bridge_to(played.url, grace=LONG, max_octets=1000) as bridge:
        events = health_events(bridge)
        bridge.open_source(TALK, structure(bridge), Collector().deliver)
        publish(played, "x" * 100_000)
        eventually(lambda: events, "it is lost")
        assert events[0].health is Health.LOST
        assert "larger than `max_octets`, 1,000" in events[0].cause


def test_a_message_that_the_server_ends_the_connection_for_is_not_sent_again(
    played: Played,
) -> None:
    """It has no operation that states its limit: here a megabyte, ten of rosbridge_suite."""
    long = {"data": "x" * 2_000_000}
    with bridge_to(played.url, grace=LONG) as bridge:
        events = health_events(bridge)
        sink = bridge.open_sink(LISTEN, structure(bridge, LISTEN))
        with suppress(BridgeError):
            sink.send(long)
        eventually(lambda: len(events) == 2, "it is there again")
        assert [event.health for event in events] == [Health.DEGRADED, Health.OK]
        assert "octets is too long for the server" in events[0].cause
        with pytest.raises(MessageError, match="has ended the connection for one of 2,000,"):
            sink.send(long)
        sink.send({"data": "short"})
        eventually(lambda: len(asked(played, "publish")) == 1, "others are sent")
        played.stop()
        played.start()
        eventually(lambda: len(events) == 4, "another server answers")
        with suppress(BridgeError):
            sink.send(long)
        eventually(lambda: len(events) == 6, "which may take more, and is asked")


def test_what_cannot_be_read_is_said_once_until_something_can(played: Played) -> None:
    collector = Collector()
    with bridge_to(played.url) as bridge:
        events = health_events(bridge)
        bridge.open_source(TALK, structure(bridge), collector.deliver)
        for octets in ("{", b"\xff\xff", "[1, ", json.dumps([1]) + "]"):
            played.sockets[-1].send(octets)
        publish(played, "x")
        assert collector.wait(1) == [{"data": "x"}]
        assert [event.health for event in events] == [Health.DEGRADED, Health.OK]
        assert "sends what cannot be read" in events[0].cause


def test_what_can_be_read_again_is_asked_for_where_nothing_comes(played: Played) -> None:
    with bridge_to(played.url, check=0.1) as bridge:
        events = health_events(bridge)
        bridge.open_source(TALK, structure(bridge), Collector().deliver)
        played.sockets[-1].send("{")
        eventually(lambda: len(events) == 2, "its end")
        assert [event.health for event in events] == [Health.DEGRADED, Health.OK]


def test_rosapi_that_answers_again_covers_up_nothing(played: Played) -> None:
    with (
        hanging({"type": "std_msgs/String"}, times=1) as answer,
        bridge_to(played.url, wait=0.5, check=3600) as bridge,
    ):
        events = health_events(bridge)
        bridge.open_source(TALK, structure(bridge), Collector().deliver)
        played.sockets[-1].send("{")
        eventually(lambda: len(events) == 1, "it cannot be read")
        played.answers["topic_type"] = answer
        with pytest.raises(BridgeTimeoutError):
            bridge.describe(TALK)

        def answers() -> bool:
            with suppress(BridgeError):
                return bridge.describe(TALK).message is not None
            return False

        eventually(answers, "rosapi answers again")
        publish(played, "x")
        eventually(lambda: len(events) == 4, "all is well")
    healths = [event.health for event in events]
    assert healths == [Health.DEGRADED, Health.DEGRADED, Health.DEGRADED, Health.OK]
    assert "answers again" not in events[2].cause


def test_what_did_not_open_does_not_stand(played: Played) -> None:
    def on(socket: Any, fields: Any) -> None:
        if fields["op"] == "subscribe":
            socket.close()

    with bridge_to(played.url, grace=LONG) as bridge:
        events, made = health_events(bridge), structure(bridge)
        played.on = on
        with pytest.raises(BridgeError):
            bridge.open_source(TALK, made, Collector().deliver)
        eventually(lambda: len(events) == 2, "the break, and its end")
        assert bridge.describe(TALK).message == made
        assert len(asked(played, "subscribe")) == 1
