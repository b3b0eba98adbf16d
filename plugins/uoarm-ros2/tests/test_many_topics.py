"""What one more topic costs beside others of its type: looks at the graph, and what is compiled."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable
from typing import Any

import pytest
from endpoints import INT64, Make, Start, endpoint, source
from tests.inbox import Inbox  # type: ignore[import-not-found]
from uoarm_ros2._middleware import NodeRunner
from uoarm_ros2._middleware import Peer as TopicEndpoint
from uoarm_ros2._qos import Policies

from uoarm.cdr._reading import reader
from uoarm.model import Role

_MOST_LOOKS = 4
"""Both sides of the topic, what its peers offer, whether its types are ours and fresh."""


def test_one_more_topic_of_a_type_takes_few_looks_and_compiles_nothing(
    make_bridge: Make, peer: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks: Counter[str] = Counter()

    def counted(look: Callable[[NodeRunner, str], Any]) -> Callable[[NodeRunner, str], Any]:
        def wrapper(self: NodeRunner, topic: str) -> Any:
            if not threading.current_thread().name.startswith("ros2 "):  # not what it looks after
                looks[topic] += 1
            return look(self, topic)

        return wrapper

    bridge, talker = make_bridge(), peer("talker")
    for name in ("/first", "/second"):
        talker.do("advertise", topic=name)
    source(bridge, endpoint(Role.OUTPUT, "/first", INT64), Inbox())
    second = endpoint(Role.OUTPUT, "/second", INT64)
    bridge.describe(second)  # it is on the graph from now on
    for side in ("publishers", "subscriptions"):
        monkeypatch.setattr(NodeRunner, side, counted(getattr(NodeRunner, side)))
    compiled = reader.cache_info().misses
    structure = bridge.describe(second).message
    described = looks["/second"]
    assert structure is not None
    bridge.open_source(second, structure, print)
    assert described <= _MOST_LOOKS
    assert looks["/second"] - described <= _MOST_LOOKS
    assert reader.cache_info().misses == compiled
    assert bridge.describe(second).message is structure


def test_the_hash_of_our_definition_is_kept_once_the_graph_has_it_for_sure(
    make_bridge: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    runner: NodeRunner = make_bridge()._runner

    def common(*definitions: str) -> str:
        ends = [
            TopicEndpoint(runner.full_name, INT64, Policies(), definition=definition)
            for definition in definitions
        ]
        others = [
            TopicEndpoint("/other", INT64, Policies(), definition="other"),
            TopicEndpoint(runner.full_name, "std_msgs/msg/String", Policies(), definition="text"),
        ]
        monkeypatch.setattr(runner, "ends", lambda _: (*others, *ends))
        return runner.own_definition("/any", INT64, object)

    assert common() == ""
    assert common("") == ""
    assert common("one", "two") == "one"
    assert common("two") == "two"
    assert common("one") == "two"
