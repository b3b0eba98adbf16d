"""Inputs that move something, behind the contract: the stop goes out whatever hangs or raises."""

from __future__ import annotations

import atexit
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest
from tests.processes import run_python

from uoarm.bridge import HealthEvent, Sink, _watchdog
from uoarm.bridge._watchdog import ExitStops, Watchdog
from uoarm.errors import BridgeTimeoutError, CommandRefusedError
from uoarm.model import (
    CommandPhase,
    CommandPolicy,
    Endpoint,
    Health,
    Message,
    MessageStructure,
    Role,
    StopMessage,
)
from uoarm.testing import Background, MemoryBridge, patience, wait

ANY = MessageStructure({})
STOP, GO = {"v": 0.0}, {"v": 0.5}
LIFETIME = 0.1
POLICY = CommandPolicy(LIFETIME, StopMessage(STOP))
ENDPOINT = Endpoint("b", "base", Role.INPUT, ("x",), command=POLICY)


class Base(MemoryBridge):
    """Takes messages, hangs in the sending of a command, or refuses the stop, as the test says."""

    def __init__(self, *, parallel: bool = False) -> None:
        super().__init__("b")
        self.taken: list[Message] = []
        self.parallel = parallel
        self.hang: threading.Event | None = None
        self.hangs_in = GO
        self.refuses = False
        self.in_send = threading.Event()
        self.was_closed_after: list[Message] = []
        self.drained: list[list[Message]] = []
        self.made: Sink | None = None

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        if self.made is not None:
            return self.made

        def send(message: Message) -> None:
            if message == self.hangs_in and self.hang is not None:
                self.in_send.set()
                assert self.hang.wait(patience())
            if message == STOP and self.refuses:
                raise OSError("the motor does not answer")
            self.taken.append(message)

        class Buffered(Sink):
            """Notes what it was given by the time it is waited for."""

            def drain(_, timeout: float) -> bool:  # noqa: N805 - the bridge is `self` here
                self.drained.append(list(self.taken))
                return True

        sink = Buffered(endpoint, send, lambda: self.was_closed_after.extend(self.taken))
        sink.parallel = self.parallel
        return sink


@pytest.fixture
def base() -> Iterator[Base]:
    base = Base()
    yield base
    base.close()


def phase(sink: Sink) -> CommandPhase:
    status = sink.command_status()
    assert status is not None
    return status.phase


def stopped(sink: Sink) -> bool:
    return phase(sink) is CommandPhase.STOPPED


def test_a_command_that_is_not_renewed_is_followed_by_one_stop(base: Base) -> None:
    sink = base.open_sink(ENDPOINT, ANY)
    assert phase(sink) is CommandPhase.IDLE
    sink.send(GO)
    wait(lambda: stopped(sink))
    assert base.taken == [GO, STOP]
    sink.send(GO)
    wait(lambda: stopped(sink))
    assert base.taken == [GO, STOP, GO, STOP]


def test_an_input_that_moves_nothing_has_no_watchdog(base: Base) -> None:
    sink = base.open_sink(Endpoint("b", "base", Role.INPUT, ("x",)), ANY)
    sink.send(GO)
    assert sink.command_status() is None
    assert sink.hold(1.0) is None


def test_what_is_too_old_is_refused_with_both_figures(base: Base) -> None:
    sink = base.open_sink(ENDPOINT, ANY)
    with pytest.raises(CommandRefusedError, match=r"0\.300 s old.*lifetime of 0\.1 s") as caught:
        sink.send(GO, age=0.3)
    assert caught.value.reason == "late"
    assert base.taken == []


def test_a_stop_that_is_not_taken_is_reported_and_sent_until_it_is(base: Base) -> None:
    events: list[HealthEvent] = []
    base.watch(events.append)
    base.refuses = True
    sink = base.open_sink(ENDPOINT, ANY)
    sink.send(GO)
    wait(lambda: bool(events))
    assert events[0].health is Health.DEGRADED
    assert "the motor does not answer" in events[0].cause
    assert phase(sink) is CommandPhase.STOPPING
    with pytest.raises(CommandRefusedError) as caught:
        sink.send(GO)
    assert caught.value.reason == "stopping"
    base.refuses = False
    wait(lambda: stopped(sink) and len(events) == 2)
    assert events[1].health is Health.OK
    assert base.taken == [GO, STOP]


def test_where_sends_may_overlap_the_stop_waits_for_none_that_hangs_and_comes_last() -> None:
    base = Base(parallel=True)
    sink = base.open_sink(ENDPOINT, ANY)
    base.hang = threading.Event()
    sending = Background(lambda: sink.send(GO))
    wait(lambda: base.taken == [STOP])
    assert phase(sink) is CommandPhase.STOPPING, "the command may arrive behind the stop"
    base.hang.set()
    sending.result()
    wait(lambda: stopped(sink))
    assert base.taken == [STOP, GO, STOP]
    base.close()


def test_where_sends_may_not_overlap_the_stop_follows_the_one_that_hung(base: Base) -> None:
    sink = base.open_sink(ENDPOINT, ANY)
    base.hang = threading.Event()
    sending = Background(lambda: sink.send(GO))
    wait(lambda: phase(sink) is CommandPhase.STOPPING)
    report = sink.hold(0.01)
    assert report is not None
    assert report.phase is CommandPhase.STOPPING, "it says that it has not stopped"
    base.hang.set()
    sending.result()
    wait(lambda: stopped(sink))
    assert base.taken == [GO, STOP]


def test_what_is_held_takes_no_command_until_it_is_released(base: Base) -> None:
    sink = base.open_sink(ENDPOINT, ANY)
    report = sink.hold(patience())
    assert report is not None
    assert (report.phase, report.held) == (CommandPhase.STOPPED, True)
    with pytest.raises(CommandRefusedError, match="emergency stop") as caught:
        sink.send(GO)
    assert caught.value.reason == "held"
    sink.release()
    sink.send(GO)
    assert base.taken[:2] == [STOP, GO]


def test_what_moves_is_stopped_before_it_is_closed(base: Base) -> None:
    sink = base.open_sink(ENDPOINT, ANY)
    sink.send(GO)
    sink.close()
    assert base.was_closed_after == [GO, STOP]


@pytest.mark.parametrize("first", ["its input", "the bridge"])
def test_a_close_of_a_bridge_waits_for_the_stop_of_what_another_thread_closes(
    base: Base, monkeypatch: pytest.MonkeyPatch, first: str
) -> None:
    monkeypatch.setattr(_watchdog, "_LAST_SECONDS", patience())
    sink = base.open_sink(ENDPOINT, ANY)
    sink.send(GO)
    base.hang, base.hangs_in = threading.Event(), STOP
    end = sink.close if first == "its input" else base.close
    closing = Background(lambda: end(timeout=patience()))
    assert base.in_send.wait(patience())

    taken: list[list[Message]] = []

    def close() -> None:
        base.close(timeout=patience())
        taken.append(list(base.taken))

    waiting = Background(close)
    wait(lambda: taken or vars(base)["_channels_changed"]._waiters)
    base.hang.set()
    waiting.result()
    assert taken == [[GO, STOP]]
    closing.result()


def test_a_close_of_a_bridge_does_not_wait_for_what_was_given_up(base: Base) -> None:
    hang = threading.Event()
    sink = Sink(ENDPOINT, lambda _: None, lambda: hang.wait(patience()))
    base.made = sink
    with pytest.raises(BridgeTimeoutError):
        base.open_sink(ENDPOINT, ANY).close(timeout=0.05)
    Background(lambda: base.close(timeout=10 * patience())).result()
    assert sink.is_in_use
    hang.set()
    wait(lambda: not sink.is_in_use)


def test_a_close_waits_for_a_thread_that_a_busy_machine_holds_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    has_time, taken, look = threading.Event(), list[Message](), Watchdog._wait_until_due

    def look_late(watchdog: Watchdog) -> bool:
        assert has_time.wait(patience())
        return look(watchdog)

    monkeypatch.setattr(Watchdog, "_wait_until_due", look_late)
    watchdog = Watchdog(CommandPolicy(None, StopMessage(STOP)), taken.append, "base")
    wait_for = watchdog._changed.wait_for

    def wait_for_long(ready: Callable[[], bool], timeout: float | None = None) -> bool:
        if timeout == _watchdog._LAST_SECONDS and not has_time.is_set():
            return ready()  # this time is over before the thread has begun
        has_time.set()
        return wait_for(ready, patience())

    monkeypatch.setattr(watchdog._changed, "wait_for", wait_for_long)
    watchdog.send(GO, 0.0)
    assert watchdog.close()
    assert taken == [GO, STOP]


@pytest.mark.parametrize("how", ["close", "hold", "halt"])
def test_a_stop_has_arrived_before_its_input_is_closed(base: Base, how: str) -> None:
    """Also one that was taken before the close began: it may be in a buffer of the framework."""
    sink = base.open_sink(ENDPOINT, ANY)
    sink.send(GO)
    if how != "close":
        outcome = getattr(sink, how)(patience())
        assert outcome.phase is CommandPhase.STOPPED
    sink.close()
    assert base.drained == [[GO, STOP]]


def test_an_input_that_was_sent_nothing_is_closed_at_once(base: Base) -> None:
    base.open_sink(ENDPOINT, ANY).close()
    assert base.drained == []


def test_a_machine_that_was_suspended_lets_no_command_through_before_its_stop() -> None:
    taken: list[Message] = []
    now, resumed, sender = [100.0], threading.Event(), threading.current_thread()

    def clock() -> float:
        """Notify the watchdog's own thread of the suspension last: else its stop may be first."""
        return now[0] if resumed.is_set() or threading.current_thread() is sender else 100.0

    watchdog = Watchdog(POLICY, taken.append, "base", clock=clock)
    watchdog.send(GO, age=0.0)
    now[0] += 3600.0
    with pytest.raises(CommandRefusedError) as caught:
        watchdog.send(GO, age=0.0)
    assert caught.value.reason == "stopping"
    resumed.set()
    wait(lambda: taken == [GO, STOP])
    wait(lambda: watchdog.status().phase is CommandPhase.STOPPED)  # once its send has returned
    watchdog.send(GO, age=0.0)
    assert taken == [GO, STOP, GO]
    watchdog.close()


@pytest.mark.skipif(not hasattr(time, "CLOCK_BOOTTIME"), reason="Linux has it")
def test_commands_expire_by_a_clock_that_is_not_set_and_that_goes_on_in_a_suspension(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[int] = []
    read = time.clock_gettime

    def noted(which: int) -> float:
        asked.append(which)
        return read(which)

    monkeypatch.setattr(time, "clock_gettime", noted)
    monkeypatch.setattr(time, "time", lambda: pytest.fail("the calendar does not matter"))
    taken: list[Message] = []
    watchdog = Watchdog(POLICY, taken.append, "base")
    watchdog.send(GO, age=0.0)
    wait(lambda: taken == [GO, STOP])
    watchdog.close()
    assert set(asked) == {time.CLOCK_BOOTTIME}


PROGRAM = """
from uoarm import RobotManager
from uoarm.config import loads

robot = RobotManager(loads('''
version: 1
bridges: {python: {options: {path: ["."]}}}
functions:
  drive:
    components:
      - name: base
        bridge: python
        input: {endpoint: ["parts:base"], lifetime: 3600, stop: {message: 0}}
'''))
connection = robot.request("drive")
connection.send(5)
connection.flush(FLUSH)
"""


@pytest.mark.parametrize("end", ["", "raise SystemExit", "1 / 0", "robot.close()"])
def test_what_moves_is_stopped_once_as_its_program_ends(tmp_path: Path, end: str) -> None:
    (tmp_path / "parts.py").write_text(
        "def base(speed: int) -> None:\n    print(speed, flush=True)\n", encoding="utf-8"
    )
    program = PROGRAM.replace("FLUSH", str(patience())) + end
    done = run_python("-c", program, cwd=tmp_path)
    assert (done.stdout, done.returncode) == ("5\n0\n", end == "1 / 0"), done.stderr


def test_inputs_that_are_opened_again_and_again_have_one_place_at_the_end(base: Base) -> None:
    """The interpreter keeps the places of what it lets go of, and looks at all of them."""
    places = []
    for _ in range(5):
        sink = base.open_sink(ENDPOINT, ANY)
        sink.send(GO)
        sink.close()
        places.append(atexit._ncallbacks())
    assert base.taken == 5 * [GO, STOP]
    assert len(set(places)) == 1, places


def test_as_a_program_ends_no_stop_waits_for_another() -> None:
    stops, calls = ExitStops(), list[str]()
    for name in ("a", "b"):
        stops.add(partial(calls.append, f"begin {name}"), partial(calls.append, f"end {name}"))
    stops.add(lambda: 1 / 0, lambda: 1 / 0)
    other = ExitStops()  # of another bridge
    other.add(partial(calls.append, "begin c"), partial(calls.append, "end c"))
    stops._stop_all()
    assert sorted(calls[:3]) == ["begin a", "begin b", "begin c"]
    assert calls[3:] == ["end a", "end b"]
    stops.close()
    other.close()
