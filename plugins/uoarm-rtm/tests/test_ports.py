"""Data ports of real components in other processes: both directions, every way of moving data."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from attrs import evolve
from endpoints import Make, Start, endpoint, sink, source, stamped
from tests.inbox import Inbox  # type: ignore[import-not-found]
from uoarm_rtm._bridge import RtmBridge
from uoarm_rtm._channels import InPortSink

from uoarm.bridge import Bridge
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import CommandPolicy, Role, StopMessage
from uoarm.testing import wait

IDL = str(Path(__file__).parent / "types.idl")


@pytest.mark.parametrize("options", [
    {}, {"endian": "big"}, {"flow": "pull", "rate": 200},
], ids=str)  # fmt: skip
def test_an_out_port_delivers_everything_in_order(
    bridge: Bridge, peer: Start, options: dict[str, Any]
) -> None:
    component = peer("Talker")
    inbox = Inbox()
    channel = source(bridge, endpoint(Role.OUTPUT, "Talker.rtc", "out", **options), inbox)
    component.count(0, 5)
    inbox.wait_for(5)
    component.count(5, 8)
    inbox.wait_for(8)
    assert inbox.numbers() == list(range(8))
    assert inbox.messages[3] == {"tm": {"sec": 3, "nsec": 0}, "data": 3}
    assert channel.facts()["count"] == 8
    wait(lambda: channel.facts()["state"] == "inactive")
    channel.close()
    assert component.connectors() == [0, 0]
    component.count(8, 9)
    assert inbox.numbers() == list(range(8))


@pytest.mark.parametrize("subscription", ["new", "periodic"])
def test_other_subscriptions_end_with_the_newest(
    bridge: Bridge, peer: Start, subscription: str
) -> None:
    component = peer("Talker")
    inbox = Inbox()
    at = endpoint(Role.OUTPUT, "Talker.rtc", "out", subscription=subscription, rate=100)
    source(bridge, at, inbox)
    component.count(0, 50)
    wait(lambda: 49 in inbox.numbers())
    assert inbox.numbers() == sorted(set(inbox.numbers()))


@pytest.mark.parametrize("options", [{}, {"endian": "big"}], ids=str)
def test_an_in_port_gets_everything_in_order(
    bridge: Bridge, peer: Start, options: dict[str, Any]
) -> None:
    component = peer("Listener")
    at = endpoint(Role.INPUT, "Listener.rtc", "in", activate=True, **options)
    into = sink(bridge, at)
    for number in range(5):
        into.send(stamped(number))
    assert component.received() == [stamped(number) for number in range(5)]
    assert component.calls() == ["activated"]
    into.close()
    assert component.connectors() == [0, 0]
    with pytest.raises(BridgeError, match="is closed") as caught:
        into.send(stamped(5))
    assert caught.value.reason is FailureReason.CLOSED


def test_big_endian_is_refused_where_a_component_would_not_notice(
    bridge: Bridge, peer: Start
) -> None:
    component = peer("Talker")
    component.speak("C++")
    out, into = (Role.OUTPUT, "Talker.rtc", "out"), (Role.INPUT, "Talker.rtc", "in")
    for at in (endpoint(*out, endian="big"), endpoint(*into, endian="big", flow="pull")):
        with pytest.raises(BridgeError, match="take no notice of `endian`") as caught:
            bridge.describe(at)
        assert caught.value.reason is FailureReason.REFUSED
    pulled = endpoint(*out, endian="big", flow="pull")
    assert bridge.link(pulled, endpoint(*into)) is None
    inbox = Inbox()
    source(bridge, pulled, inbox)
    component.count(5, 6)
    inbox.wait_for(1)
    assert inbox.numbers() == [5]
    sink(bridge, endpoint(*into, endian="big", activate=True)).send(stamped(6))
    assert component.received() == [stamped(6)]


def test_an_in_port_that_pulls(bridge: Bridge, peer: Start) -> None:
    component = peer("Listener")
    at = endpoint(Role.INPUT, "Listener.rtc", "in", activate=True, flow="pull")
    into = sink(bridge, at)
    assert not into.blocking
    assert component.fetch() == 0
    into.send(stamped(1))
    into.send(stamped(2))
    assert [component.fetch() for _ in range(3)] == [1, 1, 0]
    assert component.received() == [stamped(1), stamped(2)]


@pytest.mark.parametrize("name", ["in", "Listener.in"])
def test_a_message_that_does_not_fit_never_leaves(bridge: Bridge, peer: Start, name: str) -> None:
    component = peer("Listener")
    into = sink(bridge, endpoint(Role.INPUT, "Listener.rtc", name, activate=True))
    with pytest.raises(MessageError, match=r"\$\.data: expected an integer"):
        into.send(stamped("five"))
    assert component.received() == []


def test_user_types_and_images_pass(make_bridge: Make, peer: Start) -> None:
    bridge = make_bridge(idl=IDL)
    odd = peer("Odd", "IDL:Odd/Deep:1.0", IDL)
    camera = peer("Camera", "IDL:RTC/CameraImage:1.0")
    seen = Inbox()
    source(bridge, endpoint(Role.OUTPUT, "Odd.rtc", "out"), seen)
    odd.write({"rows": [[1.0, 2.0], []], "mixes": [], "end": 7})
    message = seen.wait_for(1)[0]
    assert np.array_equal(message["rows"][0], [1.0, 2.0])
    into = sink(bridge, endpoint(Role.INPUT, "Camera.rtc", "in", activate=True))
    image = {
        "tm": {"sec": 1, "nsec": 2}, "width": 640, "height": 480, "bpp": 24, "format": "rgb8",
        "fDiv": 0.0, "pixels": bytes(640 * 480 * 3),
    }  # fmt: skip
    into.send(image)
    assert camera.received()[0]["pixels"] == [0] * (640 * 480 * 3)


@pytest.mark.parametrize(
    ("address", "words", "reason"),
    [
        (("Missing.rtc", "out"), "there is no component 'Missing.rtc'", FailureReason.NOT_FOUND),
        (("talker.rtc", "out"), "did you mean 'Talker.rtc'?", FailureReason.NOT_FOUND),
        (("Talker.rtc", "left"), "has no port 'left'; it has in, out", FailureReason.NOT_FOUND),
        (("Talker.rtc", "in"), "is a DataInPort, but an output needs", FailureReason.BAD_ENDPOINT),
        (
            ("Talker.rtc", "out", "RTC::TimedDouble"),
            "carries IDL:RTC/TimedLong:1.0, the configuration says RTC::TimedDouble",
            FailureReason.REFUSED,
        ),
        (("Talker.rtc",), "expected \\[component, port\\]", FailureReason.BAD_ENDPOINT),
    ],
    ids=str,
)
def test_what_is_not_there_is_said(
    bridge: Bridge, peer: Start, address: tuple[str, ...], words: str, reason: FailureReason
) -> None:
    peer("Talker")
    with pytest.raises(BridgeError, match=words) as caught:
        bridge.describe(endpoint(Role.OUTPUT, *address))
    assert caught.value.reason is reason


def test_a_port_that_does_not_speak_as_we_do_is_refused_by_name(
    bridge: Bridge, peer: Start
) -> None:
    component = peer("Fast")
    component.port_says("in", "dataport.interface_type", "shared_memory, direct")
    with pytest.raises(
        BridgeError, match=r"shared_memory, direct, and we speak corba_cdr: let"
    ) as e:
        bridge.describe(endpoint(Role.INPUT, "Fast.rtc", "in"))
    assert e.value.reason is FailureReason.UNSUPPORTED
    component.port_says("in", "dataport.interface_type", "data_service,corba_cdr")
    sink(bridge, endpoint(Role.INPUT, "Fast.rtc", "in", activate=True)).send(stamped(1))
    assert component.received() == [stamped(1)]


def test_an_event_of_a_state_machine_is_an_input(bridge: Bridge, peer: Start) -> None:
    component = peer("Machine")
    component.port_says("in", "dataport.data_type", "any")
    (found,) = [discovered for discovered in bridge.discover() if discovered.name == "Machine.rtc"]
    assert "port 'in' takes the events of a state machine" in found.detail
    for address, options in ((["TimedLong"], {}), ([], {"event": "start"})):
        with pytest.raises(
            BridgeError, match=r"name the event in the option `event`, and its data"
        ):
            bridge.describe(endpoint(Role.INPUT, "Machine.rtc", "in", *address, **options))
    component.activate()
    start = sink(bridge, endpoint(Role.INPUT, "Machine.rtc", "in", "TimedLong", event="start"))
    start.send(stamped(4))
    assert component.received() == [stamped(4)]
    (made,) = component.made()
    assert made["dataport.fsm_event_name"] == "start"
    with pytest.raises(BridgeError, match="and no events: leave the option `event` out"):
        bridge.describe(endpoint(Role.OUTPUT, "Machine.rtc", "out", event="start"))


@pytest.mark.parametrize(("role", "port"), [(Role.OUTPUT, "out"), (Role.INPUT, "in")])
def test_a_refusal_half_way_leaves_nothing_behind(
    bridge: Bridge, peer: Start, role: Role, port: str
) -> None:
    component = peer("Stubborn")
    component.refuse()
    at = endpoint(role, "Stubborn.rtc", port)
    with pytest.raises(BridgeError, match="refuses to connect: OUT_OF_RESOURCES") as caught:
        _ = sink(bridge, at) if role is Role.INPUT else source(bridge, at, Inbox())
    assert caught.value.reason is FailureReason.REFUSED
    assert component.connectors() == [0, 0]
    assert bridge.open_channels == 0


def test_a_component_in_a_context_is_found_by_its_last_step(bridge: Bridge, peer: Start) -> None:
    peer("some\\.host.host_cxt/deep.mgr/Far.rtc")
    peer("Other")
    plain = "some.host.host_cxt/deep.mgr/Far.rtc"
    for path in ("some\\.host.host_cxt/deep.mgr/Far.rtc", plain, "Far.rtc"):
        assert bridge.describe(endpoint(Role.OUTPUT, path, "out")).message is not None
    peer("elsewhere.host_cxt/Far.rtc")
    with pytest.raises(BridgeError, match="is there several times"):
        bridge.describe(endpoint(Role.OUTPUT, "Far.rtc", "out"))


def test_a_port_of_ours_shows_no_connection_that_is_being_made(
    nameserver: str, peer: Start
) -> None:
    first, second = peer("First"), peer("Second")
    second.mind_connections()
    properties = {"dataport.interface_type": "corba_cdr", "dataport.dataflow_type": "push"}
    assert first.connect(nameserver, "Second.rtc", "in", properties) == "RTC_OK"
    assert first.connectors() == [0, 1]
    assert second.connectors() == [1, 0]


def test_a_command_that_is_not_renewed_is_followed_by_the_stop(bridge: Bridge, peer: Start) -> None:
    component = peer("Listener")
    policy = CommandPolicy(0.1, StopMessage(stamped(0)))
    at = evolve(endpoint(Role.INPUT, "Listener.rtc", "in", activate=True), command=policy)
    into = sink(bridge, at)
    into.send(stamped(5))
    wait(lambda: component.received() == [stamped(5), stamped(0)])
    wait(lambda: into.command_status().stops == 1)


@pytest.mark.parametrize("subscription", ["flush", "new"])
def test_what_moves_is_stopped_before_it_is_released(
    bridge: Bridge, peer: Start, subscription: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    component, made = peer("Listener"), cast(RtmBridge, bridge)
    policy = CommandPolicy(3600, StopMessage(stamped(0)))
    options = {"activate": True, "subscription": subscription}
    at = evolve(endpoint(Role.INPUT, "Listener.rtc", "in", **options), command=policy)
    into = sink(bridge, at)
    into.send(stamped(5))
    wait(lambda: component.received() == [stamped(5)])
    stop = InPortSink._before_close

    def look_and_stop(channel: InPortSink) -> None:
        made._active.tick()  # as the watch may at any time
        stop(channel)

    monkeypatch.setattr(InPortSink, "_before_close", look_and_stop)
    into.close()
    assert component.received() == [stamped(5), stamped(0)]
    assert not made._active.checks(), "it was let go of"
