"""Nodes whose type has our name and another definition: DDS matches them, and we say so."""

from __future__ import annotations

from typing import Any

import pytest
from endpoints import INT64, Start, endpoint, known, sink, source
from messages import default_of
from peers import MORTAL
from robots import HOSTED, robot
from tests.inbox import Inbox  # type: ignore[import-not-found]
from uoarm_ros2._types import import_type

from uoarm.bridge import Bridge
from uoarm.errors import BridgeError
from uoarm.model import Health, Role
from uoarm.testing import Collector, patience, wait

OTHER = "RIHS01_000102030405"
BASIC = "test_msgs/srv/BasicTypes"
FIBONACCI = "test_msgs/action/Fibonacci"


def test_a_publisher_with_another_definition_is_refused(bridge: Bridge, peer: Start) -> None:
    talker = peer("talker")
    talker.do("redefine")
    talker.do("advertise", topic="/strange")
    with pytest.raises(BridgeError) as caught:
        source(bridge, endpoint(Role.OUTPUT, "/strange", INT64), print)
    text = str(caught.value)
    assert f"/strange: {INT64} is defined otherwise" in text
    assert f"/talker has {OTHER}" in text
    assert "this process has RIHS01_" in text
    assert bridge.open_channels == 0


def test_a_subscription_with_another_definition_is_refused(bridge: Bridge, peer: Start) -> None:
    listener = peer("listener")
    listener.do("redefine")
    listener.do("subscribe", topic="/strange")
    with pytest.raises(BridgeError, match=f"/listener has {OTHER}"):
        sink(bridge, endpoint(Role.INPUT, "/strange", INT64))


def test_one_that_comes_later_is_an_event_and_so_is_its_end(bridge: Bridge, peer: Start) -> None:
    events, inbox = Inbox(bridge), Inbox()
    talker = peer("talker")
    talker.do("advertise", topic="/mixed")
    source(bridge, endpoint(Role.OUTPUT, "/mixed", INT64), inbox)
    stranger = peer("stranger")
    known(bridge, "/stranger", bare=True)
    stranger.do("redefine")
    stranger.do("advertise", topic="/mixed")
    # The graph may learn of its publisher before its node, and then there is a report of each.
    events.event(Health.DEGRADED, f"defined otherwise there than here: /stranger has {OTHER}")
    stranger.do("unadvertise", topic="/mixed")
    events.event(Health.OK, "every peer has our definition")
    talker.do("publish", topic="/mixed", count=1)
    inbox.wait_for(1)


def test_a_channel_left_with_strangers_alone_is_lost(bridge: Bridge, peer: Start) -> None:
    events = Inbox(bridge)
    talker, stranger = peer("talker", **MORTAL), peer("stranger")
    talker.do("advertise", topic="/replaced")
    source(bridge, endpoint(Role.OUTPUT, "/replaced", INT64), print)
    stranger.do("redefine")
    stranger.do("advertise", topic="/replaced")
    events.event(Health.DEGRADED, "defined otherwise")
    talker.kill()
    events.event(Health.LOST, "defined otherwise")


def call(bridge: Bridge, name: str) -> object:
    native: Any = import_type(BASIC)
    at = endpoint(Role.SERVICE, name, BASIC)
    return bridge.call(at, default_of(native.Request))


def test_a_server_with_another_definition_is_not_called(bridge: Bridge, peer: Start) -> None:
    server = peer("server")
    server.do("redefine_reply")
    server.do("serve", name="/strange")
    with pytest.raises(BridgeError) as caught:
        call(bridge, "/strange")
    text = str(caught.value)
    assert "service /strange is not the same everywhere: /server has " in text
    assert f"{BASIC}_Response as {OTHER}" in text
    assert "this process has RIHS01_" in text


def test_an_action_with_another_definition_is_sent_no_goals(bridge: Bridge, peer: Start) -> None:
    server = peer("server", "threads")
    server.do("redefine_goal_reply")
    server.do("act", name="/strange")
    with pytest.raises(BridgeError, match="action /strange is not the same everywhere: /server"):
        sink(bridge, endpoint(Role.INPUT, "/strange", FIBONACCI))


def test_another_service_under_the_name_is_an_event_and_so_is_its_end(
    bridge: Bridge, peer: Start
) -> None:
    events = Inbox(bridge)
    server, stranger = peer("server"), peer("stranger")
    server.do("serve", name="/mixed")
    call(bridge, "/mixed")
    stranger.do("serve_flag", name="/mixed")
    known(bridge, "/stranger")

    def reports() -> bool:
        call(bridge, "/mixed")
        found = [message for message in events.messages if words in message.cause]
        judged = [(item.health, item.component, item.about) for item in found]
        return judged == [(Health.DEGRADED, "thing", "definition")]

    words = "service /mixed is not the same everywhere: /stranger has std_srvs/srv/SetBool_Re"
    wait(reports)
    stranger.end()
    well = events.event(Health.OK, "every server of it has our definition")
    assert well.component == "thing", "without another call"


@pytest.mark.parametrize("host", ["", HOSTED], ids=["here", "hosted"])
def test_another_service_under_the_name_is_shown_to_the_user_until_its_end(
    peer: Start, host: str
) -> None:
    server, stranger = peer("server"), peer("stranger")
    server.do("serve", name="/mixed")
    native: Any = import_type(BASIC)
    request = default_of(native.Request)
    part = f"{{name: thing, bridge: ros, service: {{endpoint: [/mixed, {BASIC}]}}}}"
    with robot(f"  flip: {{components: [{part}]}}", host=host) as manager:
        events = Collector()
        manager.listen(events.deliver)
        manager.call("flip", request, timeout=patience())
        assert manager.status().components == ()
        stranger.do("serve_flag", name="/mixed")

        def shown() -> bool:
            manager.call("flip", request, timeout=patience())
            return "/stranger has std_srvs/srv/SetBool" in str(manager.status())

        wait(shown)
        [thing] = manager.status().components
        assert (thing.name, thing.function, thing.health) == ("thing", "flip", Health.DEGRADED)
        stranger.end()
        wait(lambda: manager.status().components == ())  # without another call
        events.wait_for(lambda item: (item.subject, item.change) == ("component thing", "ok"))
        changes = [item.change for item in events.messages if item.function == "flip"]
        assert changes == ["degraded", "ok"]
