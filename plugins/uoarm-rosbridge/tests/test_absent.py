"""Functions that cannot be had yet: waited for as ROS does, and never waited for by those who ask.

`components:late` is there only once a test has put it there, as a topic is whose publisher starts.
"""

from __future__ import annotations

from collections.abc import Callable

import components
import pytest
from ros import Enter, Ros, Serve, url
from tests.server.robot import numbers, script  # type: ignore[import-not-found]
from tests.server.talk import eventually, opened  # type: ignore[import-not-found]

from uoarm import RobotManager
from uoarm.server import Limits

Appear = Callable[[], None]


@pytest.fixture
def appear(monkeypatch: pytest.MonkeyPatch) -> Appear:
    return lambda: monkeypatch.setattr(components, "late", numbers, raising=False)


def test_a_subscriber_before_its_publisher_waits(
    enter: Enter, robot: RobotManager, appear: Appear
) -> None:
    early, other = enter(), enter()
    for client in (early, other):
        client.send(op="subscribe", id="s", topic="/uoarm/late")
        reports = client.receive()
        assert (reports["op"], reports["level"], reports["id"]) == ("status", "warning", "s")
        assert reports["msg"].startswith("/uoarm/late unavailable: ")
        assert reports["msg"].endswith("; it is waited for")
    appear()
    opened(robot, 1)
    script.put({"value": 7})
    assert early.messages(1) == other.messages(1) == [{"value": 7}]


def test_a_provider_that_failed_is_waited_for(enter: Enter, robot: RobotManager) -> None:
    def fail(count: int) -> None:
        script.put({"value": count}, ValueError("broken"))

    def opened_again(count: int) -> None:
        eventually(lambda: script.numbers.started > count, "it is open again")

    client = enter()
    client.send(op="subscribe", topic="/uoarm/numbers")
    opened(robot, 1)
    fail(1)
    # What is reported goes before messages that wait for the socket at that moment.
    reports = {report["op"]: report for report in (client.receive(), client.receive())}
    assert reports["publish"]["msg"] == {"value": 1}
    assert reports["status"]["level"] == "warning"
    assert reports["status"]["msg"].startswith("/uoarm/numbers has failed: ")
    opened_again(1)
    fail(2)
    assert client.messages(1) == [{"value": 2}]
    opened_again(2)
    script.put({"value": 3})
    assert client.messages(1) == [{"value": 3}], "the same is reported once"


def test_who_leaves_waits_no_longer(enter: Enter, robot: RobotManager, appear: Appear) -> None:
    client = enter()
    client.send(op="subscribe", topic="/uoarm/late")
    client.receive()
    client.send(op="unsubscribe", topic="/uoarm/late")
    assert client.call("/rosapi/topic_type", {"topic": "/uoarm/numbers"})
    appear()
    assert client.call("/rosapi/topic_type", {"topic": "/uoarm/numbers"})
    opened(robot, 0)


def test_a_client_that_wants_errors_only_gets_no_warning(enter: Enter, appear: Appear) -> None:
    client = enter()
    client.send(op="set_level", level="error")
    client.send(op="subscribe", topic="/uoarm/late")
    client.send(op="subscribe", topic="/uoarm/echo/none")
    assert client.receive()["level"] == "error"


def test_more_topics_than_threads_open_one_after_the_other(
    serve: Serve, robot: RobotManager
) -> None:
    server = serve(Limits(openings=1, workers=1))
    topics = ["/uoarm/numbers", "/uoarm/picture", "/uoarm/doubled", "/uoarm/echo"]
    with Ros(url(server)) as client:
        for topic in topics:
            client.send(op="subscribe", topic=topic)
        opened(robot, len(topics))
        client.send(op="set_level", level="none")
        assert client.call("/rosapi/get_time")


def test_types_of_what_appears_are_reported_once_it_has(enter: Enter, appear: Appear) -> None:
    client = enter()

    def types() -> dict[str, str]:
        received = client.call("/rosapi/topics")
        return dict(zip(received["topics"], received["types"], strict=True))

    eventually(lambda: types()["/uoarm/numbers"], "what can be had has its type")
    assert types()["/uoarm/late"] == ""
    appear()
    eventually(lambda: types()["/uoarm/late"], "it has its type")
