"""Nodes whose type has our name and another definition: DDS matches them, and we say so."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from endpoints import INT64, Inbox, endpoint, known, sink, source
from peers import MORTAL, Peer

from uoarm.bridge import Bridge
from uoarm.errors import BridgeError
from uoarm.model import Health, Role

Start = Callable[..., Peer]
OTHER = "RIHS01_000102030405"


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
    events, inbox = Inbox(), Inbox()
    bridge.watch(events)
    talker = peer("talker")
    talker.do("advertise", topic="/mixed")
    source(bridge, endpoint(Role.OUTPUT, "/mixed", INT64), inbox)
    stranger = peer("stranger")
    known(bridge, "/stranger", bare=True)
    stranger.do("redefine")
    stranger.do("advertise", topic="/mixed")
    assert f"/stranger has {OTHER}" in events.event(Health.DEGRADED, "defined otherwise").cause
    stranger.do("unadvertise", topic="/mixed")
    events.event(Health.OK, "every peer has our definition")
    talker.do("publish", topic="/mixed", count=1)
    inbox.wait_for(1)


def test_a_channel_left_with_strangers_alone_is_lost(bridge: Bridge, peer: Start) -> None:
    events = Inbox()
    bridge.watch(events)
    talker, stranger = peer("talker", **MORTAL), peer("stranger")
    talker.do("advertise", topic="/replaced")
    source(bridge, endpoint(Role.OUTPUT, "/replaced", INT64), print)
    stranger.do("redefine")
    stranger.do("advertise", topic="/replaced")
    events.event(Health.DEGRADED, "defined otherwise")
    talker.kill()
    events.event(Health.LOST, "defined otherwise")
