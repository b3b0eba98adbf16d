"""Ctrl-C in the midst of a request or a kill: all of it happened, or nothing is left of it."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from types import FrameType

import pytest

from uoarm import BridgeError, BridgeTimeoutError, RobotManager
from uoarm._interrupts import Uninterrupted
from uoarm.bridge import HealthEvent, Source
from uoarm.config import loads
from uoarm.errors import FailureReason
from uoarm.model import Deliver, Endpoint, Health, MessageStructure
from uoarm.testing import MemoryBridge, wait

ROBOT = """
version: 1
bridges: {one: {plugin: memory}, two: {plugin: memory}}
functions:
  camera: {components: [{name: eye, bridge: one, output: {endpoint: [eye]}}]}
  face:
    components:
      - {name: finder, bridge: two, input: {from: camera, endpoint: [finder]},
         output: {endpoint: [finder]}}
"""


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
    """Sends SIGINT to this process as the `at`-th of uoarm's functions is called here.

    Not as a block begins that puts it off: what comes before it has begun is raised before it.
    """

    def __init__(self, at: int) -> None:
        self._left = at
        self.has_come = False

    def __call__(self, frame: FrameType, event: str, argument: object) -> None:
        del argument
        module = frame.f_globals.get("__name__", "")
        if event == "call" and module.startswith("uoarm.") and module != Uninterrupted.__module__:
            self._left -= 1
            if not self._left:
                sys.setprofile(None)
                self.has_come = True
                signal.raise_signal(signal.SIGINT)

    def during(self, action: Callable[[], object]) -> bool:
        """Do something; say whether KeyboardInterrupt was raised."""
        sys.setprofile(self)
        try:
            action()
        except KeyboardInterrupt:
            return True
        finally:
            sys.setprofile(None)
        return False


@pytest.fixture
def one() -> Quick:
    bridge = Quick("one")
    bridge.emitter("eye", {"type": "integer"})
    return bridge


@pytest.fixture
def robot(one: Quick) -> Iterator[RobotManager]:
    two = Quick("two")
    two.loop("finder", {"type": "integer"})
    with RobotManager(loads(ROBOT), bridges={"one": one, "two": two}) as robot:
        robot.request("face").kill()  # whose plan is known from now on
        yield robot


def is_nothing_left(robot: RobotManager) -> bool:
    executor = robot._executor
    state, live, status = executor.state, executor.live, robot.status()
    return not (
        state.connections
        or state.components
        or state.edges
        or state.parts
        or state.batches
        or state.running_out
        or live.runtimes
        or live.components
        or live.edges
        or live.ports
        or executor._lanes._lanes
        or any(bridge.open_channels for bridge in status.bridges)
    )


def test_a_request_that_is_interrupted_anywhere_leaves_nothing(robot: RobotManager) -> None:
    at, has_come = 0, True
    while has_come:
        at += 1
        robot.resolve("face")  # what is not known is sought, and that is not quick
        interrupt = Interrupt(at)
        was_raised = interrupt.during(lambda: robot.request("face"))
        has_come = interrupt.has_come
        if not has_come:  # it was over before
            (connection,) = robot.connections()
            connection.kill()
        assert was_raised is has_come, at
        wait(lambda: is_nothing_left(robot), never=f"interrupted at call {at}")
    assert at > 300, "the whole of a request was interrupted"


def test_a_request_that_fails_and_is_interrupted_anywhere_leaves_nothing(
    robot: RobotManager, one: Quick
) -> None:
    def refuse() -> None:
        raise BridgeError("no such device", FailureReason.UNAVAILABLE)

    one.before, at, has_come = refuse, 0, True
    while has_come:
        at += 1
        robot.resolve("face")
        interrupt = Interrupt(at)
        try:
            interrupt.during(lambda: robot.request("face"))
        except BridgeError as error:
            assert "no such device" in str(error)
        has_come = interrupt.has_come
        wait(lambda: is_nothing_left(robot), never=f"interrupted at call {at}")
    assert at > 300, "the whole of a request was interrupted"


def test_a_request_that_is_given_up_and_interrupted_anywhere_leaves_nothing(
    robot: RobotManager, one: Quick
) -> None:
    one.said, at, has_come = False, 0, True
    while has_come:
        at += 1
        robot.resolve("face")
        interrupt, goes_on = Interrupt(at), threading.Event()
        one.before = goes_on.wait
        with suppress(BridgeTimeoutError):
            interrupt.during(lambda: robot.request("face", timeout=0.01))
        left = robot.connections()  # while it hangs still
        goes_on.set()
        assert not left, at
        has_come = interrupt.has_come
        wait(lambda: is_nothing_left(robot), never=f"interrupted at call {at}")
    assert at > 100, "the whole of a request was interrupted"


def test_a_death_that_is_told_in_the_main_thread_and_interrupted_can_be_told_again(
    robot: RobotManager,
) -> None:
    lost = HealthEvent("one", Health.LOST, "the cable is out", component="eye")
    at, has_come = 0, True
    while has_come:
        at += 1
        robot.request("face")
        interrupt = Interrupt(at)
        assert interrupt.during(lambda: robot._executor.report(lost)) is interrupt.has_come, at
        has_come = interrupt.has_come
        robot._executor.report(lost)
        wait(lambda: is_nothing_left(robot), never=f"interrupted at call {at}")
    assert at > 50, "the whole of a death was interrupted"


def test_a_kill_that_is_interrupted_anywhere_can_be_done_again(robot: RobotManager) -> None:
    at, has_come = 0, True
    while has_come:
        at += 1
        connection, interrupt = robot.request("face"), Interrupt(at)
        was_raised = interrupt.during(connection.kill)
        connection.kill()
        has_come = interrupt.has_come
        assert was_raised is has_come, at
        wait(lambda: is_nothing_left(robot), never=f"interrupted at call {at}")
    assert at > 50, "the whole of a kill was interrupted"


def test_what_hangs_in_the_thread_of_the_caller_is_left_by_a_second_interrupt(
    robot: RobotManager, one: Quick
) -> None:
    passed = []

    def hang() -> None:
        signal.raise_signal(signal.SIGINT)
        passed.append("the first, which waits for the end of the request")
        signal.raise_signal(signal.SIGINT)
        passed.append("the second")

    one.before = hang
    with pytest.raises(KeyboardInterrupt):
        robot.request("face")
    assert len(passed) == 1
    wait(lambda: is_nothing_left(robot))
    one.before = None
    robot.request("face").kill()


def test_the_handler_of_an_application_is_called_at_the_end_and_stays() -> None:
    called = []

    def handle(number: int, frame: FrameType | None) -> None:
        called.append(number)

    before = signal.signal(signal.SIGINT, handle)
    try:
        with Uninterrupted():
            with Uninterrupted():
                signal.raise_signal(signal.SIGINT)
            assert not called, "the outer block goes on"
        assert called == [signal.SIGINT]
        assert signal.getsignal(signal.SIGINT) is handle
        with Uninterrupted():
            signal.signal(signal.SIGINT, signal.SIG_IGN)
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN, "set meanwhile, by somebody else"
        with Uninterrupted():
            assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


def test_other_threads_leave_the_handler_alone() -> None:
    seen = []

    def look() -> None:
        with Uninterrupted():
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    assert seen == [signal.getsignal(signal.SIGINT)]
