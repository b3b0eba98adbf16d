"""When a provider dies the next that fits goes on behind the same handle, with an event."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import pytest
from attrs import evolve

from uoarm import BridgeError, Connection, ConnectionClosedError, RobotManager
from uoarm._control.engine import actions as act
from uoarm._control.engine import events as ev
from uoarm._control.engine.state import State
from uoarm._control.live import driver
from uoarm._control.live.connection_runtime import LossAccount
from uoarm._support import deadlines
from uoarm.bridge import Channel
from uoarm.config import loads
from uoarm.model import (
    ConnectionState,
    Endpoint,
    FailoverPolicy,
    Gap,
    Health,
    Robot,
    StatusEvent,
)
from uoarm.testing import (
    Emitter,
    Hang,
    Loop,
    ManualClock,
    MemoryBridge,
    hanging,
    patience,
    wait,
)

NUMBER = {"type": "integer", "minimum": 0, "maximum": 1000}
WIDER = {"type": "integer", "minimum": 0, "maximum": 2000}
TEXT = {"type": "string"}

ROBOT = """
version: 1
bridges: {one: {plugin: memory}, two: {plugin: memory}}
functions:
  camera:
    components:
      - {name: best, bridge: one, priority: 3, output: {endpoint: [best]}}
      - {name: next, bridge: two, priority: 2, output: {endpoint: [next]}}
      - {name: last, bridge: two, priority: 1, output: {endpoint: [last]}}
  face:
    components:
      - name: finder
        bridge: two
        input: {from: camera, endpoint: [finder]}
        output: {endpoint: [finder]}
"""


class Stage:
    """A robot with two bridges in memory, and what it reported."""

    def __init__(self, policy: FailoverPolicy, **schemas: object) -> None:
        self.one, self.two = MemoryBridge("one", {}), MemoryBridge("two", {})
        self.best = self.one.emitter("best", NUMBER)
        self.next = self.two.emitter("next", schemas.get("next", NUMBER))  # type: ignore[arg-type] # a schema
        self.last = self.two.emitter("last", NUMBER)
        self.finder: Loop = self.two.loop("finder", NUMBER)
        robot: Robot = evolve(loads(ROBOT), failover=policy)
        self.robot = RobotManager(robot, bridges={"one": self.one, "two": self.two})
        self.events: list[StatusEvent] = []
        self.robot.listen(self.events.append)

    def replaced(self) -> int:
        return sum(event.change == "replaced" for event in self.events)


Make = Callable[..., Stage]


@pytest.fixture
def make() -> Iterator[Make]:
    stages: list[Stage] = []

    def build(policy: FailoverPolicy = FailoverPolicy(), **schemas: object) -> Stage:  # noqa: B008 - frozen
        stages.append(Stage(policy, **schemas))
        return stages[-1]

    yield build
    for stage in stages:
        stage.robot.close()


def test_the_next_candidate_goes_on_behind_the_same_handle(make: Make) -> None:
    stage = make()
    connection = stage.robot.request("camera")
    stage.best.emit(1)
    stage.one.die("best", "it was unplugged")
    wait(lambda: connection.gaps)
    stage.next.emit(2)
    assert [connection.get(patience()), connection.get(patience())] == [1, 2]
    (gap,) = connection.gaps
    assert (gap.before, gap.after, gap.position) == (("best",), ("next",), 1)
    assert "it was unplugged" in gap.cause
    assert connection.state is ConnectionState.RUNNING
    assert connection.plan.provider.component.name == "next"
    wait(stage.replaced)
    (report,) = [event for event in stage.events if event.change == "replaced"]
    assert report.subject == "connection c1"
    assert report.cause == f"{gap.cause}; next goes on"


def test_a_candidate_that_hangs_while_it_opens_leaves_time_for_another(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(driver, "_FIRST_SHARE", 0.0)  # the last candidate has what is left
    stage = make()
    with hanging(stage.one, "_open_source"):
        connection = stage.robot.request("camera")
        assert connection.plan.provider.component.name != "best"
        connection.kill()
    # What opened too late is closed.
    wait(lambda: (stage.one.open_channels, stage.two.open_channels) == (0, 0))


def test_what_died_is_closed_and_what_goes_on_is_in_the_status(make: Make) -> None:
    stage = make()
    connection = stage.robot.request("camera")
    stage.one.die("best")
    wait(stage.replaced)
    wait(lambda: stage.one.open_channels == 0)
    status = stage.robot.status()
    assert [(component.name, component.users) for component in status.components] == [
        ("next", ("c1",))
    ]
    connection.kill()
    assert stage.two.open_channels == 0
    assert stage.robot.status().components == ()


def test_the_change_is_reported_before_what_died_has_closed(
    make: Make, caplog: pytest.LogCaptureFixture
) -> None:
    stage = make()
    connection = stage.robot.request("camera")
    (channel,) = stage.one._open
    with hanging(channel, "_close"):
        stage.one.die("best")
        wait(lambda: connection.gaps and stage.replaced())
        assert not connection.gaps[0].counted
        assert "given up" not in caplog.text  # nor was its close
    wait(lambda: connection.gaps[0].counted)


def test_with_failover_off_other_events_do_not_wait_for_what_died(
    make: Make, caplog: pytest.LogCaptureFixture
) -> None:
    stage = make(FailoverPolicy(enabled=False))
    stage.robot.request("camera")
    stage.robot.request("face")
    (channel,) = stage.one._open
    with hanging(channel, "_close") as hang:
        stage.one.die("best")
        assert hang.entered.wait(patience())
        stage.two.report(Health.DEGRADED, "hot")
        wait(lambda: any(event.subject == "bridge two" for event in stage.events))
        assert "given up" not in caplog.text


@contextmanager
def requested(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[Future[Connection], Hang]]:
    """Request faces; the opening of the camera, the last of the plan, hangs when it has opened."""
    opened, hang = stage.one._open_source, Hang()

    def hang_once_open(endpoint: Endpoint, *given: Any) -> Channel:
        channel = opened(endpoint, *given)
        hang.wait()
        return channel

    monkeypatch.setattr(stage.one, "_open_source", hang_once_open)
    with ThreadPoolExecutor(1) as pool:
        request = pool.submit(stage.robot.request, "face")
        assert hang.entered.wait(patience())
        yield request, hang


def test_what_dies_while_its_plan_opens_is_replaced_when_all_is_open(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before or after the last part is open is chance; an application sees no difference."""
    stage = make()
    with requested(stage, monkeypatch) as (request, hang):
        stage.one.die("best", "it was unplugged")
        hang.release()
        connection = request.result(patience())
    wait(lambda: connection.gaps)
    stage.next.emit(2)
    assert connection.get(patience()) == 2
    assert connection.plan.names == ("next", "finder")
    assert "it was unplugged" in connection.gaps[0].cause


def test_a_bridge_that_dies_while_a_plan_opens_is_replaced_before_the_reply(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = make()
    with requested(stage, monkeypatch) as (request, hang):
        stage.one.report(Health.LOST, "it was unplugged")
        wait(lambda: stage.one.closed)  # then what it opens is refused
        hang.release()
        connection = request.result(patience())
    assert connection.plan.names == ("next", "finder")
    stage.next.emit(2)
    assert connection.get(patience()) == 2
    assert "bridge 'one' was lost: it was unplugged" in connection.gaps[0].cause
    wait(lambda: connection.gaps[0].counted)
    assert stage.one.open_channels == 0
    wait(stage.replaced)
    changes = [event.change for event in stage.events if event.subject == "connection c1"]
    assert changes == ["opening", "running", "replaced"]


def test_a_bridge_that_dies_while_a_plan_opens_is_why_the_request_fails_without_another(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It fails at once, whatever `wait` says: who asked can ask again."""
    stage = make(FailoverPolicy(wait=patience()))
    with requested(stage, monkeypatch) as (request, hang):
        monkeypatch.setattr(stage.two, "_open_source", busy)
        stage.one.report(Health.LOST, "it was unplugged")
        wait(lambda: stage.one.closed)  # then what it opens is refused
        hang.release()
        error = request.exception(patience())
    assert isinstance(error, BridgeError)
    assert "bridge 'one' was lost: it was unplugged; nothing takes over" in str(error)
    wait(lambda: (stage.one.open_channels, stage.two.open_channels) == (0, 0))


def test_what_dies_while_its_plan_opens_ends_the_request_with_failover_off(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = make(FailoverPolicy(enabled=False))
    with requested(stage, monkeypatch) as (request, hang):
        stage.one.die("best", "it was unplugged")
        hang.release()
        error = request.exception(patience())
    assert isinstance(error, BridgeError)
    assert "ended while it was being opened: component 'best' was lost" in str(error)
    wait(lambda: (stage.one.open_channels, stage.two.open_channels) == (0, 0))


def busy(endpoint: Endpoint, *_: Any) -> Channel:
    raise BridgeError(f"{endpoint.address[0]} is busy")


def test_what_cannot_be_opened_is_done_without_and_the_request_gets_the_next(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = make()
    monkeypatch.setattr(stage.one, "_open_source", busy)
    connection = stage.robot.request("face")
    assert connection.plan.names == ("next", "finder")
    stage.next.emit(2)
    assert connection.get(patience()) == 2
    (gap,) = connection.gaps
    assert (gap.before, gap.after) == (("best", "finder"), ("next", "finder"))
    assert "best is busy" in gap.cause
    wait(stage.replaced)
    changes = [event.change for event in stage.events if event.subject == "connection c1"]
    assert changes == ["opening", "running", "replaced"]
    # Asked anew each time: it may be free by now.
    monkeypatch.undo()
    connection.kill()
    assert stage.robot.request("face").plan.names == ("best", "finder")


def test_a_request_of_which_nothing_opens_fails_with_the_first_failure(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = make(FailoverPolicy(wait=patience()))
    for bridge in (stage.one, stage.two):
        monkeypatch.setattr(bridge, "_open_source", busy)
    with pytest.raises(BridgeError, match="best is busy"):
        stage.robot.request("camera")
    wait(lambda: (stage.one.open_channels, stage.two.open_channels) == (0, 0))
    wait(lambda: any(event.change == "failed" for event in stage.events))
    (cause,) = [event.cause for event in stage.events if event.change == "failed"]
    assert "best is busy; nothing takes over" in cause


def test_what_cannot_be_opened_fails_the_request_with_failover_off(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = make(FailoverPolicy(enabled=False))
    monkeypatch.setattr(stage.one, "_open_source", busy)
    with pytest.raises(BridgeError, match="best is busy"):
        stage.robot.request("camera")
    wait(lambda: (stage.one.open_channels, stage.two.open_channels) == (0, 0))


def test_a_component_in_the_middle_stays_open_when_its_feed_is_replaced(make: Make) -> None:
    stage = make()
    connection = stage.robot.request("face")
    stage.best.emit(1)
    assert connection.get(patience()) == 1
    stage.one.die("best")
    wait(lambda: connection.gaps)
    stage.next.emit(2)
    assert connection.get(patience()) == 2
    assert connection.gaps[0].after == ("next", "finder")
    wait(stage.replaced)
    (report,) = [event for event in stage.events if event.change == "replaced"]
    assert report.cause.endswith("; next goes on")


def test_why_nothing_takes_over_is_a_warning_once(
    make: Make, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    stage, opened = make(FailoverPolicy(wait=patience())), list[str]()

    def fail(endpoint: Endpoint, *_: Any) -> Channel:
        opened.append(endpoint.address[0])
        raise BridgeError(f"{endpoint.address[0]} is busy")

    connection = stage.robot.request("camera")
    monkeypatch.setattr(stage.two, "_open_source", fail)
    stage.one.die("best")
    wait(lambda: opened.count("last") > 4)
    wait(lambda: "next is busy" in caplog.text and "last is busy" in caplog.text)
    connection.kill()
    assert caplog.text.count("next is busy") == caplog.text.count("last is busy") == 1


def test_a_handler_of_the_log_may_end_what_it_is_warned_of(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = make(FailoverPolicy(wait=patience()))

    def fail(endpoint: Endpoint, *_: Any) -> Channel:
        raise BridgeError(f"{endpoint.address[0]} is busy")

    class Ending(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            if "is busy" in record.getMessage():
                connection.kill()

    connection, handler = stage.robot.request("camera"), Ending()
    monkeypatch.setattr(stage.two, "_open_source", fail)
    monkeypatch.setattr(logging.getLogger("uoarm"), "handlers", [handler])
    stage.one.die("best")
    wait(lambda: connection.ended)


def test_two_connections_that_share_what_died_share_what_goes_on(make: Make) -> None:
    stage = make()
    one, two = stage.robot.request("face"), stage.robot.request("camera")
    stage.one.die("best")
    wait(lambda: one.gaps and two.gaps)
    stage.next.emit(5)
    assert (one.get(patience()), two.get(patience())) == (5, 5)
    (shared,) = [live for live in stage.robot.status().components if live.name == "next"]
    assert sorted(shared.users) == ["c1", "c2"]


def test_a_takeover_that_comes_too_late_takes_over_nothing(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    limits = threading.local()
    opens, run = driver.Driver._open, deadlines.run

    def open_batch(made: driver.Driver, action: act.Open, state: State) -> ev.Event:
        limits.seconds = 0.2 if "next" in action.placement.plan.names else patience()
        return opens(made, action, state)

    def run_limited(step: str, _: float, action: Callable[[], object], **how: Any) -> object:
        return run(step, getattr(limits, "seconds", patience()), action, **how)

    monkeypatch.setattr(driver.Driver, "_open", open_batch)
    monkeypatch.setattr(driver, "deadlines", SimpleNamespace(run=run_limited, left=deadlines.left))
    stage = make()
    one, two = stage.robot.request("camera"), stage.robot.request("face")
    opened = stage.two._open_source

    def hang_at_next(endpoint: Endpoint, *given: Any) -> Channel:
        if endpoint.component == "next":
            hang.wait()
        return opened(endpoint, *given)

    hang = Hang()
    monkeypatch.setattr(stage.two, "_open_source", hang_at_next)
    stage.one.die("best")
    wait(lambda: one.gaps and two.gaps)
    hang.release()
    wait(
        lambda: (
            {component.name for component in stage.robot.status().components} == {"last", "finder"}
        )
    )
    wait(lambda: stage.two.open_channels == 3)
    stage.last.emit(3)
    for connection in (one, two):
        assert connection.get(patience()) == 3
        assert [gap.after[0] for gap in connection.gaps] == ["last"]


def test_a_takeover_that_comes_too_late_still_lets_go_of_what_died(
    make: Make, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(driver, "_OPEN_SECONDS", 0.2)
    stage = make()
    connection = stage.robot.request("face")
    opened, hang = stage.two._open_source, Hang()

    def hang_at_each(endpoint: Endpoint, *given: Any) -> Channel:
        hang.wait()
        return opened(endpoint, *given)

    monkeypatch.setattr(stage.two, "_open_source", hang_at_each)
    stage.one.die("best")
    wait(lambda: "given up" in caplog.text)
    connection.kill()
    hang.release()
    wait(lambda: stage.robot.status().components == ())
    wait(lambda: (stage.one.open_channels, stage.two.open_channels) == (0, 0))


def test_one_death_after_the_other_goes_down_the_candidates_and_then_ends(make: Make) -> None:
    stage = make()
    connection = stage.robot.request("camera")
    stage.one.die("best")
    wait(lambda: len(connection.gaps) == 1)
    stage.two.die("next")
    wait(lambda: len(connection.gaps) == 2)
    stage.last.emit(7)
    assert connection.get(patience()) == 7
    stage.two.die("last", "the last one fell")
    with pytest.raises(ConnectionClosedError, match=r"the last one fell(.|\n)*nothing takes over"):
        connection.get(patience())
    assert connection.state is ConnectionState.FAILED


def test_a_candidate_whose_messages_are_others_is_passed_over(make: Make) -> None:
    stage = make(next=WIDER)
    connection = stage.robot.request("camera")
    stage.one.die("best")
    wait(lambda: connection.gaps)
    assert connection.gaps[0].after == ("last",)


def test_when_no_candidate_fits_the_difference_is_reported(make: Make) -> None:
    stage = make(next=TEXT)
    connection = stage.robot.request("camera")
    stage.two.die("last")
    stage.one.die("best")
    with pytest.raises(
        ConnectionClosedError, match="'next' is no replacement: its output 'default' is"
    ):
        connection.get(patience())


def test_with_failover_off_a_death_ends_the_connection(make: Make) -> None:
    stage = make(FailoverPolicy(enabled=False))
    connection = stage.robot.request("camera")
    stage.one.die("best", "it was unplugged")
    with pytest.raises(ConnectionClosedError, match="it was unplugged"):
        connection.get(patience())
    assert connection.gaps == ()


def test_too_many_changes_within_a_minute_end_the_connection(make: Make) -> None:
    stage = make(FailoverPolicy(limit=1))
    connection = stage.robot.request("camera")
    stage.one.die("best")
    wait(lambda: connection.gaps)
    stage.two.die("next")
    with pytest.raises(ConnectionClosedError, match="changed 1 times within a minute"):
        connection.get(patience())


def _revive(bridge: MemoryBridge, name: str) -> Emitter:
    return bridge.emitter(name, NUMBER)


def test_it_waits_for_the_dead_to_come_back_where_it_is_configured_to(make: Make) -> None:
    stage = make(FailoverPolicy(wait=20.0))
    for name in ("next", "last"):
        stage.two.die(name)
    connection = stage.robot.request("camera")
    stage.one.die("best")
    revived = _revive(stage.one, "best")
    wait(lambda: connection.gaps)
    revived.emit(3)
    assert connection.get(patience()) == 3
    assert connection.gaps[0].after == ("best",)


def test_while_it_waits_it_says_so_and_for_what(make: Make) -> None:
    stage = make(FailoverPolicy(wait=60.0))
    connection = stage.robot.request("face")
    for name in ("next", "last"):
        stage.two.die(name)
    stage.one.die("best", "it was unplugged")
    wait(lambda: connection.state is ConnectionState.WAITING)
    assert "it was unplugged" in connection.cause
    (status,) = stage.robot.status().connections
    assert (status.state, status.components) == (ConnectionState.WAITING, ("finder",))
    assert status.cause == connection.cause
    assert not connection.ended
    revived = _revive(stage.one, "best")
    wait(stage.replaced)
    assert (connection.state, connection.cause) == (ConnectionState.RUNNING, "")
    revived.emit(3)
    assert connection.get(patience()) == 3
    reports = [event for event in stage.events if event.subject == "connection c1"]
    changes = ["opening", "running", "waiting", "running", "replaced"]
    assert [event.change for event in reports] == changes
    assert "it was unplugged" in reports[2].cause


def test_a_connection_that_waits_can_be_killed(make: Make) -> None:
    stage = make(FailoverPolicy(wait=60.0))
    connection = stage.robot.request("camera")
    for name in ("next", "last"):
        stage.two.die(name)
    stage.one.die("best")
    wait(lambda: connection.state is ConnectionState.WAITING)
    connection.kill()
    assert (connection.state, connection.cause) == (ConnectionState.CLOSED, "")
    assert stage.robot.status().connections == ()


def test_when_another_component_dies_while_it_waits_it_needs_both(make: Make) -> None:
    stage = make(FailoverPolicy(wait=60.0))
    connection = stage.robot.request("face")
    for name in ("next", "last"):
        stage.two.die(name)
    stage.one.die("best")
    wait(lambda: connection.state is ConnectionState.WAITING)
    stage.two.die("finder")
    wait(lambda: stage.robot.status().components == ())
    revived = _revive(stage.one, "best")
    assert connection.state is ConnectionState.WAITING
    stage.two.loop("finder", NUMBER)
    wait(stage.replaced)
    revived.emit(3)
    assert connection.get(patience()) == 3
    assert len(connection.gaps) == 1


def test_what_died_lately_is_the_last_to_be_chosen_again(make: Make) -> None:
    stage = make()
    connection = stage.robot.request("camera")
    stage.one.die("best")
    wait(lambda: len(connection.gaps) == 1)
    _revive(stage.one, "best")
    stage.two.die("next")
    wait(lambda: len(connection.gaps) == 2)
    _revive(stage.two, "next")
    stage.two.die("last")
    wait(lambda: len(connection.gaps) == 3)  # nothing else is left, and best failed before next
    assert [gap.after for gap in connection.gaps] == [("next",), ("last",), ("best",)]


def test_it_returns_to_the_better_candidate_and_receives_no_message_twice(make: Make) -> None:
    stage = make(FailoverPolicy(return_after=0.2))
    connection = stage.robot.request("camera")
    stage.one.die("best")
    wait(lambda: connection.gaps)
    died = time.monotonic()
    revived = _revive(stage.one, "best")
    wait(lambda: len(connection.gaps) == 2)
    assert time.monotonic() - died >= 0.2
    assert connection.gaps[1].after == ("best",)
    assert "available again" in connection.gaps[1].cause
    revived.emit(4)
    stage.next.emit(5)
    assert connection.get(patience()) == 4
    with pytest.raises(TimeoutError):
        connection.get(0.1)


def test_without_a_return_it_stays_where_it_is(make: Make) -> None:
    stage = make()
    connection = stage.robot.request("camera")
    stage.one.die("best")
    wait(lambda: connection.gaps)
    _revive(stage.one, "best")
    stage.next.emit(1)
    assert connection.get(patience()) == 1
    assert len(connection.gaps) == 1


def test_a_bridge_that_dies_takes_all_its_components_out_of_the_choice(make: Make) -> None:
    stage = make()
    connection = stage.robot.request("camera")
    stage.one.die("best")
    wait(lambda: connection.gaps)
    stage.two.report(Health.LOST, "its process ended")
    with pytest.raises(ConnectionClosedError, match="its process ended"):
        connection.get(patience())


def test_a_kill_while_it_is_replaced_closes_everything(make: Make) -> None:
    stage = make()
    connection = stage.robot.request("camera")
    stage.one.die("best")
    connection.kill()
    wait(lambda: stage.one.open_channels == stage.two.open_channels == 0)
    assert connection.state is ConnectionState.CLOSED


def test_what_appears_after_the_first_request_serves_the_next() -> None:
    clock = ManualClock()
    one, two = MemoryBridge("one", {}), MemoryBridge("two", {})
    two.emitter("next", NUMBER)
    with RobotManager(loads(ROBOT), bridges={"one": one, "two": two}, clock=clock) as robot:
        first = robot.request("camera")
        assert first.plan.provider.component.name == "next"
        one.emitter("best", NUMBER)  # and no bridge says so
        clock.advance(60)
        second = robot.request("camera")
        assert second.plan.provider.component.name == "best"
        assert first.plan.provider.component.name == "next"


def test_what_takes_over_shares_an_input_that_is_in_use_rather_than_feed_it_anew() -> None:
    text = """
version: 1
bridges: {one: {plugin: memory}, two: {plugin: memory}}
functions:
  camera:
    components:
      - {name: best, bridge: one, priority: 2, output: {endpoint: [best]}}
      - {name: spare, bridge: two, priority: 1, output: {endpoint: [spare]}}
  face:
    components:
      - {name: quick, bridge: one, priority: 2, output: {endpoint: [quick]}}
      - name: finder
        bridge: two
        priority: 1
        input: {from: camera, endpoint: [finder]}
        output: {endpoint: [finder]}
  name:
    components:
      - name: namer
        bridge: two
        input: {from: face, endpoint: [namer]}
        output: {endpoint: [namer]}
"""
    one, two = MemoryBridge("one", {}), MemoryBridge("two", {})
    spare = two.emitter("spare", NUMBER)
    two.loop("finder", NUMBER)
    two.loop("namer", NUMBER)
    with RobotManager(loads(text), bridges={"one": one, "two": two}) as robot:
        first = robot.request("name")
        assert [step.component.name for step in first.plan.steps] == ["spare", "finder", "namer"]
        one.emitter("best", NUMBER)
        one.emitter("quick", NUMBER)
        robot.check_availability()
        second = robot.request("face")
        one.die("quick")
        wait(lambda: second.gaps or second.ended)
        assert [step.component.name for step in second.plan.steps] == ["spare", "finder"]
        spare.emit(7)
        assert second.get(patience()) == first.get(patience()) == 7


def test_who_sees_a_gap_sees_the_plan_behind_it(
    make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage, seen = make(FailoverPolicy(wait=patience())), list[tuple[str, ConnectionState]]()
    connection = stage.robot.request("camera")
    for name in ("next", "last"):
        stage.two.die(name)
    stage.one.die("best")
    wait(lambda: connection.state is ConnectionState.WAITING)
    add = LossAccount.add

    def noting(account: LossAccount, gap: Gap) -> None:
        add(account, gap)
        seen.append((connection.plan.provider.component.name, connection.state))

    monkeypatch.setattr(LossAccount, "add", noting)
    stage.last = _revive(stage.two, "last")
    wait(lambda: seen)
    assert seen == [("last", ConnectionState.RUNNING)]
