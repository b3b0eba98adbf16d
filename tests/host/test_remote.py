"""A hosted bridge keeps the contract: what goes in comes out, errors keep their reason."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.host import hosted
from tests.host.hosted import ANY, Events, at
from tests.processes import lives

from uoarm._host.remote_bridge import RemoteBridge, RemoteChannel
from uoarm._support import deadlines
from uoarm.errors import BridgeError, FailureReason, PluginError
from uoarm.model import BridgeSpec, Health, Role
from uoarm.testing import patience, wait

pytestmark = pytest.mark.usefixtures("unhurried")


@pytest.fixture
def far(tmp_path: Path) -> Iterator[RemoteBridge]:
    bridge = hosted.bridge(tmp_path)
    yield bridge
    bridge.close()


def test_structures_are_described_as_in_process(far: RemoteBridge) -> None:
    described = far.describe(at("double", Role.INPUT))
    assert described.message is not None
    assert isinstance(described.message.schema, dict)
    assert described.message.schema["type"] == "integer"


def test_an_endpoint_that_does_not_exist_keeps_its_reason(far: RemoteBridge) -> None:
    with pytest.raises(BridgeError, match="no_such") as caught:
        far.describe(at("no_such"))
    assert caught.value.reason is FailureReason.NOT_FOUND


def test_a_source_delivers_all_in_order_and_then_finishes(far: RemoteBridge) -> None:
    events, got = Events(), list[int]()
    far.watch(events)
    channel = far.open_source(at("count"), ANY, got.append)
    wait(lambda: events.all)
    assert got == list(range(1000))
    assert events.all[0].health is Health.FINISHED
    assert events.all[0].channel is channel
    assert channel.facts()["lost_on_link"] == 0


def test_what_has_no_room_for_too_long_is_counted_and_the_end_is_reported(tmp_path: Path) -> None:
    """A host gives up a message when the receiver has handled none for a second."""
    far = hosted.bridge(tmp_path, variables={})
    events, got = Events(), list[int]()
    gives_up = threading.Event()

    def take(number: int) -> None:
        assert gives_up.wait(patience())
        got.append(number)

    far.watch(events)
    channel = far.open_source(at("count"), ANY, take)
    wait(lambda: channel.facts()["under_way"] in (999, 1000))  # a window was sent, and some tries
    gives_up.set()
    wait(lambda: events.all)
    assert events.all[0].health is Health.FINISHED
    assert got[:64] == list(range(64))
    assert got == sorted(set(got))
    assert channel.facts()["lost_on_link"] == 1000 - len(got) > 0
    far.close()


def test_what_the_bridge_in_the_host_lost_counts_too(far: RemoteBridge) -> None:
    channels = (
        far.open_source(at("count"), ANY, lambda _: None),
        far.open_sink(at("double", Role.INPUT), ANY),
    )
    far.close()  # no more facts come from the host
    for channel in channels:
        assert isinstance(channel, RemoteChannel)
        channel.host_facts = {"lost_on_link": 3, "of_its_own": 1}
        facts = channel.facts()
        assert (facts["lost_on_link"], facts["of_its_own"]) == (3, 1)


def test_a_source_that_raises_is_lost_with_its_cause(far: RemoteBridge) -> None:
    events = Events()
    far.watch(events)
    far.open_source(at("fails"), ANY, lambda _: None)
    wait(lambda: events.all)
    assert events.all[0].health is Health.LOST
    assert "the camera is unplugged" in events.all[0].cause


def test_messages_go_through_a_component_and_come_back(far: RemoteBridge) -> None:
    got: list[dict[str, object]] = []
    far.open_source(at("echo"), ANY, got.append)
    sink = far.open_sink(at("echo", Role.INPUT), ANY)
    image = np.arange(300_000, dtype="u1").reshape(300, 1000)
    for number in range(200):
        sink.send({"n": number, "octets": b"abc", "image": image})
    wait(lambda: len(got) == 200)
    assert [item["n"] for item in got] == list(range(200))
    assert got[0]["octets"] == b"abc"
    assert (got[-1]["image"] == image).all()


def test_what_is_under_way_when_a_sink_closes_is_still_handled(far: RemoteBridge) -> None:
    got: list[int] = []
    far.open_source(at("slow"), ANY, got.append)
    sink = far.open_sink(at("slow", Role.INPUT), ANY)
    for number in range(8):
        sink.send(number)
    sink.close()
    wait(lambda: len(got) == 8)


def test_a_component_that_raises_is_counted(far: RemoteBridge) -> None:
    sink = far.open_sink(at("refuse", Role.INPUT), ANY)
    for number in range(20):
        sink.send(number)
    wait(lambda: sink.facts()["failed_in_host"] == 20)
    assert "is not wanted" in str(sink.facts()["last_error_in_host"])


def test_a_service_answers_and_its_errors_cross(far: RemoteBridge) -> None:
    assert far.call(at("double", Role.SERVICE), 21) == 42
    with pytest.raises(BridgeError, match="3 is not wanted"):
        far.call(at("refuse", Role.SERVICE), 3)


def test_the_bridge_runs_in_another_process(far: RemoteBridge) -> None:
    assert far.call(at("process_id", Role.SERVICE), 0) == far.process


def test_what_the_host_prints_reaches_the_log_with_its_name(
    far: RemoteBridge, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO, "uoarm.host.far"):
        far.call(at("say", Role.SERVICE), 7)
        wait(lambda: "spoken 7" in caplog.text)
    assert any(record.name == "uoarm.host.far" for record in caplog.records)


@pytest.mark.parametrize("role", [Role.INPUT, Role.SERVICE])
def test_what_a_component_raises_in_the_host_is_logged_with_its_line(
    far: RemoteBridge, caplog: pytest.LogCaptureFixture, role: Role
) -> None:
    if role is Role.INPUT:
        far.open_sink(at("refuse", role), ANY).send(7)
    else:
        with pytest.raises(BridgeError, match="7 is not wanted"):
            far.call(at("refuse", role), 7)
    wait(lambda: "ValueError: 7 is not wanted" in caplog.text)
    wait(lambda: "in refuse" in caplog.text)
    assert "in foreign" not in caplog.text


def test_a_crash_in_c_is_reported_with_the_line_that_called_it(
    far: RemoteBridge, caplog: pytest.LogCaptureFixture
) -> None:
    with pytest.raises(BridgeError, match="SIGSEGV"):
        far.call(at("crash", Role.SERVICE), 7)
    wait(lambda: "in crash" in caplog.text)
    reports = [record for record in caplog.records if record.name == "uoarm.host.far"]
    assert reports[0].getMessage() == "Fatal Python error: Segmentation fault"
    assert {report.levelno for report in reports} == {logging.ERROR}


def test_a_plugin_that_is_missing_in_the_host_says_so(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with pytest.raises(PluginError, match="there is no plugin 'absent'"):
        RemoteBridge(BridgeSpec("far", "absent", {}, {"start": patience()}))
    assert "by itself" not in caplog.text, "it waits to be ended: nothing is wrong with that"


def test_a_python_without_uoarm_says_what_it_printed(tmp_path: Path) -> None:
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\necho no module named uoarm >&2\nexit 1\n")
    python.chmod(0o755)
    with pytest.raises(BridgeError, match="ended with status 1\nno module named uoarm"):
        RemoteBridge(BridgeSpec("far", "python", {}, {"python": str(python), "start": patience()}))


@pytest.mark.usefixtures("nothing_is_left")
def test_a_host_that_is_never_ready_is_given_up_and_ended(tmp_path: Path) -> None:
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\nexec sleep 60\n")
    python.chmod(0o755)
    with pytest.raises(BridgeError, match="was not ready in time"):
        RemoteBridge(BridgeSpec("far", "python", {}, {"python": str(python), "start": 0.5}))


@pytest.mark.usefixtures("nothing_is_left")
def test_closing_leaves_nothing_behind(tmp_path: Path) -> None:
    bridge = hosted.bridge(tmp_path)
    bridge.open_source(at("forever"), ANY, lambda _: None)
    bridge.open_sink(at("double", Role.INPUT), ANY)
    process = bridge.process
    bridge.close()
    assert not lives(process)


def test_the_facts_of_the_bridge_come_with_the_heartbeat(far: RemoteBridge) -> None:
    assert far.facts() == {}
    far.call(at("know", Role.SERVICE), 3)
    wait(lambda: far.facts() == {"empty_turns": 3})
    far.call(at("know", Role.SERVICE), None)
    wait(lambda: set(far.facts()) == {"facts"})
    assert "TypeError" in str(far.facts()["facts"])


def test_what_is_closed_in_a_host_has_the_time_that_its_caller_gives(
    far: RemoteBridge, monkeypatch: pytest.MonkeyPatch
) -> None:
    limits: dict[str, float] = {}
    ask = far._host.ask

    def noting(operation: str, values: dict[str, Any]) -> object:
        limits[operation] = values.get("timeout", 0.0)
        return ask(operation, values)

    monkeypatch.setattr(far._host, "ask", noting)
    source = far.open_source(at("forever", Role.OUTPUT), ANY, lambda _: None)
    source.close(timeout=10 * patience())
    far.close(timeout=10 * patience())
    assert limits["close_channel"] > patience()
    assert limits["close"] > patience()


def test_what_a_step_has_left_is_what_its_innermost_limit_leaves() -> None:
    assert deadlines.left(7.0) == 7.0
    outer = deadlines.run("outer", 1000.0, lambda: deadlines.left(7.0))
    assert 7.0 < outer <= 1000.0
    inner = deadlines.run(
        "outer", 1000.0, lambda: deadlines.run("inner", 100.0, lambda: deadlines.left(7.0))
    )
    assert 7.0 < inner <= 100.0
