"""Native links: both ends are watched, the one at fault is blamed, and both ends' options hold."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from endpoints import ANSWERS, HANGS_AFTER, Make, Start, of, shorten, stamped
from peers import Peer
from tests.inbox import Inbox  # type: ignore[import-not-found]

from uoarm import RobotManager
from uoarm.bridge import Bridge, Channel, HealthEvent
from uoarm.model import Health, Role
from uoarm.testing import wait


def linked_options(bridge: Bridge, out: dict[str, Any], into: dict[str, Any]) -> Channel | None:
    return bridge.link(of("From", Role.OUTPUT, "out", **out), of("Into", Role.INPUT, "in", **into))


def concerned(event: HealthEvent) -> str | None:
    if event.component is not None or event.channel is None:
        return event.component
    return event.channel.endpoint.component


def asked_by_the_source(fault: str) -> Callable[[Peer, Peer], object]:
    """Have the source's port ask the sink's, as in Python, before something becomes of the sink."""

    def happen(out: Peer, into: Peer) -> None:
        out.ask_the_other_port()
        getattr(into, fault)()

    return happen


FAULTS: dict[str, tuple[Callable[[Peer, Peer], object], str, str]] = {
    "the sink dies": (lambda _, into: into.kill(), "Into", "gone"),
    "the sink dies, and the source asks it": (asked_by_the_source("kill"), "Into", "gone"),
    "the sink hangs, and the source asks it": (asked_by_the_source("freeze"), "Into", "it hangs"),
    "the source dies": (lambda out, _: out.kill(), "From", "gone"),
    "the sink hangs": (lambda _, into: into.freeze(), "Into", "it hangs"),
    "the source hangs": (lambda out, _: out.freeze(), "From", "it hangs"),
    "the sink fails": (lambda _, into: into.abort(), "Into", "in state ERROR"),
    "the source fails": (lambda out, _: out.abort(), "From", "in state ERROR"),
    "the sink drops it": (lambda _, into: into.forget(), "Into", "has ended the connection"),
    "the source drops it": (lambda out, _: out.forget(), "From", "has ended the connection"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_the_end_at_fault_is_blamed_and_the_other_released(
    make_bridge: Make, peer: Start, fault: str
) -> None:
    happen, blamed, words = FAULTS[fault]
    # What answers late on a busy machine is not at fault: a long limit where nothing hangs.
    limit = {"call_timeout": HANGS_AFTER} if "hangs" in fault else {}
    bridge, events = make_bridge(**limit), Inbox()
    bridge.watch(events)
    ends = {"From": peer("From"), "Into": peer("Into")}
    for item in ends.values():
        item.activate()
    link = linked_options(bridge, {}, {})
    assert link is not None
    if "hangs" in fault:
        shorten(bridge, f"{blamed}.rtc")
    happen(*ends.values())
    if fault == "the sink dies":
        ends["From"].count(0, 1)  # at which the source drops the connection
    # That the component is lost may be reported before that the link is.
    wait(
        lambda: any(
            words in message.cause and concerned(message) == blamed for message in events.messages
        )
    )
    lost = [message for message in events.messages if message.health is Health.LOST]
    assert {concerned(item) for item in lost} <= {blamed, f"{blamed}.rtc"}
    if "hangs" not in fault:
        link.close()
        blameless = ends["Into" if blamed == "From" else "From"]
        assert blameless.connectors() == [0, 0]


def test_a_second_sink_takes_over(nameserver: str, peer: Start, tmp_path: Path) -> None:
    numbers, first, second = peer("Numbers"), peer("First"), peer("Second")
    for item in (numbers, first, second):
        item.activate()
    takes = "input: {from: numbers, endpoint:"
    file = tmp_path / "robot.yaml"
    file.write_text(f"""
version: 1
bridges:
  rtm: {{plugin: rtm, options: {{nameserver: "{nameserver}", watch: 0.1, call_timeout: {ANSWERS}}}}}
functions:
  numbers:
    components:
      - {{name: numbers, bridge: rtm, output: {{endpoint: [Numbers.rtc, out]}}}}
  taker:
    components:
      - {{name: first, bridge: rtm, priority: 2, {takes} [First.rtc, in]}}}}
      - {{name: second, bridge: rtm, priority: 1, {takes} [Second.rtc, in]}}}}
""")
    with RobotManager.from_file(file) as robot, robot.request("taker") as connection:
        assert [route.native for route in robot.status().routes] == [True]
        first.kill()
        numbers.count(0, 1)
        wait(lambda: connection.plan.provider.component.name == "second")
        wait(lambda: second.connectors() == [1, 0])
        wait(lambda: numbers.connectors() == [0, 1])
        numbers.count(7, 8)
        wait(lambda: stamped(7, 7) in second.received() or second.received()[-1]["data"] == 7)
        healths = {component.name: component.health for component in robot.status().components}
        assert healths == {"numbers": Health.OK, "second": Health.OK}
    assert (numbers.connectors(), second.connectors()) == ([0, 0], [0, 0])


def test_the_options_of_both_ends_hold(bridge: Bridge, peer: Start) -> None:
    component, _ = peer("From"), peer("Into")
    into = {
        "subscription": "new",
        "push_policy": "fifo",
        "outport_buffer": {"length": 100, "full_policy": "block", "write_timeout": 0.5},
        "inport_buffer": {"length": 1, "full_policy": "do_nothing"},
        "properties": {"of.the.sink": "yes"},
    }
    link = linked_options(bridge, {"properties": {"of.the.source": "yes"}, "activate": True}, into)
    assert link is not None
    [made] = component.made()
    wanted = {
        "dataport.subscription_type": "new",
        "dataport.publisher.push_policy": "fifo",
        "dataport.outport.buffer.length": "100",
        "dataport.outport.buffer.write.full_policy": "block",
        "dataport.outport.buffer.write.timeout": "0.5",
        "dataport.inport.buffer.length": "1",
        "dataport.inport.buffer.write.full_policy": "do_nothing",
        "of.the.source": "yes",
        "of.the.sink": "yes",
    }
    assert {name: made.get(name) for name in wanted} == wanted
    link.close()


@pytest.mark.parametrize(
    ("out", "into"),
    [
        ({"subscription": "periodic"}, {"subscription": "new"}),
        ({"properties": {"a": "1"}}, {"properties": {"a": "2"}}),
        ({"stale_after": 5}, {}),
        ({}, {"timeout": 1}),
        ({"push_policy": "all", "subscription": "new"}, {"flow": "pull"}),
    ],
    ids=str,
)
def test_what_one_connection_cannot_be_goes_through_us(
    bridge: Bridge, peer: Start, out: dict[str, Any], into: dict[str, Any]
) -> None:
    component, _ = peer("From"), peer("Into")
    assert linked_options(bridge, out, into) is None
    assert component.connectors() == [0, 0]
