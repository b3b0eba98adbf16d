"""Entries of `/diagnostics` as the health of the components that name them."""

from __future__ import annotations

import struct
import sys
from typing import Any

import pytest
from attrs import evolve
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from endpoints import INT64, Make, Start, endpoint, reaches, source
from peers import OPTIONS, Peer
from rclpy.serialization import serialize_message
from tests.inbox import Inbox  # type: ignore[import-not-found]
from uoarm_ros2 import _diagnostics
from uoarm_ros2._diagnostics import Allowance, Entry, EntryHealth, read_array

from uoarm import RobotManager
from uoarm.bridge import Bridge, HealthEvent
from uoarm.config import loads
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import ConnectionState, Endpoint, Health, Role
from uoarm.testing import patience, wait

WHEEL = "driver: left wheel"
OK, WARN, ERROR, STALE = range(4)


def array(*entries: tuple[str, int, str, dict[str, str]]) -> bytes:
    made = [
        DiagnosticStatus(
            name=name,
            level=bytes([level]),
            message=message,
            hardware_id=WHEEL,  # a text that is the name of another entry is none
            values=[KeyValue(key=key, value=value) for key, value in values.items()],
        )
        for name, level, message, values in entries
    ]
    octets: bytes = serialize_message(DiagnosticArray(status=made))
    return octets


def renewed() -> Allowance:
    allowance = Allowance()
    allowance.renew(0.0)
    return allowance


def read(octets: bytes) -> Any:
    return read_array(octets, {WHEEL.encode()}, renewed())


def test_an_entry_is_found_among_thousands() -> None:
    others = [(f"other {number}", ERROR, WHEEL, {"a": WHEEL}) for number in range(5000)]
    found = read(array(*others, (WHEEL, WARN, "hot", {"temperature": "93"}), *others))
    assert found.entries == {WHEEL.encode(): Entry(WARN, "hot", (("temperature", "93"),))}
    assert found.why_not == ""
    assert len(found.names) == 32


def test_what_passes_the_allowance_is_left_until_the_next_second(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(_diagnostics, "_TEXTS", 100)
    allowance = renewed()
    octets, wanted = array(*[("x", OK, "", {})] * 29, (WHEEL, OK, "", {})), {WHEEL.encode()}
    assert read_array(octets, wanted, allowance).entries
    second = read_array(octets, wanted, allowance)
    assert not second.entries
    assert second.why_not == "more than 100 texts came within a second"
    allowance.renew(0.5)
    assert not read_array(octets, wanted, allowance).entries
    allowance.renew(1.0)
    assert read_array(octets, wanted, allowance).entries


def test_what_is_no_array_is_refused_with_its_reason() -> None:
    octets = array((WHEEL, OK, "fine", {"a": "b"}))
    assert read(b"").why_not == "b'' is no header of plain CDR"
    assert read(b"\0\x07" + octets[2:]).why_not == r"b'\x00\x07' is no header of plain CDR"
    reasons = {read(octets[:end]).why_not for end in range(4, len(octets) - 4)}
    assert {reason.split(" after")[0] for reason in reasons} == {"it is cut short"}
    many = octets[:16] + b"\xff" * (len(octets) - 16)
    assert "cut short" in read(many).why_not
    header = struct.pack(">2sHiII4sI", b"\0\0", 0, 1, 0, 1, b"", 1)
    name = WHEEL.encode() + b"\0"
    entry = b"\2\0\0\0" + struct.pack(">I20s", len(name), name) + struct.pack(">I4s", 1, b"")
    swapped = header + entry + struct.pack(">I4sI", 1, b"", 0)
    assert read(swapped).entries == {WHEEL.encode(): Entry(ERROR)}


def test_hostile_texts_are_escaped_and_bounded() -> None:
    values = {f"\x1b[2J{number}": "\n" * 5000 for number in range(500)}
    health = EntryHealth(WHEEL, 0.0, 5.0)
    octets = array((WHEEL, 200, "\u202e\x1b]0;" + "é" * 9000, values))
    health.took(read(octets).entries[WHEEL.encode()], 1.0)
    verdict = health.verdict(1.0)
    assert verdict is not None
    assert verdict[0] is Health.DEGRADED
    assert "says level 200 '\\u202e\\x1b]0;éé" in verdict[1]
    assert verdict[1].isprintable()
    assert len(verdict[1]) < 2000
    broken = octets.replace("é".encode(), b"\xff\xff")
    assert "\ufffd" in read(broken).entries[WHEEL.encode()].message


def test_an_entry_is_expected_again_within_the_timeout() -> None:
    health = EntryHealth(WHEEL, 0.0, 5.0)
    assert health.verdict(5.0) is None
    health.saw(("driver: left_wheel", "camera"))
    text = f"no entry '{WHEEL}' for 5 s; did you mean 'driver: left_wheel'?"
    assert health.verdict(5.1) == (Health.DEGRADED, text)
    health.saw(("driver: left wheels",))
    assert health.verdict(10.0) == (Health.DEGRADED, text)  # not with each array
    health.took(Entry(ERROR, "stalled"), 6.0)
    assert health.says_error(11.0)
    assert health.verdict(11.0) == (Health.LOST, f"'{WHEEL}' says ERROR 'stalled'")
    text = f"no entry '{WHEEL}' for 5 s; the last: ERROR 'stalled'"
    assert health.verdict(11.1) == (Health.DEGRADED, text)
    assert not health.says_error(11.1)


def test_values_that_change_with_each_array_are_no_news() -> None:
    health = EntryHealth(WHEEL, 0.0, 5.0)

    def said(message: str, value: str, now: float, level: int = WARN) -> str:
        health.took(Entry(level, message, (("t", value),)), now)
        verdict = health.verdict(now)
        assert verdict is not None
        return verdict[1]

    first = said("hot", "90", 1.0)
    assert said("hot", "91", 3.0) == first
    assert said("hotter", "92", 3.1) == f"'{WHEEL}' says WARN 'hotter' ('t': '92')"
    assert "'hotter'" in said("hottest", "93", 3.2)
    assert "'hottest'" in said("hottest", "93", 4.2)
    assert "'burning'" in said("burning", "94", 4.3, ERROR)


def numbers(**options: Any) -> Endpoint:
    options = {"diagnostics": WHEEL, **options}
    return endpoint(Role.OUTPUT, "/numbers", INT64, **options)


@pytest.fixture
def bridge(make_bridge: Make) -> Bridge:
    """A bridge to which a driver that stands still says for long what it said last."""
    return make_bridge(diagnostics_timeout=patience())


@pytest.fixture
def events(bridge: Bridge) -> Inbox:
    return Inbox(bridge)


def losses(events: Inbox) -> list[HealthEvent]:
    """Return the losses of the channel; nodes of other tests may leave the graph meanwhile."""
    return [
        event
        for event in events.messages
        if event.health is Health.LOST and event.cause.startswith("peer: ")
    ]


@pytest.fixture
def driver(peer: Start) -> Peer:
    there = peer("driver")
    there.do("advertise", topic="/numbers")
    there.do("diagnose", entries=[])
    return there


def test_each_level_is_the_health_of_the_channel(
    bridge: Bridge, events: Inbox, driver: Peer
) -> None:
    opened = source(bridge, numbers(), Inbox())
    driver.do("diagnose", entries=[[WHEEL, WARN, "hot", {"temperature": "93"}]], count=3000)
    place = "peer: topic /numbers: /diagnostics: "
    cause = f"{place}'{WHEEL}' says WARN 'hot' ('temperature': '93')"
    assert events.event(Health.DEGRADED, "WARN").cause == cause
    driver.do("diagnose", entries=[["other", ERROR, "", {}], [WHEEL, ERROR, "stalled", {}]])
    assert events.event(Health.LOST, "ERROR").cause == f"{place}'{WHEEL}' says ERROR 'stalled'"
    with pytest.raises(BridgeError, match="/diagnostics: 'driver: left wheel' says ERROR") as error:
        bridge.describe(numbers())
    assert error.value.reason is FailureReason.UNAVAILABLE
    driver.do("diagnose", entries=[[WHEEL, STALE, "old", {}]])
    events.event(Health.DEGRADED, f"'{WHEEL}' says STALE 'old'")
    driver.do("diagnose", entries=[[WHEEL, OK, "fine", {}]])
    events.event(Health.OK, f"'{WHEEL}' says OK 'fine'")
    assert opened.facts()["diagnostics_unread"] == 0
    assert opened.facts()["diagnostics"] not in {0, 1, 2, 3}


def test_an_entry_that_ceases_or_never_comes_is_reported_and_not_lost(
    make_bridge: Make, driver: Peer
) -> None:
    bridge, events = make_bridge(diagnostics_timeout=0.5), Inbox()
    bridge.watch(events)
    driver.do("diagnose", entries=[["driver: left_wheel", OK, "", {}]])
    source(bridge, numbers(), Inbox())
    events.event(Health.DEGRADED, f"no entry '{WHEEL}' for 0.5 s; did you mean 'driver: left_w")
    driver.do("diagnose", entries=[[WHEEL, OK, "fine", {}]])
    events.event(Health.OK, "fine")
    driver.do("end_diagnosis")
    events.event(Health.DEGRADED, f"no entry '{WHEEL}' for 0.5 s; the last: OK 'fine'")
    assert not losses(events)


def test_another_topic_is_read_where_the_bridge_names_one(make_bridge: Make, driver: Peer) -> None:
    bridge, events = make_bridge(diagnostics_topic="/diagnostics_agg"), Inbox()
    bridge.watch(events)
    source(bridge, numbers(), Inbox())
    driver.do("diagnose", entries=[[WHEEL, ERROR, "elsewhere", {}]])
    driver.do("diagnose", entries=[[WHEEL, WARN, "hot", {}]], topic="/diagnostics_agg")
    cause = f"peer: topic /numbers: /diagnostics_agg: '{WHEEL}' says WARN 'hot'"
    assert events.event(Health.DEGRADED, "WARN").cause == cause
    assert not losses(events)


def test_another_type_on_the_topic_is_named(make_bridge: Make, peer: Start) -> None:
    bridge, events = make_bridge(diagnostics_timeout=0.5), Inbox()
    bridge.watch(events)
    talker = peer("talker")
    talker.do("advertise", topic="/numbers")
    talker.do("advertise", topic="/diagnostics", kind="String")
    source(bridge, numbers(), Inbox())
    words = "no publisher of its type; it carries std_msgs/msg/String (/talker)"
    events.event(Health.DEGRADED, words)


def test_channels_share_one_subscription_which_goes_with_the_last(
    bridge: Bridge, events: Inbox, driver: Peer
) -> None:
    driver.do("diagnose", entries=[[WHEEL, OK, "", {}], ["other", WARN, "warm", {}]])
    subscriptions = {"topic": "/diagnostics"}
    assert driver.do("subscriptions", **subscriptions, expected=0) == 0
    first = source(bridge, numbers(), Inbox())
    second = source(bridge, numbers(diagnostics="other"), Inbox())
    events.event(Health.DEGRADED, "'other' says WARN 'warm'")
    assert driver.do("subscriptions", **subscriptions, expected=1) == 1
    first.close()
    driver.do("diagnose", entries=[["other", WARN, "hot", {}]])
    events.event(Health.DEGRADED, "'hot'")
    second.close()
    assert driver.do("subscriptions", **subscriptions, expected=0) == 0


def test_after_an_error_it_is_read_until_the_entry_says_otherwise(
    bridge: Bridge, events: Inbox, driver: Peer
) -> None:
    opened = source(bridge, numbers(), Inbox())
    driver.do("diagnose", entries=[[WHEEL, ERROR, "stalled", {}]])
    events.event(Health.LOST, "stalled")
    opened.close()
    with pytest.raises(BridgeError, match="stalled"):
        bridge.describe(numbers())
    driver.do("diagnose", entries=[[WHEEL, OK, "fine", {}]])
    event = events.event(Health.OK, "its entry no longer says ERROR")
    assert event.component == "thing"
    assert driver.do("subscriptions", topic="/diagnostics", expected=0) == 0
    bridge.describe(numbers())


@pytest.mark.parametrize("goes", ["/numbers", "/others"], ids=["one topic", "two topics"])
def test_links_and_inputs_are_judged_too(
    bridge: Bridge, events: Inbox, driver: Peer, goes: str
) -> None:
    driver.do("subscribe", topic=goes)
    link = bridge.link(
        numbers(), evolve(endpoint(Role.INPUT, goes, INT64, diagnostics="arm"), component="arm")
    )
    assert link is not None
    driver.do("diagnose", entries=[["arm", WARN, "warm", {}], [WHEEL, WARN, "hot", {}]])
    for cause, component in (("'warm'", "arm"), ("'hot'", "thing")):
        event = events.event(Health.DEGRADED, cause)
        assert (event.channel, event.component) == (link, component)
    driver.do("diagnose", entries=[["arm", WARN, "warm", {}], [WHEEL, OK, "", {}]])
    mended = events.wait_until(lambda item: item.channel is link and item.health is Health.OK)
    assert mended.component == "thing"
    driver.do("diagnose", entries=[["arm", ERROR, "stuck", {}], [WHEEL, OK, "", {}]])
    event = events.event(Health.LOST, "'stuck'")
    assert (event.channel, event.component) == (link, "arm")
    driver.do("diagnose", entries=[["arm", OK, "", {}], [WHEEL, OK, "", {}]])
    wait(lambda: events.messages[-1].health is Health.OK)
    link.close()
    assert driver.do("subscriptions", topic="/diagnostics", expected=0) == 0


def test_where_the_option_does_not_go_it_is_refused(bridge: Bridge) -> None:
    for at in (
        endpoint(Role.SERVICE, "/switch", "std_srvs/srv/SetBool", diagnostics=WHEEL),
        endpoint(Role.OUTPUT, "/act", "test_msgs/action/Fibonacci", "result", diagnostics=WHEEL),
    ):
        with pytest.raises(BridgeError, match="diagnostics goes with topics of a comp") as error:
            bridge.describe(at)
        assert error.value.reason is FailureReason.BAD_ENDPOINT


def test_a_package_that_is_not_installed_is_named(
    bridge: Bridge, driver: Peer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "diagnostic_msgs.msg", None)
    words = "option diagnostics: type .* install ros-<distribution>-diagnostic-msgs"
    with pytest.raises(BridgeError, match=words) as error:
        bridge.describe(numbers())
    assert error.value.reason is FailureReason.NOT_FOUND


PATIENT = f"{OPTIONS}, diagnostics_timeout: {patience()}"
HOSTS = ["", f", host: {{silence: {patience()}, start: {patience()}}}"]


@pytest.mark.parametrize("host", HOSTS, ids=["here", "hosted"])
def test_an_error_leads_to_a_takeover_and_its_end_to_the_return(peer: Start, host: str) -> None:
    driver = peer("driver")
    driver.do("advertise", topic="/first")
    driver.do("advertise", topic="/second")
    driver.do("diagnose", entries=[[WHEEL, OK, "", {}]])
    text = f"""
version: 1
failover: {{return_after: 0.2}}
bridges: {{ros: {{plugin: ros2, options: {{{PATIENT}}}{host}}}}}
functions:
  numbers:
    components:
      - name: first
        bridge: ros
        priority: 2
        output: {{endpoint: [/first, {INT64}], options: {{diagnostics: "{WHEEL}"}}}}
      - {{name: second, bridge: ros, output: {{endpoint: [/second, {INT64}]}}}}
"""
    with RobotManager(loads(text)) as robot:
        connection = robot.request("numbers", timeout=2 * patience())
        driver.do("diagnose", entries=[[WHEEL, ERROR, "stalled", {}]])
        # By its gap: the status may name what takes over before the application receives from it.
        wait(lambda: connection.gaps)
        assert "says ERROR 'stalled'" in connection.gaps[0].cause
        driver.do("publish", topic="/second", count=1)
        assert connection.get(patience()) == {"data": 1}
        assert driver.do("subscriptions", topic="/first", expected=0) == 0
        driver.do("diagnose", entries=[[WHEEL, OK, "fine", {}]])
        wait(lambda: len(connection.gaps) == 2)
        assert [gap.after for gap in connection.gaps] == [("second",), ("first",)]
        assert connection.state is ConnectionState.RUNNING
        driver.do("publish", topic="/first", count=1, first=7)
        assert connection.get(patience()) == {"data": 7}


def test_a_connection_without_another_candidate_waits_until_the_error_is_over(peer: Start) -> None:
    driver = peer("driver")
    driver.do("advertise", topic="/numbers")
    driver.do("diagnose", entries=[[WHEEL, OK, "", {}]])
    text = f"""
version: 1
failover: {{wait: {min(3600.0, 10 * patience())}}}
bridges: {{ros: {{plugin: ros2, options: {{{PATIENT}}}}}}}
functions:
  numbers:
    components:
      - name: only
        bridge: ros
        output: {{endpoint: [/numbers, {INT64}], options: {{diagnostics: "{WHEEL}"}}}}
"""
    with RobotManager(loads(text)) as robot:
        connection = robot.request("numbers", timeout=2 * patience())
        driver.do("diagnose", entries=[[WHEEL, ERROR, "stalled", {}]])
        wait(lambda: connection.state is ConnectionState.WAITING)
        driver.do("diagnose", entries=[[WHEEL, OK, "fine", {}]])
        wait(lambda: connection.state is ConnectionState.RUNNING)
        wait(lambda: reaches(driver, "/numbers", connection))
