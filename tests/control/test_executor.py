"""Whatever goes wrong in a call or in a step of ours, who waits gets an answer."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator
from typing import Any

import pytest
from tests.control.world import FACE

from uoarm import RobotManager
from uoarm._control.engine.move import forget_earlier
from uoarm._control.engine.state import listed
from uoarm._control.live import listeners, parts
from uoarm._control.live.listeners import EventDispatcher
from uoarm._control.live.revisions import Revision
from uoarm._support.ordered import OrderedMap, keep_newest
from uoarm._support.workers import Job
from uoarm.config import loads
from uoarm.model import ConnectionState, Health, Robot, StatusEvent
from uoarm.testing import Background, ManualClock, MemoryBridge, patience, wait

NUMBER = {"type": "integer"}


class Stage:
    def __init__(self) -> None:
        self.one, self.two = MemoryBridge("one", {}), MemoryBridge("two", {})
        self.one.emitter("best", NUMBER)
        self.two.emitter("spare", NUMBER)
        self.two.loop("finder", NUMBER)
        self.robot = RobotManager(loads(FACE), bridges={"one": self.one, "two": self.two})


@pytest.fixture
def stage() -> Iterator[Stage]:
    made = Stage()
    yield made
    made.robot.close()


def test_who_listens_to_nothing_pays_for_no_thread_and_receives_what_comes_later() -> None:
    def threads() -> int:
        return sum(thread.name == "uoarm-events" for thread in threading.enumerate())

    before = threads()
    stage = Stage()
    with stage.robot as robot:
        robot.request("camera").kill()
        assert threads() == before
        reports: list[StatusEvent] = []
        robot.listen(reports.append)
        assert threads() == before + 1
        robot.request("camera")
        wait(lambda: len(reports) == 2)
    assert [report.change for report in reports[:2]] == ["opening", "running"]
    assert reports[0].number > 2
    assert threads() == before


def broken(*_: object, **__: object) -> Any:
    raise ArithmeticError("a fault of ours")


def test_a_kill_ends_also_when_closing_fails(
    stage: Stage, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    connection = stage.robot.request("face")
    with monkeypatch.context() as patch:
        patch.setattr(parts.LiveParts, "close", broken)
        connection.kill()
    assert connection.state is ConnectionState.CLOSED
    assert "a fault of ours" in caplog.text


def test_a_kill_that_is_interrupted_has_an_end_all_the_same(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second Ctrl-C: else a close would wait for the end for ever."""

    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    connection = stage.robot.request("face")
    with monkeypatch.context() as patch:
        patch.setattr(parts.LiveParts, "close", interrupt)
        with pytest.raises(KeyboardInterrupt):
            connection.kill()
    assert connection.ended


def test_a_search_that_breaks_down_ends_the_connection(
    stage: Stage, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    connection = stage.robot.request("face")
    monkeypatch.setattr(Revision, "resolve", broken)
    stage.one.die("best", "it was unplugged")
    wait(lambda: connection.ended)
    assert "nothing takes over: a fault of ours" in connection.cause
    assert "a fault of ours" in caplog.text


def test_an_action_that_fails_keeps_none_of_the_others_from_being_done(
    stage: Stage, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.ERROR, "uoarm")
    connection = stage.robot.request("camera")
    monkeypatch.setattr(Revision, "forget", broken)
    stage.one.report(Health.DEGRADED, "it is hot")
    stage.one.die("best", "it was unplugged")
    wait(lambda: connection.gaps)
    assert "failed to do Forget" in caplog.text
    assert connection.state is ConnectionState.RUNNING


def test_an_event_is_handled_though_a_handler_of_the_log_raises(
    stage: Stage, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    class Broken(logging.Handler):
        def emit(self, _: logging.LogRecord) -> None:
            raise ArithmeticError("a fault of the application")

    monkeypatch.setattr(logging.getLogger("uoarm.control"), "handlers", [Broken()])
    caplog.set_level(logging.DEBUG, "uoarm.control")
    stage.robot.request("camera").kill()


def test_a_handler_of_the_log_may_wait_for_the_manager(
    stage: Stage, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    ended = threading.Event()

    class Waiting(logging.Handler):
        def emit(self, _: logging.LogRecord) -> None:
            if not ended.is_set():
                connection.kill()
                ended.set()

    connection = stage.robot.request("camera")
    monkeypatch.setattr(logging.getLogger("uoarm.control"), "handlers", [Waiting()])
    caplog.set_level(logging.DEBUG, "uoarm.control")
    stage.robot.request("camera").kill()
    assert ended.wait(patience())
    assert connection.ended


def test_what_comes_while_a_change_of_candidates_fails_is_handled(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    connection, driver = stage.robot.request("camera"), stage.robot._driver

    def fail(_: Robot) -> None:
        Background(lambda: stage.one.die("best")).result()
        raise ArithmeticError("a fault of ours")

    monkeypatch.setattr(driver, "_change_candidates", fail)
    with pytest.raises(ArithmeticError):
        driver.change_candidates(stage.robot.config)
    wait(lambda: connection.gaps)


def test_what_died_long_ago_is_forgotten_however_many_names_come_and_go() -> None:
    times = OrderedMap([("first", 0.0), ("second", 100.0), ("third", 400.0)])
    times = forget_earlier(times, 401.0)
    assert times == {"third": 400.0}
    assert forget_earlier(times, 1000.0) == {}


def test_of_many_that_die_together_a_few_are_named() -> None:
    assert listed(["a", "b"]) == "'a', 'b'"
    assert listed([f"c{number}" for number in range(1000)]).endswith("'c7' and 992 more")


def test_of_names_that_come_and_go_the_newest_are_kept() -> None:
    kept: dict[str, int] = {}
    for number in range(3000):
        keep_newest(kept, "stays", number)
        keep_newest(kept, f"c{number}", number)
    assert len(kept) == 1000
    assert kept["stays"] == kept["c2999"] == 2999
    assert "c1999" not in kept


def test_records_of_names_that_come_and_go_are_forgotten() -> None:
    dispatcher = EventDispatcher(ManualClock())
    for number in range(3000):
        dispatcher.post(f"component c{number}", "lost", "it was unplugged")
    dispatcher.close()
    wait(lambda: dispatcher._thread is not None and not dispatcher._thread.is_alive())
    assert len(dispatcher._records) == 1000


def test_what_has_not_reached_listeners_at_the_end_is_counted(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(listeners, "_CLOSE_SECONDS", 0.01)
    dispatcher, held, go_on = EventDispatcher(ManualClock()), threading.Event(), threading.Event()
    came: list[str] = []

    def hold_up(event: StatusEvent) -> None:
        came.append(event.change)
        held.set()
        go_on.wait(patience())

    dispatcher.listen(hold_up)
    for number in range(4):
        dispatcher.post("test", str(number))
    assert held.wait(patience())
    dispatcher.close()
    dispatcher.close()
    assert caplog.messages == ["a listener has held up 3 changes for 0.01 s at the end"]
    go_on.set()
    wait(lambda: len(came) == 4)
    wait(lambda: dispatcher._thread is not None and not dispatcher._thread.is_alive())
    dispatcher.close()
    assert len(caplog.messages) == 1


def test_what_finds_no_thread_is_done_when_there_is_one(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    connection = stage.robot.request("camera")
    driver, is_full = stage.robot._driver, True
    submit = driver._workers.submit

    def full(job: Job) -> bool:
        if is_full:
            raise RuntimeError("can't start new thread")
        return submit(job)

    monkeypatch.setattr(driver._workers, "submit", full)
    stage.one.die("best")
    wait(lambda: len(driver._unstarted) > 0)
    assert not connection.gaps
    is_full = False
    wait(lambda: connection.gaps)
    assert connection.state is ConnectionState.RUNNING
