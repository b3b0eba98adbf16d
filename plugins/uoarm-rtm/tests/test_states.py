"""The states of components: failed ones are replaced, inactive ones reported or activated."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import pytest
from _uoarm_rtm_stubs import OpenRTM, SDOPackage
from endpoints import ANSWERS, Make, Start, endpoint, of, sink, source, stamped
from tests.inbox import Inbox  # type: ignore[import-not-found]
from uoarm_rtm import _port_servant, _servants
from uoarm_rtm._orb import calls
from uoarm_rtm._peer import pairs

from uoarm import RobotManager
from uoarm.bridge import Bridge, Channel, Sink
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Endpoint, Health, Role
from uoarm.testing import Background, Collector, patience, wait

IDL = str(Path(__file__).parent / "service.idl")
PORTS = {Role.OUTPUT: "out", Role.INPUT: "in"}


def opened(bridge: Bridge, at: Endpoint) -> Channel:
    channel: Channel = (
        sink(bridge, at) if at.role is Role.INPUT else source(bridge, at, lambda _: None)
    )
    return channel


@pytest.mark.parametrize("role", PORTS)
def test_a_component_that_fails_is_lost(bridge: Bridge, peer: Start, role: Role) -> None:
    component, events = peer("Worker"), Inbox(bridge)
    component.activate()
    at = of("Worker", role, PORTS[role])
    channel = opened(bridge, at)
    component.abort()
    assert events.event(Health.LOST, "it is in state ERROR").channel is channel
    with pytest.raises(BridgeError, match="is in state ERROR; reset it, or give") as caught:
        bridge.describe(at)
    assert caught.value.reason is FailureReason.UNAVAILABLE


@pytest.mark.parametrize("role", PORTS)
def test_a_component_that_others_deactivate_is_degraded(
    bridge: Bridge, peer: Start, role: Role
) -> None:
    component, events = peer("Worker"), Inbox(bridge)
    channel = opened(bridge, of("Worker", role, PORTS[role], activate=True))
    wait(lambda: channel.facts()["state"] == "active")
    assert not [message for message in events.messages if message.channel is channel]
    component.deactivate()
    event = events.event(Health.DEGRADED, "is inactive: it does nothing now")
    assert event.channel is channel
    if isinstance(channel, Sink):
        channel.send(stamped(1))
    component.activate()
    assert events.event(Health.OK, "works again").channel is channel
    healths = [message.health for message in events.messages if message.channel is channel]
    assert healths == [Health.DEGRADED, Health.OK]


@pytest.mark.parametrize("native", [False, True])
def test_a_component_is_kept_active_where_that_is_asked(
    bridge: Bridge, peer: Start, native: bool
) -> None:
    component, _ = peer("Worker"), peer("From")
    at = of("Worker", Role.INPUT, "in", activate="keep")
    if native:
        assert bridge.link(of("From", Role.OUTPUT, "out"), at) is not None
    else:
        opened(bridge, at)
    wait(lambda: component.state() == "ACTIVE_STATE")
    component.deactivate()
    wait(lambda: component.calls() == ["activated", "deactivated", "activated"])


def test_a_failed_component_is_reset_where_that_is_allowed(bridge: Bridge, peer: Start) -> None:
    component = peer("Worker")
    component.activate()
    component.abort()
    with pytest.raises(BridgeError, match="state ERROR"):
        opened(bridge, of("Worker", Role.INPUT, "in", activate=True))
    opened(bridge, of("Worker", Role.INPUT, "in", activate=True, reset=True))
    assert component.calls() == ["activated", "aborting", "reset", "activated"]


def test_one_that_hangs_as_it_is_deactivated_keeps_no_other_from_being_activated(
    make_bridge: Make, peer: Start
) -> None:
    bridge = make_bridge(watch=0)
    hung, healthy = peer("Hung"), peer("Healthy")
    channel = opened(bridge, of("Hung", Role.INPUT, "in", activate=True))
    hung.freeze()
    closing = Background(lambda: channel.close(timeout=patience()))
    deactivating = Background(partial(vars(bridge)["_active"].leave, channel))
    wait(lambda: calls._count == 2)  # to end the connection, and for the state
    opened(bridge, of("Healthy", Role.INPUT, "in", activate=True))
    assert healthy.state() == "ACTIVE_STATE"
    hung.thaw()
    for action in (closing, deactivating):
        action.result()
    assert hung.calls() == ["activated", "deactivated"]


def test_a_channel_that_ends_waits_for_no_component_that_another_one_needs(
    make_bridge: Make, peer: Start
) -> None:
    bridge = make_bridge(watch=0)
    peer("Shared")
    at = of("Shared", Role.INPUT, "in", activate=True)
    first, other = opened(bridge, at), opened(bridge, at)
    active = vars(bridge)["_active"]
    (known,) = active._known.values()
    with known.changing:  # as while another one opens, and the component hangs
        Background(first.close).result()
        Background(active.tick).result()
    other.close()
    assert not active.checks()


@pytest.mark.parametrize("options", ["{}", "{activate: true}"])
def test_the_next_candidate_takes_over_from_one_that_fails(
    nameserver: str, peer: Start, tmp_path: Path, options: str
) -> None:
    first, second = peer("First"), peer("Second")
    for item in (first, second):
        item.activate()
    file = tmp_path / "robot.yaml"
    file.write_text(f"""
version: 1
bridges:
  rtm: {{plugin: rtm, options: {{nameserver: "{nameserver}", watch: 0.1, call_timeout: {ANSWERS}}}}}
functions:
  numbers:
    components:
      - name: first
        bridge: rtm
        priority: 2
        output: {{endpoint: [First.rtc, out], options: {options}}}
      - {{name: second, bridge: rtm, priority: 1, output: {{endpoint: [Second.rtc, out]}}}}
""")

    def provider(connection: Any) -> str:
        return str(connection.plan.provider.component.name)

    with RobotManager.from_file(file) as robot:
        with robot.request("numbers") as connection:
            assert provider(connection) == "first"
            first.abort()
            wait(lambda: provider(connection) == "second")
        [numbers] = robot.check_availability()
        assert numbers.provider == "second"
        assert "state ERROR" in numbers.candidates[0].cause
        with robot.request("numbers") as connection:
            assert provider(connection) == "second"


def test_what_a_port_of_ours_does_not_take_is_reported(make_bridge: Make) -> None:
    ours, theirs = make_bridge(), make_bridge("other")
    events, got = Inbox(ours), Collector()
    at = endpoint(Role.OUTPUT, "self", "numbers", "TimedLong")
    channel = source(ours, at, got)
    into = sink(theirs, endpoint(Role.INPUT, "uoarm_rtm.rtc", "numbers"))
    lifecycle = endpoint(Role.SERVICE, "uoarm_rtm.rtc", "@lifecycle")
    into.send(stamped(1))
    with calls:
        assert into._target.put(b"no message") == OpenRTM.PORT_ERROR
    assert "port uoarm_rtm.numbers" in got.unread[0]
    theirs.call(lifecycle, {"action": "deactivate"})
    assert events.event(Health.DEGRADED, "has deactivated our component").channel is channel
    into.send(stamped(2))
    assert channel.facts()["lost_on_link"] == 1
    theirs.call(lifecycle, {"action": "activate"})
    assert events.event(Health.OK, "is active again").channel is channel
    into.send(stamped(3))
    assert [message["data"] for message in got.messages] == [1, 3]


def test_our_component_neither_sends_nor_answers_while_others_have_deactivated_it(
    make_bridge: Make,
) -> None:
    ours, theirs = make_bridge(idl=IDL), make_bridge("other", idl=IDL)
    events, got = Inbox(ours), Collector()
    out = sink(ours, endpoint(Role.INPUT, "self", "numbers", "TimedLong"))
    echo = endpoint(Role.SERVICE, "self", "helper", "Mover::echo")
    served = ours.serve(echo, lambda message: {"return": message["words"]})
    source(theirs, endpoint(Role.OUTPUT, "uoarm_rtm.rtc", "numbers"), got)
    asked = endpoint(Role.SERVICE, "uoarm_rtm.rtc", "helper", "Mover::echo")
    lifecycle = endpoint(Role.SERVICE, "uoarm_rtm.rtc", "@lifecycle")

    def reported(health: Health) -> bool:
        found = {event.channel for event in events.messages if event.health is health}
        return found == {out, served}

    out.send(stamped(1))
    theirs.call(lifecycle, {"action": "deactivate"})
    assert reported(Health.DEGRADED)
    with pytest.raises(BridgeError, match="has deactivated our component") as refused:
        out.send(stamped(2))
    assert refused.value.reason is FailureReason.UNAVAILABLE
    with pytest.raises(BridgeError, match="is its component active"):
        theirs.call(asked, {"words": "a"})
    theirs.call(lifecycle, {"action": "activate"})
    assert reported(Health.OK)
    out.send(stamped(3))
    assert theirs.call(asked, {"words": "b"}) == {"return": "b"}
    got.wait(2)
    assert [message["data"] for message in got.messages] == [1, 3]


def test_what_others_make_at_our_component_is_bounded(
    make_bridge: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_port_servant, "_MOST_CONNECTORS", 2)
    monkeypatch.setattr(_servants, "_MOST_VALUES", 2)
    ours, theirs = make_bridge(), make_bridge("other")
    source(ours, endpoint(Role.OUTPUT, "self", "numbers", "TimedLong"), Collector())
    at = endpoint(Role.INPUT, "uoarm_rtm.rtc", "numbers")
    first, _ = sink(theirs, at), sink(theirs, at)
    with pytest.raises(BridgeError, match="refuses to connect: OUT_OF_RESOURCES"):
        sink(theirs, at)
    first.close()
    sink(theirs, at).send(stamped(1))
    configuration = vars(ours)["_own"].component.get_configuration()
    with calls:
        for name in "ab":
            given = SDOPackage.ConfigurationSet("default", "", pairs({name: "1"}))
            configuration.set_configuration_set_values(given)
        more = SDOPackage.ConfigurationSet("default", "", pairs({"c": "1"}))
        with pytest.raises(SDOPackage.InvalidParameter):
            configuration.set_configuration_set_values(more)
