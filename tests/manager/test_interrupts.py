"""Ctrl-C, SIGTERM amid a request, kill, offer, change or close: all is done, or nothing is left."""

from __future__ import annotations

import ctypes
import itertools
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from types import FrameType, SimpleNamespace
from typing import Any, NoReturn

import pytest
from tests.manager.stage import FACE
from tests.processes import frame_of, run_python

from uoarm import BridgeError, BridgeTimeoutError, RobotManager, _interrupts
from uoarm._interrupts import Uninterrupted, wait_step
from uoarm._support import deadlines
from uoarm.bridge import Discovered, HealthEvent, Source
from uoarm.config import loads
from uoarm.errors import FailureReason
from uoarm.model import Deliver, Endpoint, Health, MessageStructure, OfferState
from uoarm.testing import Hang, MemoryBridge, patience, wait

OFFERING = FACE + "offer: {two: {camera: {output: {endpoint: [seen]}}}}"


class Quick(MemoryBridge):
    """Opens in the thread of the caller; may do something first."""

    before: Callable[[], object] | None = None
    said = True

    def _is_quick(self, endpoint: Endpoint) -> bool:
        return self.said

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Deliver
    ) -> Source:
        if self.before is not None:
            self.before()
        return super()._open_source(endpoint, structure, deliver)


class Interrupt:
    """Sends this process a signal as the `at`-th of uoarm's functions is called here.

    Not as a block begins that puts it off: what comes before it has begun is raised before it. Nor
    as a generator goes on in Python 3.10: what this raises there skips its `finally`, which a
    signal that comes by itself does not.
    """

    def __init__(self, number: signal.Signals, at: int) -> None:
        self._number = number
        self._left = at
        self.has_come = False
        limit_begins()

    def __call__(self, frame: FrameType, event: str, argument: object) -> None:
        del argument
        if event != "call" or (sys.version_info < (3, 11) and frame.f_lasti >= 0):
            return
        module = frame.f_globals.get("__name__", "")
        if module.startswith("uoarm.") and module != Uninterrupted.__module__:
            self._left -= 1
            if not self._left:
                sys.setprofile(None)
                self.has_come = True
                signal.raise_signal(self._number)

    def during(self, action: Callable[[], object]) -> bool:
        """Do something; say whether what the signal stands for was raised."""
        sys.setprofile(self)
        try:
            action()
        except (KeyboardInterrupt, SystemExit):
            return True
        finally:
            sys.setprofile(None)
        return False


def end(number: int, _: object) -> NoReturn:
    """End as commands do at SIGTERM."""
    sys.exit(128 + number)


def give_up(number: int, _: object) -> NoReturn:
    del number
    raise TimeoutError("it hangs")


def limit_begins() -> None:
    """Have what hangs in the main thread from now on fail, and again what then cleans up."""
    signal.setitimer(signal.ITIMER_REAL, 2 * patience(), patience())


@pytest.fixture(autouse=True)
def limit() -> Iterator[None]:
    """Give what hangs in the main thread a limit: no other thread could end it there."""
    former = signal.signal(signal.SIGALRM, give_up)
    limit_begins()
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, former)


@pytest.fixture(params=[signal.SIGINT, signal.SIGTERM], ids=["ctrl-c", "sigterm"])
def number(request: pytest.FixtureRequest) -> Iterator[signal.Signals]:
    former = signal.signal(signal.SIGTERM, end)
    yield request.param
    signal.signal(signal.SIGTERM, former)


# What is raised is the only difference: requests, and the last close, are interrupted by both.
BY_SIGTERM = pytest.mark.parametrize("number", [signal.SIGTERM], indirect=True, ids=["sigterm"])


@pytest.fixture
def one() -> Quick:
    bridge = Quick("one")
    bridge.emitter("eye", {"type": "integer"})
    return bridge


@pytest.fixture
def robot(one: Quick) -> Iterator[RobotManager]:
    two = Quick("two")
    two.loop("finder", {"type": "integer"})
    with RobotManager(loads(FACE), bridges={"one": one, "two": two}) as robot:
        robot.request("face").kill()  # whose plan is known from now on
        yield robot


def is_nothing_left(robot: RobotManager) -> bool:
    driver = robot._driver
    state, live, status = driver.state, driver.live, robot.status()
    return not (
        state.connections
        or state.components
        or state.edges
        or state.parts
        or state.batches
        or state.draining
        or live.runtimes
        or live.components
        or live.edges
        or live.ports
        or driver._lanes._lanes
        or any(bridge.open_channels for bridge in status.bridges)
    )


def test_a_request_that_is_interrupted_anywhere_leaves_nothing(
    robot: RobotManager, number: signal.Signals
) -> None:
    at, has_come = 0, True
    while has_come:
        at += 1
        robot.resolve("face")  # what is not known is sought, and that is not quick
        interrupt = Interrupt(number, at)
        was_raised = interrupt.during(lambda: robot.request("face"))
        has_come = interrupt.has_come
        if not has_come:  # it was over before
            (connection,) = robot.connections()
            connection.kill()
        assert was_raised is has_come, at
        wait(lambda: is_nothing_left(robot), never=f"interrupted at call {at}")
    assert at > 300, "the whole of a request was interrupted"


@BY_SIGTERM
def test_a_request_that_fails_and_is_interrupted_anywhere_leaves_nothing(
    robot: RobotManager, one: Quick, number: signal.Signals
) -> None:
    def refuse() -> None:
        raise BridgeError("no such device", FailureReason.UNAVAILABLE)

    one.before, at, has_come = refuse, 0, True
    while has_come:
        at += 1
        robot.resolve("face")
        interrupt = Interrupt(number, at)
        try:
            interrupt.during(lambda: robot.request("face"))
        except BridgeError as error:
            assert "no such device" in str(error)
        has_come = interrupt.has_come
        wait(lambda: is_nothing_left(robot), never=f"interrupted at call {at}")
    assert at > 300, "the whole of a request was interrupted"


@BY_SIGTERM
def test_a_request_that_is_given_up_and_interrupted_anywhere_leaves_nothing(
    robot: RobotManager, one: Quick, number: signal.Signals
) -> None:
    one.said, at, has_come = False, 0, True
    while has_come:
        at += 1
        robot.resolve("face")
        interrupt, is_active = Interrupt(number, at), threading.Event()
        one.before = is_active.wait
        with suppress(BridgeTimeoutError):
            interrupt.during(lambda: robot.request("face", timeout=0.01))
        left = robot.connections()  # while it hangs still
        is_active.set()
        assert not left, at
        has_come = interrupt.has_come
        wait(lambda: is_nothing_left(robot), never=f"interrupted at call {at}")
    assert at > 100, "the whole of a request was interrupted"


@BY_SIGTERM
def test_a_death_reported_in_the_main_thread_and_interrupted_can_be_reported_again(
    robot: RobotManager, number: signal.Signals
) -> None:
    lost = HealthEvent("one", Health.LOST, "the cable is out", component="eye")
    at, has_come = 0, True
    while has_come:
        at += 1
        robot.request("face")
        interrupt = Interrupt(number, at)
        assert interrupt.during(lambda: robot._bridges._note_health(lost)) is interrupt.has_come, at
        has_come = interrupt.has_come
        robot._bridges._note_health(lost)
        wait(lambda: is_nothing_left(robot), never=f"interrupted at call {at}")
    assert at > 50, "the whole of a death was interrupted"


@BY_SIGTERM
def test_a_kill_that_is_interrupted_anywhere_can_be_done_again(
    robot: RobotManager, number: signal.Signals
) -> None:
    at, has_come = 0, True
    while has_come:
        at += 1
        connection, interrupt = robot.request("face"), Interrupt(number, at)
        was_raised = interrupt.during(connection.kill)
        connection.kill()
        has_come = interrupt.has_come
        assert was_raised is has_come, at
        wait(lambda: is_nothing_left(robot), never=f"interrupted at call {at}")
    assert at > 50, "the whole of a kill was interrupted"


@BY_SIGTERM
def test_an_offer_that_is_interrupted_anywhere_can_be_made_again(number: signal.Signals) -> None:
    at, has_come = 0, True
    while has_come:
        at += 1
        one, two = Quick("one"), Quick("two")
        one.emitter("eye", {"type": "integer"})
        two.taker("seen", {"type": "integer"})
        interrupt = Interrupt(number, at)
        with RobotManager(loads(OFFERING), bridges={"one": one, "two": two}) as robot:
            was_raised = interrupt.during(partial(robot.offer, timeout=patience()))
            (status,) = robot.offer(timeout=patience())
            assert status.state is OfferState.OPEN, at
        has_come = interrupt.has_come
        assert was_raised is has_come, at
        assert not one.open_channels + two.open_channels, at
    assert at > 30, "the whole of an offer was interrupted"


def test_a_close_that_is_interrupted_anywhere_closes_all(number: signal.Signals) -> None:
    at, has_come = 0, True
    while has_come:
        at += 1
        one, two = Quick("one"), Quick("two")
        one.emitter("eye", {"type": "integer"})
        two.loop("finder", {"type": "integer"})
        robot = RobotManager(loads(FACE), bridges={"one": one, "two": two})
        robot.request("face")
        interrupt = Interrupt(number, at)
        was_raised = interrupt.during(robot.close)
        has_come = interrupt.has_come
        assert was_raised is has_come, at
        if at == 1:  # it had not begun
            robot.close()
        assert (one.closed, two.closed) == (True, True), at
        wait(partial(is_nothing_left, robot), never=f"interrupted at call {at}")
    assert at > 50, "the whole of a close was interrupted"


@BY_SIGTERM
def test_a_change_that_is_interrupted_anywhere_can_be_made_again(
    robot: RobotManager, number: signal.Signals
) -> None:
    other = FACE.replace("from: camera,", "from: camera, queue: {length: 5},")
    at, has_come, robots = 0, True, itertools.cycle([loads(other), loads(FACE)])
    while has_come:
        at += 1
        connection, wanted, interrupt = robot.request("face"), next(robots), Interrupt(number, at)
        interrupt.during(partial(robot.apply, wanted, timeout=patience()))
        assert not robot._revisions._staged, at
        robot.apply(wanted, timeout=patience())
        assert robot.config.functions == wanted.functions, at
        connection.kill()
        has_come = interrupt.has_come
        wait(lambda: is_nothing_left(robot), never=f"interrupted at call {at}")
    assert at > 50, "the whole of a change was interrupted"


@pytest.mark.parametrize("second", [signal.SIGINT, signal.SIGTERM])
def test_what_hangs_in_the_thread_of_the_caller_is_left_by_a_second_signal(
    robot: RobotManager, one: Quick, number: signal.Signals, second: signal.Signals
) -> None:
    passed = []

    def hang() -> None:
        signal.raise_signal(number)
        passed.append("the first, which waits for the end of the request")
        signal.raise_signal(second)
        passed.append("the second")

    one.before = hang
    with pytest.raises(KeyboardInterrupt if second is signal.SIGINT else SystemExit):
        robot.request("face")
    assert len(passed) == 1
    wait(lambda: is_nothing_left(robot))
    one.before = None
    robot.request("face").kill()


@pytest.fixture
def called() -> Iterator[list[int]]:
    """Return the signals which an application's handlers received."""
    reports: list[int] = []

    def handle(number: int, frame: FrameType | None) -> None:
        reports.append(number)

    former = [
        (signals, signal.signal(signals, handle)) for signals in (signal.SIGINT, signal.SIGTERM)
    ]
    yield reports
    for number, handler in former:
        signal.signal(number, handler)


def test_the_handlers_of_an_application_are_called_at_the_end_and_stay(
    called: list[int], number: signal.Signals
) -> None:
    handler = signal.getsignal(signal.SIGINT)
    signal.signal(signal.SIGTERM, handler)
    with Uninterrupted():
        with Uninterrupted():
            signal.raise_signal(number)
        assert not called, "the outer block goes on"
    assert called == [number]
    assert signal.getsignal(signal.SIGINT) is signal.getsignal(signal.SIGTERM) is handler
    with Uninterrupted():
        signal.signal(number, signal.SIG_IGN)
    assert signal.getsignal(number) is signal.SIG_IGN, "set meanwhile, by other code"
    with Uninterrupted():
        assert signal.getsignal(number) is signal.SIG_IGN


def test_what_a_library_set_below_python_stays(called: list[int], number: signal.Signals) -> None:
    """As rclpy does; here a function of the system that does nothing takes its place."""
    signal.signal(number, signal.getsignal(signal.SIGINT))
    system = ctypes.CDLL(None)
    system.signal.restype = ctypes.c_void_p
    system.signal.argtypes = ctypes.c_int, ctypes.c_void_p
    nothing = ctypes.cast(system.abs, ctypes.c_void_p)
    of_python = system.signal(number, nothing)
    with Uninterrupted():
        assert system.signal(number, nothing) == nothing.value
        system.signal(number, of_python)  # as where a library takes its own away meanwhile
        signal.raise_signal(number)
        assert not called
    assert called == [number]
    assert system.signal(number, nothing) == of_python
    with Uninterrupted():
        pass
    assert system.signal(number, of_python) == nothing.value


@pytest.mark.parametrize("at", range(1, 5))
def test_one_that_comes_as_a_block_begins_or_ends_is_raised_and_so_are_all_later(
    number: signal.Signals, at: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Python raises amid it: where it sets the second handler, or has put only one back."""
    left = at

    def set_handler(one: int, handler: Any) -> Any:
        nonlocal left
        left -= 1
        if not left:
            signal.raise_signal(number)
        return signal.signal(one, handler)

    real = SimpleNamespace(getsignal=signal.getsignal, signal=set_handler)
    monkeypatch.setattr(_interrupts, "_signal", real)
    with pytest.raises((KeyboardInterrupt, SystemExit)), Uninterrupted():
        pass
    assert left <= 0
    for signals in (signal.SIGINT, signal.SIGTERM):
        with pytest.raises((KeyboardInterrupt, SystemExit)):
            signal.raise_signal(signals)
    passed = []

    def put_off() -> None:
        with Uninterrupted():
            signal.raise_signal(number)
            passed.append("all of it")

    with pytest.raises((KeyboardInterrupt, SystemExit)):
        put_off()
    assert passed


class Unseen:
    """Has a signal come to this process that ends no wait of the main thread.

    As one does that comes as a wait begins, after Python has looked: here another thread gets it.
    """

    def __init__(self, number: signal.Signals) -> None:
        self._number = number
        self._has_begun, self._is_over = threading.Event(), threading.Event()
        self._waiter = threading.get_ident()
        self.was_noticed = False

    def during(self, wait_there: Callable[[], object]) -> None:
        """Wait in the main thread, which the signal interrupts once it waits."""
        thread = threading.Thread(target=self._send)
        thread.start()  # which waits, too
        try:
            self._has_begun.set()
            wait_there()
        except (KeyboardInterrupt, SystemExit):
            pass
        finally:
            self._is_over.set()
            thread.join()

    def _send(self) -> None:
        wait(lambda: self._has_begun.is_set() and self._is_waiting())
        signal.pthread_kill(threading.get_ident(), self._number)
        self.was_noticed = self._is_over.wait(patience())
        if not self.was_noticed:
            signal.pthread_kill(self._waiter, self._number)

    def _is_waiting(self) -> bool:
        frame: FrameType | None = frame_of(self._waiter)
        while frame is not None and frame.f_code is not threading.Condition.wait.__code__:
            frame = frame.f_back
        return frame is not None


def test_a_signal_that_does_not_end_a_wait_is_noticed_all_the_same(
    robot: RobotManager, number: signal.Signals, tmp_path: Path
) -> None:
    connection = robot.request("face")
    with robot.record("face", path=tmp_path / "kept.mcap") as recording:
        for wait_there in (
            connection.get,
            partial(connection.get, 10 * patience()),
            recording.wait,
            partial(recording.wait, 10 * patience()),
        ):
            unseen = Unseen(number)
            unseen.during(wait_there)
            assert unseen.was_noticed, wait_there
        assert not recording.wait(0)
    assert recording.wait()


def test_a_wait_for_a_ring_is_left(
    robot: RobotManager, number: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hang = Hang()

    def write(*_: object) -> str:
        hang.wait()
        return ""

    with robot.record("face", path=tmp_path / "ring.mcap", ring=60.0) as recording:
        monkeypatch.setattr(recording, "_write_ring", write)
        unseen = Unseen(number)
        unseen.during(partial(recording.dump, timeout=10 * patience()))
        assert unseen.was_noticed
        hang.release()


class Blind(MemoryBridge):
    """Does not say what it sees."""

    def __init__(self, name: str, gate: threading.Event) -> None:
        super().__init__(name, {})
        self._gate = gate

    def _discover(self) -> tuple[Discovered, ...]:
        self._gate.wait(patience())
        return ()


NEEDING = """
version: 1
bridges: {one: {plugin: memory}}
functions: {eye: {needs: {structure: {type: integer}}}}
"""


def test_a_wait_for_what_bridges_see_is_left(number: signal.Signals) -> None:
    gate = threading.Event()
    given = {"one": Blind("one", gate)}
    with RobotManager(loads(NEEDING), bridges=given) as robot:
        for wait_there in (
            partial(robot.request, "eye", timeout=10 * patience()),
            partial(robot.discover, timeout=10 * patience()),
        ):
            unseen = Unseen(number)
            unseen.during(wait_there)
            assert unseen.was_noticed, wait_there
        gate.set()


def test_a_wait_for_offers_is_left(number: signal.Signals) -> None:
    gate = threading.Event()
    one, two = Quick("one"), Quick("two")
    one.emitter("eye", {"type": "integer"})
    two.taker("seen", {"type": "integer"})
    one.before = partial(gate.wait, patience())
    with RobotManager(loads(OFFERING), bridges={"one": one, "two": two}) as robot:
        unseen = Unseen(number)
        unseen.during(partial(robot.offer, timeout=10 * patience()))
        assert unseen.was_noticed
        gate.set()


def test_a_thread_waits_in_one_piece_and_the_main_thread_in_steps() -> None:
    assert wait_step(0.5) == 0.5
    assert wait_step() == wait_step(60) == 1
    found: SimpleQueue[float | None] = SimpleQueue()

    def ask() -> None:
        found.put(wait_step())
        found.put(wait_step(60))

    thread = threading.Thread(target=ask)
    thread.start()
    thread.join()
    assert (found.get(), found.get()) == (None, 60)


def test_other_threads_leave_the_handler_alone() -> None:
    seen = []

    def look() -> None:
        with Uninterrupted():
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    assert seen == [signal.getsignal(signal.SIGINT)]


def test_what_comes_of_a_step_whose_waiter_was_interrupted_is_put_away() -> None:
    is_active, late = threading.Event(), SimpleQueue[str]()

    def work() -> str:
        os.kill(os.getpid(), signal.SIGINT)
        is_active.wait()
        return "a bridge"

    with pytest.raises(KeyboardInterrupt):
        deadlines.run("starting it", patience(), work, on_late=late.put)
    assert late.empty()
    is_active.set()
    assert late.get(timeout=patience()) == "a bridge"


def test_how_a_step_fails_whose_waiter_was_interrupted_is_no_news(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.DEBUG, "uoarm")
    is_active = threading.Event()

    def work() -> None:
        signal.raise_signal(signal.SIGINT)
        is_active.wait()
        raise BridgeError("the manager is closed")

    with pytest.raises(KeyboardInterrupt):
        deadlines.run("starting it", patience(), work)
    is_active.set()
    wait(lambda: bool(caplog.records), "the record of its failure")
    (record,) = caplog.records
    assert (record.levelno, "is closed" in record.getMessage()) == (logging.DEBUG, True)


def test_what_comes_of_a_step_is_put_away_where_the_signal_comes_as_a_thread_has_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    is_active, late = threading.Event(), SimpleQueue[str]()
    submit = deadlines._workers.submit

    def submit_and_signal(*arguments: Any) -> bool:
        is_taken = submit(*arguments)
        signal.raise_signal(signal.SIGINT)
        return is_taken

    def work() -> str:
        is_active.wait()
        return "a bridge"

    monkeypatch.setattr(deadlines._workers, "submit", submit_and_signal)
    with pytest.raises(KeyboardInterrupt):
        deadlines.run("starting it", patience(), work, on_late=late.put)
    is_active.set()
    assert late.get(timeout=patience()) == "a bridge"


def test_a_step_that_a_signal_kept_from_its_thread_does_not_count_as_hanging(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_: Any) -> NoReturn:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(deadlines._workers, "submit", refuse)
    before = deadlines._hanging.steps.copy()
    with pytest.raises(RuntimeError, match="new thread"):
        deadlines.run("starting it", patience(), list)
    assert deadlines._hanging.steps == before


INTERRUPTED_AS_IT_COLLECTS = """
import ctypes, gc, signal, weakref
from operator import methodcaller
import uoarm._interrupts


class Reference(weakref.ref):
    send = staticmethod(ctypes.CDLL(None)["raise"])  # by Python it would be handled here


class Cycle:
    def __init__(self):
        self.itself = self


cycle = Cycle()
reference = Reference(cycle, methodcaller("send", int(signal.SIGINT)))
del cycle
try:
    gc.collect()
except KeyboardInterrupt:
    print("raised")
"""


def test_a_signal_while_the_garbage_collector_runs_is_raised() -> None:
    done = run_python("-c", INTERRUPTED_AS_IT_COLLECTS)
    assert (done.stdout, done.stderr) == ("raised\n", "")
