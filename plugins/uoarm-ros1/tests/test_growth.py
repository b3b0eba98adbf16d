"""Questions to the master and to nodes, which grow with nodes and not with topics."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest
from endpoints import bridge_to, input_, output
from peers import Master, Peer
from uoarm_ros1 import _bridge, _channels, _master, _node
from uoarm_ros1._bridge import Ros1Bridge
from uoarm_ros1._channels import SameTopic
from uoarm_ros1._discovery import Graph
from uoarm_ros1._master import GraphState, Peers, SharedAnswer
from uoarm_ros1._subscription import _Publisher

from uoarm.bridge import Bridge, Source
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import MessageStructure
from uoarm.testing import Background, patience, slowness, wait

INT = "std_msgs/Int32"
ANY = MessageStructure(True)
TOPICS = 20


@pytest.fixture
def questions(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """How often each method was called, but the questions whether the master is there."""
    counted: Counter[str] = Counter()
    real = _master.call_api

    def call(uri: str, method: str, *arguments: Any, **options: Any) -> Any:
        if options.get("what") != "the ROS master" or method not in {"getPid", "getParam"}:
            counted[method] += 1
        return real(uri, method, *arguments, **options)

    monkeypatch.setattr(_master, "call_api", call)
    monkeypatch.setattr(_node, "call_api", call)
    return counted


def test_an_answer_is_asked_for_once_for_all_that_wait() -> None:
    asked, may_answer = [], threading.Event()

    def ask() -> int:
        asked.append(time.monotonic())
        assert may_answer.wait(patience())
        return len(asked)

    answer = SharedAnswer(ask)
    first = Background(answer.get)
    wait(lambda: bool(asked), "it is not asked")
    # All of these came after the first question was asked: the second one is for all of them.
    since = time.monotonic()
    others = [Background(partial(answer.get, since)) for _ in range(TOPICS)]
    may_answer.set()
    assert [call.result() for call in (first, *others)] == [1, *[2] * TOPICS]
    assert answer.get(since) == 2
    assert answer.get() == 3


def test_who_came_while_a_question_failed_does_not_wait_for_another() -> None:
    asked: list[float] = []

    def ask() -> int:
        asked.append(time.monotonic())
        raise BridgeError("no answer", FailureReason.UNAVAILABLE)

    def get(since: float | None) -> None:
        with pytest.raises(BridgeError, match="no answer") as caught:
            answer.get(since)
        assert caught.value.reason is FailureReason.UNAVAILABLE

    answer = SharedAnswer(ask)
    get(None)
    get(asked[0])  # of one that came while the question was asked
    assert len(asked) == 1
    get(None)
    assert len(asked) == 2


def test_a_node_has_one_api_as_long_as_channels_use_it() -> None:
    peers = Peers("/me")
    api = peers.at("http://127.0.0.1:1/")
    assert peers.at("http://127.0.0.1:1/") is api
    assert peers.at("http://127.0.0.1:2/") is not api
    known = peers._apis
    del api
    assert not known


def test_a_node_of_many_silent_topics_is_not_asked_for_each(
    master: Master, lasting: Peer, questions: Counter[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asking: Counter[str] = Counter()
    real: Callable[[_Publisher], str] = _Publisher._ask

    def ask(publisher: _Publisher) -> str:
        cause = real(publisher)
        asking[publisher._owner.wanted.topic] += 1
        return cause

    monkeypatch.setattr(_Publisher, "_ask", ask)
    topics = [f"/silent/{number}" for number in range(TOPICS)]
    for topic in topics:
        lasting.do("advertise", topic=topic, type=INT)
    with bridge_to(master, silence=patience() / 100, check=patience(), rosout=False) as bridge:
        sources = opened(bridge, topics)
        questions.clear()
        wait(lambda: all(asking[topic] > 1 for topic in topics), "no publisher is asked")
        # In each time of silence the node is asked twice at most; all topics ask once.
        assert 0 < questions["getPid"] <= sum(asking.values()) / 4
        assert not any(source.closed for source in sources)


def test_a_node_that_hangs_is_asked_once_whatever_is_lost_of_it(
    master: Master, questions: Counter[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_node, "_ASK_SECONDS", slowness())
    peer = master.peer("hanging")
    topics = [f"/lost/{number}" for number in range(TOPICS)]
    for topic in topics:
        peer.do("advertise", topic=topic, type=INT)
    peer.freeze()
    with bridge_to(master, check=patience(), rosout=False) as bridge:
        assert isinstance(bridge, Ros1Bridge)
        wait(lambda: bridge._master_health.is_up, "the master does not answer")
        for topic in topics:
            bridge._remember(output(topic))
        questions.clear()
        bridge._look_at_graph()
        # The bridge's own look may come now, too.
        assert set(questions) == {"getSystemState", "lookupNode", "getPid"}
        assert max(questions.values()) <= 2
    peer.kill()


def test_nodes_that_hang_are_asked_at_once(master: Master, monkeypatch: pytest.MonkeyPatch) -> None:
    nodes = {f"/lost/{number}": (f"/node/{number}",) for number in range(3)}
    with bridge_to(master, check=patience(), rosout=False) as bridge:
        assert isinstance(bridge, Ros1Bridge)
        wait(lambda: bridge._master_health.is_up, "the master does not answer")
        hanging = threading.Barrier(len(nodes))

        def answers(_: str) -> bool:
            hanging.wait(patience())
            return False

        monkeypatch.setattr(bridge._node, "answers", answers)
        monkeypatch.setattr(bridge._node, "address", lambda name: name)
        state = GraphState(time.monotonic(), nodes)
        monkeypatch.setattr(bridge._node.master, "state", lambda _: state)
        for topic in nodes:
            bridge._remember(output(topic))
        bridge._look_at_graph()
        assert not hanging.broken


def test_inputs_that_are_opened_ask_the_master_once_who_subscribes(
    master: Master, lasting: Peer, questions: Counter[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (_bridge, _channels):
        monkeypatch.setattr(module, "_LATELY_SECONDS", 10 * patience())
    topics = [f"/fed/{number}" for number in range(TOPICS)]
    for topic in topics:
        lasting.do("subscribe", topic=topic, type=INT)
    with bridge_to(master, check=patience(), rosout=False) as bridge:
        sinks = [bridge.open_sink(input_(topic, INT), ANY) for topic in topics]
        assert questions["getSystemState"] <= TOPICS / 4
        lasting.do("subscribe", topic="/late", type=INT)
        sinks.append(bridge.open_sink(input_("/late", INT, peer="optional"), ANY))
        assert all(sink.facts()["subscribers"] for sink in sinks), "each waited for its own"


def test_a_node_does_not_ask_where_it_is_itself(master: Master, questions: Counter[str]) -> None:
    with bridge_to(master, check=patience(), rosout=False) as bridge:
        assert isinstance(bridge, Ros1Bridge)
        assert Graph(bridge._node).is_alive(bridge._node.name)
    assert not questions["lookupNode"]


def test_links_of_two_nodes_ask_each_once_in_a_look(
    master: Master, lasting: Peer, questions: Counter[str]
) -> None:
    other = master.peer("other")
    topics = [f"/both/{number}" for number in range(TOPICS)]
    for topic in topics:
        lasting.do("advertise", topic=topic, type=INT)
        other.do("subscribe", topic=topic, type=INT)
    with bridge_to(master, check=patience(), rosout=False) as bridge:
        assert isinstance(bridge, Ros1Bridge)
        links = [bridge.link(output(topic), input_(topic)) for topic in topics]
        graph = Graph(bridge._node, time.monotonic())
        questions.clear()
        for link in links:
            assert isinstance(link, SameTopic)
            link.tick(graph)
        # Beside those of the bridge's own look, which may come now: it is one a second.
        assert questions["getPid"] <= 2 * TOPICS / 4
        assert questions["lookupNode"] <= 2 * TOPICS / 4
        assert questions["getSystemState"] <= TOPICS / 4
    other.kill()


def opened(bridge: Bridge, topics: list[str]) -> list[Source]:
    sources = []
    for topic in topics:
        structure = bridge.describe(output(topic)).message
        assert structure is not None
        sources.append(bridge.open_source(output(topic), structure, lambda _: None))
    return sources
