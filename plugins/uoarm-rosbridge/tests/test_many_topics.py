"""One client that subscribes a thousand topics: none is refused, and all of them come."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack

import pytest
from ros import Ros, Serve, url
from uoarm_rosbridge import _hub

from uoarm import RobotManager
from uoarm.bridge import Registry
from uoarm.config import loads
from uoarm.server import Limits
from uoarm.testing import MemoryBridge

COUNT = 1000
ONE = "  f{0}: {{components: [{{name: c{0}, bridge: memory, output: {{endpoint: [c{0}]}}}}]}}\n"
ROBOT = "version: 1\nbridges: {memory: {plugin: python}}\nfunctions:\n"
VALUE = {"type": "object", "properties": {"v": {"type": "integer"}}, "required": ["v"]}


@pytest.fixture
def robot() -> Iterator[RobotManager]:
    """Each function has one message, its number, for each client that opens it."""
    memory = MemoryBridge()
    for number in range(COUNT):
        memory.emitter(f"c{number}", VALUE, latched=True).emit({"v": number})
    config = loads(ROBOT + "".join(map(ONE.format, range(COUNT))))
    with RobotManager(config, registry=Registry(()), bridges={"memory": memory}) as robot:
        yield robot


def test_a_thousand_topics_are_subscribed_at_once(serve: Serve) -> None:
    with Ros(url(serve())) as client:
        for number in range(COUNT):
            client.send(op="subscribe", topic=f"/uoarm/f{number}")
        reports = [client.receive() for _ in range(COUNT)]
    assert {(report["op"], report["topic"], report["msg"]["v"]) for report in reports} == {
        ("publish", f"/uoarm/f{number}", number) for number in range(COUNT)
    }


def test_subscriptions_of_one_client_are_limited_over_all_its_topics(serve: Serve) -> None:
    with Ros(url(serve(Limits(streams=2)))) as client:
        for number in range(127):
            client.send(op="subscribe", topic="/a", id=f"s{number}")
        client.send(op="subscribe", topic="/b", id="first")
        refused = client.refused(op="subscribe", topic="/b", id="second")
        assert refused == "limit: 128 subscriptions are held already; end one first (UOA-702)"
        client.send(op="subscribe", topic="/a", id="s0", throttle_rate=5)  # replaces its own
        client.send(op="unsubscribe", topic="/a", id="s1")
        client.send(op="subscribe", topic="/b", id="second")
        assert client.call("/rosapi/get_time")


def test_subscriptions_of_one_topic_are_limited(serve: Serve) -> None:
    with Ros(url(serve())) as client:
        for number in range(256):
            client.send(op="subscribe", topic="/a", id=f"s{number}")
        refused = client.refused(op="subscribe", topic="/a", id="last")
        assert refused == "limit: '/a' has 256 subscriptions of this client (UOA-702)"
        client.send(op="subscribe", topic="/b", id="last")
        assert client.call("/rosapi/get_time")


def test_topics_that_others_have_taken_leave_an_equal_share(
    serve: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those who subscribe a thousand each have taken all; who comes then has a part of them."""
    monkeypatch.setattr(_hub, "_MOST_TOPICS", 60)
    server = serve(Limits(streams=20))
    with ExitStack() as stack:
        for client in range(3):
            greedy = stack.enter_context(Ros(url(server)))
            for number in range(20):
                greedy.send(op="subscribe", topic=f"/{client}/{number}", type="a/T")
            greedy.call("/rosapi/get_time")
        late = stack.enter_context(Ros(url(server)))
        for number in range(15):
            late.send(op="subscribe", topic=f"/late/{number}", type="a/T")
        late.call("/rosapi/get_time")
        assert "60 topics already, 15 of them of this client" in late.refused(
            op="subscribe", topic="/late/more", type="a/T", id="1"
        )
        late.send(op="unsubscribe", topic="/late/0")
        late.send(op="subscribe", topic="/late/more", type="a/T")
        late.call("/rosapi/get_time")
