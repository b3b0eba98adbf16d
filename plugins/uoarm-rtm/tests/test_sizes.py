"""Messages that are larger than an ORB takes: a fault of the message, never of the component."""

from __future__ import annotations

from typing import Any

import pytest
from endpoints import Make, Start, endpoint, sink, source, stamped
from peers import Peer
from tests.inbox import Inbox  # type: ignore[import-not-found]
from uoarm_rtm import _orb

from uoarm.bridge import Bridge
from uoarm.errors import BridgeError, MessageError
from uoarm.model import Health, Role
from uoarm.testing import Collector, wait

OCTETS = "IDL:RTC/TimedOctetSeq:1.0"
USUAL = 2 << 20  # the limit of omniORB where no other is configured


@pytest.fixture
def usual(peer: Start, monkeypatch: pytest.MonkeyPatch) -> Peer:
    """A component whose ORB has the usual limit."""
    with monkeypatch.context() as patch:
        patch.setenv("PEER_MOST_OCTETS", str(USUAL))
        component = peer("Usual", OCTETS)
    component.activate()
    return component


def lost(events: Inbox) -> list[object]:
    return [message for message in events.messages if message.health is Health.LOST]


def test_a_message_too_large_for_a_component_fails_alone(bridge: Bridge, usual: Peer) -> None:
    events = Inbox(bridge)
    into = sink(bridge, endpoint(Role.INPUT, "Usual.rtc", "in"))
    into.send(stamped(bytes(100_000)))
    words = r"does not take a message of 30000\d\d octets: up to 1000\d\d passed.*ORBgiopMaxMsgSize"
    for _ in range(2):
        with pytest.raises(MessageError, match=words):
            into.send(stamped(bytes(3_000_000)))
    into.send(stamped(bytes(1_500_000)))
    assert usual.sizes() == [100_000, 1_500_000]
    assert into.facts()["refused"] == 2
    assert lost(events) == []


def test_a_message_too_large_for_us_fails_alone(make_bridge: Make, peer: Start) -> None:
    component = peer("Large", OCTETS)
    component.activate()
    # Bridges of earlier tests whose peers hung may be closing still, and a process has one ORB.
    wait(lambda: _orb._shared.running is None, "a bridge of an earlier test still has the ORB")
    bridge, events = make_bridge(max_message=1 << 20), Inbox()
    bridge.watch(events)
    into = sink(bridge, endpoint(Role.INPUT, "Large.rtc", "in"))
    with pytest.raises(MessageError, match=r"larger than our own limit of 1048576.*`max_message`"):
        into.send(stamped(bytes(2_000_000)))
    into.send(stamped(bytes(100)))
    assert component.sizes() == [100]
    assert lost(events) == []
    with pytest.raises(BridgeError, match="give all bridges of the process one `max_message`"):
        make_bridge("other", max_message=1 << 21)


def test_an_answer_too_large_is_reported_and_ends_nothing(bridge: Bridge, usual: Peer) -> None:
    events, got = Inbox(bridge), Collector()
    at = endpoint(Role.OUTPUT, "Usual.rtc", "out", flow="pull", rate=200)
    channel: Any = source(bridge, at, got)
    usual.write_octets(3_000_000)
    wait(lambda: channel.unreadable)
    assert "does not arrive" in got.unread[0]
    usual.write_octets(100)
    got.wait(1)
    assert lost(events) == []


def test_what_is_no_message_of_its_type_is_said_and_ends_nothing(
    bridge: Bridge, usual: Peer
) -> None:
    got = Collector()
    channel: Any = source(bridge, endpoint(Role.OUTPUT, "Usual.rtc", "out"), got)
    assert str(channel.receive(b"\x01\x02")) == "PORT_ERROR"
    usual.write_octets(100)
    got.wait(1)
    assert channel.unreadable == 1
    assert got.unread[0].startswith("port 'out' of ")


@pytest.mark.parametrize("subscription", ["flush", "new"])
def test_our_own_port_drops_what_is_too_large_and_stays_connected(
    nameserver: str, bridge: Bridge, usual: Peer, peer: Start, subscription: str
) -> None:
    talker = peer("Talker", OCTETS)
    properties = {
        "dataport.interface_type": "corba_cdr",
        "dataport.dataflow_type": "push",
        "dataport.subscription_type": subscription,
    }
    assert talker.connect(nameserver, "Usual.rtc", "in", properties) == "RTC_OK"
    talker.write_octets(3_000_000)
    wait(lambda: talker.dropped() == 1)
    talker.write_octets(100)
    wait(lambda: usual.sizes() == [100])
    assert talker.connectors() == [0, 1]


@pytest.mark.parametrize("subscription", ["flush", "new"])
def test_our_own_port_counts_what_a_component_that_is_gone_did_not_get(
    nameserver: str, peer: Start, subscription: str
) -> None:
    talker, mortal = peer("Talker", OCTETS), peer("Mortal", OCTETS)
    properties = {
        "dataport.interface_type": "corba_cdr",
        "dataport.dataflow_type": "push",
        "dataport.subscription_type": subscription,
    }
    assert talker.connect(nameserver, "Mortal.rtc", "in", properties) == "RTC_OK"
    mortal.kill()
    talker.write_octets(100)
    wait(lambda: talker.dropped() == 1)
    wait(lambda: talker.connectors() == [0, 0])
