"""What stands on topics: the last message of each until it is cleared, for who comes later, too."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest
from brokers import Broker, Peer

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.errors import MessageError
from uoarm.model import Health
from uoarm.testing import patience, wait

ROBOT = """
version: 1
bridges:
  mqtt: {{plugin: mqtt, options: {{url: "{url}"}}{host}}}
functions:
  scan:
    components:
      - name: scanner
        bridge: mqtt
        output: {{endpoint: [scan], structure: true, options: {{retain: true}}}}
  all:
    components:
      - name: plant
        bridge: mqtt
        output:
          endpoint: ["plant/+"]
          structure: true
          options: {{retain: true, with_topic: true}}
  torn:
    components:
      - {{name: torn, bridge: mqtt, priority: 2, output: {{endpoint: [torn], structure: true}}}}
      - {{name: whole, bridge: mqtt, output: {{endpoint: [whole], structure: true}}}}
  note:
    components:
      - {{name: note, bridge: mqtt, input: {{endpoint: [note], structure: true}}}}
  text:
    components:
      - name: board
        bridge: mqtt
        output: {{endpoint: [text], options: {{retain: true, content: text}}}}
"""
HOSTS = pytest.mark.parametrize("hosted", [False, True], ids=["here", "hosted"], indirect=True)


@pytest.fixture
def hosted(request: pytest.FixtureRequest) -> bool:
    return bool(getattr(request, "param", False))


@pytest.fixture
def robot(broker: Broker, hosted: bool) -> Iterator[RobotManager]:
    host = f", host: {{silence: {patience():g}, start: {patience():g}}}" if hosted else ""
    with RobotManager(loads(ROBOT.format(url=broker.url, host=host))) as robot:
        yield robot


@pytest.fixture
def peer(broker: Broker) -> Iterator[Peer]:
    made = Peer(broker)
    yield made
    for name in "abcd":
        made.publish(f"plant/{name}", "", retain=True)
    made.close()


def facts(robot: RobotManager, component: str) -> dict[str, Any]:
    [found] = [status for status in robot.status().components if status.name == component]
    return dict(found.channels[0].facts)


@HOSTS
def test_what_is_cleared_stands_no_more_and_harms_no_receiver(
    robot: RobotManager, peer: Peer
) -> None:
    peer.publish("scan", json.dumps({"n": 1}), retain=True)
    first = robot.request("scan")
    assert first.get(patience()) == {"n": 1}
    assert robot.request("scan").get(patience()) == {"n": 1}
    peer.publish("scan", "", retain=True)
    wait(lambda: facts(robot, "scanner").get("cleared") == 1)
    later = robot.request("scan")
    with pytest.raises(TimeoutError):
        later.get(0)
    [component] = [status for status in robot.status().components if status.name == "scanner"]
    assert (component.health, component.cause) == (Health.OK, "")
    peer.publish("scan", json.dumps({"n": 2}))
    assert [connection.get(patience()) for connection in (first, later)] == [{"n": 2}] * 2


@HOSTS
def test_the_last_message_of_each_topic_stands(robot: RobotManager, peer: Peer) -> None:
    for name, number in (("a", 1), ("b", 2), ("c", 3)):
        peer.publish(f"plant/{name}", json.dumps(number), retain=True)
    first = robot.request("all")
    assert sorted(first.get(patience())["message"] for _ in range(3)) == [1, 2, 3]
    peer.publish("plant/a", "4", retain=True)
    peer.publish("plant/b", "", retain=True)
    peer.publish("plant/d", "5", retain=True)
    assert [first.get(patience())["message"] for _ in range(2)] == [4, 5]
    second = robot.request("all")
    assert sorted(second.get(patience())["message"] for _ in range(3)) == [3, 4, 5]
    with pytest.raises(TimeoutError):
        second.get(0)


def test_an_empty_text_comes_and_does_not_stand(robot: RobotManager, peer: Peer) -> None:
    first = robot.request("text")
    peer.publish("text", "hello", retain=True)
    peer.publish("text", "", retain=True)
    assert [first.get(patience()) for _ in range(2)] == ["hello", ""]
    with pytest.raises(TimeoutError):
        robot.request("text").get(0)


@pytest.mark.parametrize(
    ("payload", "why"),
    [("1e400", "beyond"), ("[NaN]", "no number of JSON"), (r'"\ud800"', "surrogate")],
)
def test_what_is_no_number_or_text_is_refused(
    robot: RobotManager, peer: Peer, payload: str, why: str
) -> None:
    scans = robot.request("scan")
    peer.publish("scan", payload)
    peer.publish("scan", "1")
    assert scans.get(patience()) == 1
    [component] = [status for status in robot.status().components if status.name == "scanner"]
    assert component.health in {Health.OK, Health.DEGRADED}
    assert facts(robot, "scanner")["unreadable"] == 1


@pytest.mark.parametrize(
    ("message", "why"), [(float("nan"), "not JSON compliant"), ("x" * 2_000_000, "are allowed")]
)
def test_what_has_no_form_is_an_error_of_the_send(
    robot: RobotManager, message: object, why: str
) -> None:
    note = robot.request("note")
    with pytest.raises(MessageError, match=why):
        note.send(message)


@HOSTS
def test_where_nothing_can_be_read_the_next_candidate_takes_over(
    robot: RobotManager, peer: Peer
) -> None:
    with robot.request("torn") as connection:

        def is_replaced() -> bool:
            peer.publish("torn", "{")
            return bool(connection.gaps)

        wait(is_replaced, "it is never lost")
        assert "its output 'default' gives again and again what cannot be read" in (
            connection.gaps[0].cause
        )
        peer.publish("whole", "7")
        assert connection.get(patience()) == 7
