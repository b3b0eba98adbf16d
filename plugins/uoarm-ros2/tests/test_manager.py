"""What applications meet when their functions are ROS 2 topics: the manager above the bridge."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path

import pytest
from endpoints import INT64, Start, reaches
from peers import MORTAL
from robots import HOSTED, robot

from uoarm import RobotManager
from uoarm.errors import MessageError, ResolutionError
from uoarm.model import ConnectionState, QueuePolicy, StatusEvent
from uoarm.testing import patience, wait

LATE_SECONDS = 2.0  # twice as long as a host waits for a reader of anything else


HOSTS = ["", HOSTED]
KEPT = """
  numbers:
    components:
      - name: numbers
        bridge: ros
        input:
          endpoint: [/kept, std_msgs/msg/Int64]
          options: {qos: {history: keep_all}}
"""


@pytest.mark.parametrize("host", HOSTS, ids=["here", "hosted"])
def test_of_what_is_sent_at_once_keep_all_loses_nothing(peer: Start, host: str) -> None:
    listener = peer("listener")
    listener.do("subscribe", topic="/kept", history="keep_all")
    with robot(KEPT, host=host) as manager, manager.request("numbers") as connection:
        for number in range(2000):
            connection.send({"data": number})
        assert connection.flush(patience())
        seen = listener.do("report", topic="/kept", expected=2000)
    assert seen == list(range(2000))


FROM = """
  numbers:
    components:
      - name: numbers
        bridge: ros
        output:
          endpoint: [/from, std_msgs/msg/Int64]
          options: {qos: {history: keep_all}}
"""


@pytest.mark.parametrize("host", HOSTS, ids=["here", "hosted"])
def test_of_what_comes_at_once_keep_all_loses_nothing_to_who_reads_late(
    peer: Start, host: str
) -> None:
    talker = peer("talker")
    talker.do("advertise", topic="/from", history="keep_all")
    waits = QueuePolicy(policy="block", timeout=patience())
    with robot(FROM, host=host) as manager:
        connection = manager.request("numbers", queue=waits)
        talker.do("publish", topic="/from", count=2000)
        time.sleep(LATE_SECONDS)
        assert [connection.get(patience())["data"] for _ in range(2000)] == [*range(1, 2001)]


OUT = """
  numbers:
    components:
      - name: numbers
        bridge: ros
        output: {endpoint: [/mortal, std_msgs/msg/Int64]}
"""


def test_a_publisher_that_starts_again_is_waited_for(peer: Start) -> None:
    first = peer("first", **MORTAL)
    first.do("advertise", topic="/mortal")
    waits = f"failover: {{wait: {patience()}}}"
    with robot(OUT, waits) as manager, manager.request("numbers") as connection:
        first.kill()
        wait(lambda: connection.state is ConnectionState.WAITING)
        second = peer("second")
        second.do("advertise", topic="/mortal")
        wait(lambda: connection.state is ConnectionState.RUNNING)
        wait(lambda: reaches(second, "/mortal", connection))


LATCHED = """
  static:
    components:
      - name: static
        bridge: ros
        output: {endpoint: [/static, std_msgs/msg/Int64]}
"""


@pytest.mark.parametrize("host", HOSTS, ids=["here", "hosted"])
def test_the_last_of_each_publisher_stand_as_long_as_it_is_there(peer: Start, host: str) -> None:
    """As for a bare subscription of each application's own, such as one to `/tf_static`."""
    writers = [peer(f"writer_{number}") for number in range(3)]
    for number, writer in enumerate(writers):
        writer.do("advertise", topic="/static", durability="transient_local", depth=3)
        writer.do("publish", topic="/static", count=3, first=10 * number)
    expected = sorted(10 * number + step for number in range(3) for step in range(3))

    def standing() -> list[int]:
        """Return what an application that comes now has at once."""
        came = []
        with manager.request("static") as later, suppress(TimeoutError):
            while True:
                came.append(later.get(0)["data"])
        return sorted(came)

    with robot(LATCHED, host=host) as manager:
        first = manager.request("static")
        assert sorted(first.get(patience())["data"] for _ in expected) == expected
        assert standing() == expected
        writers[0].end()
        wait(lambda: standing() == expected[3:])
        writers[1].do("publish", topic="/static", count=1, first=100)
        assert first.get(patience()) == {"data": 100}
        assert standing() == [*expected[3:], 100]
        with pytest.raises(TimeoutError):
            first.get(0)


WRITTEN = """
  words:
    components:
      - name: words
        bridge: ros
        input: {endpoint: [/words, std_msgs/msg/String], options: {peer: optional}}
"""


@pytest.mark.parametrize("text", ["a\0b", "\ud800"])
def test_a_text_that_ros_2_has_no_form_for_is_an_error_of_the_send(text: str) -> None:
    with robot(WRITTEN) as manager, manager.request("words") as words:
        words.send({"data": "fine"})
        with pytest.raises(MessageError, match="data: expected"):
            words.send({"data": text})


TAGS = """
  tag:
    components:
      - {name: tag, bridge: python, output: {endpoint: ["tagging:short"]}}
  longTag:
    components:
      - {name: longTag, bridge: python, output: {endpoint: ["tagging:long"]}}
  shown:
    components:
      - name: shown
        bridge: ros
        output: {endpoint: [/tags, p/msg/Tag]}
  board:
    components:
      - name: board
        bridge: ros
        input:
          FROM
          endpoint: [/tags, p/msg/Tag]
          options: {peer: optional}
"""


def tags(folder: Path, component: str = "") -> RobotManager:
    definition = folder / "p" / "msg" / "Tag.msg"
    definition.parent.mkdir(parents=True, exist_ok=True)
    definition.write_text("string<=22 name\nwstring<=22 wide\nstring note\n")
    functions = TAGS.replace("FROM", f"from: {component}" if component else "")
    return robot(functions, definitions=folder)


@pytest.mark.parametrize(
    ("name", "wide", "wrong"),
    [
        ("é" * 11, "é" * 22, ""),
        ("a" * 22, "\U0001f600" * 11, ""),
        ("é" * 22, "", r"name: expected at most 22 octets \(UTF-8\), got 44"),
        ("", "\U0001f600" * 22, r"wide: expected at most 22 code units \(UTF-16\), got 44"),
        ("a\0b", "", "name: expected a string without the character NUL"),
        ("", "a\0b", "wide: expected a string without the character NUL"),
    ],
)
def test_a_bounded_text_is_counted_as_it_is_written(
    tmp_path: Path, name: str, wide: str, wrong: str
) -> None:
    message = {"name": name, "wide": wide, "note": ""}
    with tags(tmp_path) as manager, manager.request("board") as board:
        if wrong:
            with pytest.raises(MessageError, match=wrong):
                board.send(message)
            message = {"name": "fine", "wide": "fine", "note": ""}
        shown = manager.request("shown")
        board.send(message)
        assert shown.get(patience()) == message


def test_a_producer_that_may_give_a_longer_text_is_refused_with_one(tmp_path: Path) -> None:
    with tags(tmp_path, "longTag") as manager:
        with pytest.raises(ResolutionError) as refused:
            manager.resolve("board")
        text = str(refused.value)
        assert "octets of UTF-8 are more than 22" in text
        assert "name" in text
    with tags(tmp_path, "tag") as manager:
        assert manager.resolve("board").warnings == ()


@pytest.mark.parametrize("host", HOSTS, ids=["here", "hosted"])
@pytest.mark.parametrize("goes", ["/first", "/taken"], ids=["two topics", "one topic"])
def test_a_consumer_of_a_link_that_is_killed_is_replaced_and_no_producer_blamed(
    peer: Start, goes: str, host: str
) -> None:
    talker, first, second = peer("talker"), peer("first", **MORTAL), peer("second")
    talker.do("advertise", topic="/taken")
    first.do("subscribe", topic=goes)
    second.do("subscribe", topic="/second")
    functions = f"""
  numbers:
    components: [{{name: numbers, bridge: ros, output: {{endpoint: [/taken, {INT64}]}}}}]
  taker:
    components:
      - name: first
        bridge: ros
        priority: 2
        input: {{from: numbers, endpoint: [{goes}, {INT64}]}}
      - {{name: second, bridge: ros, input: {{from: numbers, endpoint: [/second, {INT64}]}}}}
"""
    with robot(functions, host=host) as manager, manager.request("taker") as connection:
        assert [route.native for route in manager.status().routes] == [True]
        changes: list[StatusEvent] = []
        manager.listen(changes.append)
        first.kill()
        wait(lambda: connection.plan.provider.component.name == "second", lambda: str(changes))
        assert [event.change for event in changes if event.subject == "component numbers"] == []
