"""What is held for clients is counted in octets, bounded, and let go with them."""

from __future__ import annotations

import json
import threading
import urllib.request

import pytest
from ros import Enter, Ros, Serve, url
from tests.server.robot import script  # type: ignore[import-not-found]
from tests.server.talk import eventually, frame, open_socket, opened  # type: ignore[import-not-found]

from uoarm import RobotManager
from uoarm.server import Limits, Server
from uoarm.server.streams import _feed_registry
from uoarm.server.streams._feed import Encoder, Feed
from uoarm.server.streams._workers import LoopMailbox
from uoarm.testing import patience


def figures(server: Server) -> str:
    address = f"http://127.0.0.1:{server.ports[0]}/metrics"
    with urllib.request.urlopen(address, timeout=patience()) as answer:
        text: str = answer.read().decode()
    return text


def test_what_is_latched_is_bounded_in_octets_and_goes_with_its_publisher(serve: Serve) -> None:
    server = serve(Limits(memory_bytes=2_000_000))
    text = "x" * 400_000
    with Ros(url(server)) as other:
        with Ros(url(server)) as hoarder:
            for number in range(30):
                topic = {"op": "publish", "topic": f"/t{number}", "latch": True}
                hoarder.send(**topic, msg={"data": text})
            refused = [hoarder.receive()["msg"] for _ in range(26)]
            assert all(cause.startswith("limit: ") for cause in refused)
            # The last that was refused counts as arriving until its answer has been written.
            eventually(lambda: 1_600_000 < server.held_octets < 2_000_000, "only latched ones stay")
            [line] = [row for row in figures(server).splitlines() if '{kind="latched"}' in row]
            assert 1_600_000 < float(line.split()[1]) < 2_000_000
            other.send(op="subscribe", topic="/t1")
            assert other.messages(1) == [{"data": text}]
            assert server.held_octets < 2_000_000 + 500_000  # and what the other one reads
        eventually(lambda: server.held_octets == 0, "everything was let go")


def test_a_listener_s_type_binds_no_publisher(enter: Enter) -> None:
    listener, publisher, late = enter(), enter(), enter()
    listener.send(op="subscribe", topic="/chatter", type="std_msgs/Wrong")
    assert listener.call("/rosapi/topic_type", {"topic": "/chatter"}) == {"type": "std_msgs/Wrong"}
    publisher.send(op="advertise", topic="/chatter", type="std_msgs/String")
    publisher.send(op="publish", topic="/chatter", msg={"data": "x"})
    assert listener.messages(1) == [{"data": "x"}]
    assert late.call("/rosapi/topic_type", {"topic": "/chatter"}) == {"type": "std_msgs/String"}
    wrong = {"op": "advertise", "topic": "/chatter", "type": "std_msgs/Wrong"}
    assert "has the type 'std_msgs/String'" in late.refused(**wrong)
    publisher.send(op="unadvertise", topic="/chatter")
    publisher.call("/rosapi/get_time", {})
    late.send(**wrong)
    assert late.call("/rosapi/topic_type", {"topic": "/chatter"}) == {"type": "std_msgs/Wrong"}


def test_a_latched_message_goes_with_the_client_that_published_it(enter: Enter) -> None:
    one, other, early, late = enter(), enter(), enter(), enter()
    early.send(op="subscribe", topic="/map")
    early.call("/rosapi/get_time", {})
    for publisher in (one, other):
        publisher.send(op="advertise", topic="/map", type="a/Map", latch=True)
        publisher.call("/rosapi/get_time", {})
    one.send(op="publish", topic="/map", msg={"data": 1})
    one.send(op="unadvertise", topic="/map")
    one.call("/rosapi/get_time", {})
    # It waited for its type, and its publisher leaves in the same step of the loop.
    assert early.messages(1) == [{"data": 1}]
    late.send(op="subscribe", topic="/map")
    late.call("/rosapi/get_time", {})
    other.send(op="publish", topic="/map", msg={"data": 2})
    assert late.messages(1) == [{"data": 2}]


def test_messages_held_back_for_a_slow_rate_are_bounded_in_octets(serve: Serve) -> None:
    server = serve(Limits(queue_bytes=500_000))
    with Ros(url(server)) as listener, Ros(url(server)) as publisher:
        options = {
            "op": "subscribe",
            "topic": "/t",
            "throttle_rate": 60_000,
            "queue_length": 50_000,
        }
        listener.send(**options)
        listener.call("/rosapi/get_time", {})
        for _ in range(30):
            publisher.send(op="publish", topic="/t", msg={"data": "x" * 100_000})
        publisher.call("/rosapi/get_time", {})
        assert 300_000 < server.held_octets < 700_000
    eventually(lambda: server.held_octets == 0, "everything was let go")


def test_a_provider_that_does_not_read_is_not_cut_off_by_those_who_ask_it(serve: Serve) -> None:
    server = serve(Limits(queue_bytes=3_000_000, stall_seconds=60, ping_seconds=60))
    with (
        open_socket(server.ports[0], "/rosbridge") as provider,
        Ros(url(server)) as asker,
        Ros(url(server)) as other,
    ):
        offer = {"op": "advertise_service", "service": "/s", "type": "a/S"}
        provider.sendall(frame(json.dumps(offer).encode()))
        eventually(lambda: "/s" in asker.call("/rosapi/services", {})["services"], "it is offered")
        call = {"op": "call_service", "service": "/s", "args": {"data": "x" * 1_000_000}}
        for number in range(40):
            asker.send(**call, id=f"s{number}")
        refused = [asker.receive()["values"] for _ in range(20)]
        assert any("leaves too much unread" in cause for cause in refused), refused
        assert "/s" in other.call("/rosapi/services", {})["services"]


def test_what_stood_before_a_busy_loop_is_let_go_of(
    serve: Serve, robot: RobotManager, monkeypatch: pytest.MonkeyPatch
) -> None:
    now, feeds, gate = [0.0], list[tuple[LoopMailbox, Feed]](), threading.Event()

    def make(mailbox: LoopMailbox, limits: Limits, encoder: Encoder) -> Feed:
        feeds.append((mailbox, Feed(mailbox, limits, encoder, lambda: now[0])))
        return feeds[-1][1]

    def busy() -> None:
        gate.wait(patience())

    monkeypatch.setattr(_feed_registry, "Feed", make)
    server = serve(Limits())
    with Ros(url(server)) as client:
        client.send(op="subscribe", topic="/uoarm/numbers")
        opened(robot, 1)
        client.call("/rosapi/topics")
        [(mailbox, feed)] = feeds
        mailbox.put(busy)
        script.put(*({"value": value} for value in range(100)))
        eventually(lambda: feed.number == 100, "all have come")
        now[0] = 5.0
        gate.set()
        assert client.messages(1) == [{"value": 84}]
        assert client.messages(15)[-1] == {"value": 99}
        assert "uoarm_serve_dropped_messages 84.0" in figures(server)
