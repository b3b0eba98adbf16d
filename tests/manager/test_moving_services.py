"""Services that move something: a call ends in time, and the emergency stop cancels and refuses."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import pytest

from uoarm import RobotManager
from uoarm.bridge import (
    Bridge,
    Description,
    Registry,
    ServiceStructures,
)
from uoarm.bridge._services import CallsUnderWay, CallUnderWay
from uoarm.config import loads
from uoarm.errors import BridgeError, BridgeTimeoutError, CommandRefusedError, ConfigurationError
from uoarm.model import Endpoint, Message, MessageStructure, StopReport
from uoarm.testing import Background, MemoryBridge, patience, wait

ROBOT = """
version: 1
bridges: {arms: {plugin: python}}
functions:
  reach: {components: [{name: arm, bridge: arms, service: {endpoint: [arm], lifetime: 3600}}]}
  grasp: {components: [{name: hand, bridge: arms, service: {endpoint: [hand], lifetime: 0.05}}]}
  think: {components: [{name: head, bridge: arms, service: {endpoint: [head]}}]}
"""


class Arms(MemoryBridge):
    """Services that answer when they are let go; `arm` and `hand` can be cancelled."""

    def __init__(self) -> None:
        super().__init__("arms")
        self.go_on = threading.Event()
        self.called = {name: threading.Event() for name in ("arm", "hand", "head")}
        self.cancelled: list[str] = []
        self.can_cancel = True

    def _describe(self, endpoint: Endpoint) -> Description:
        number = MessageStructure({"type": "number"})
        return Description(request=number, reply=number)

    def _call(
        self, endpoint: Endpoint, structures: ServiceStructures, message: Message, timeout: float
    ) -> Message:
        name, over = endpoint.component, threading.Event()

        def cancel() -> None:
            self.cancelled.append(name)
            over.set()

        if not self.can_cancel:
            self.called[name].set()
            assert self.go_on.wait(patience())
            return message
        with self.cancelling(cancel):
            self.called[name].set()
            if name != "head":
                assert over.wait(patience())
                raise BridgeError("it was cancelled")
        return message

    def _close(self) -> None:
        self.go_on.set()


@pytest.fixture
def arms() -> Arms:
    return Arms()


@pytest.fixture
def robot(arms: Arms) -> Iterator[RobotManager]:
    with RobotManager(loads(ROBOT), registry=Registry(()), bridges={"arms": arms}) as robot:
        yield robot


@pytest.fixture
def reaching(robot: RobotManager, arms: Arms) -> Iterator[list[BaseException | float]]:
    """A call of `reach` that is under way, and what becomes of it."""
    came: list[BaseException | float] = []

    def call() -> None:
        try:
            came.append(robot.call("reach", 1.0, timeout=2 * patience()))
        except CommandRefusedError as error:
            came.append(error)

    thread = threading.Thread(target=call)
    thread.start()
    arms.called["arm"].wait(patience())
    yield came
    arms.go_on.set()
    thread.join(patience())


def test_a_call_under_way_is_cancelled_and_the_next_is_refused(
    robot: RobotManager, arms: Arms, reaching: list[BaseException | float]
) -> None:
    report = robot.stop_all(timeout=patience())
    assert [(input_.component, input_.stopped) for input_ in report.inputs] == [("arm", True)]
    wait(lambda: len(reaching) == 1)
    assert "the emergency stop cancelled the call: it was cancelled" in str(reaching[0])
    with pytest.raises(CommandRefusedError, match="until the emergency stop is released"):
        robot.call("reach", 1.0)
    assert robot.call("think", 2.0, timeout=patience()) == 2.0, "it moves nothing"
    assert robot.status().components == (), "no component is to blame"
    robot.release(timeout=patience())
    while not arms.called["hand"].is_set():  # its time may be over before it has begun
        with pytest.raises(BridgeTimeoutError):
            robot.call("grasp", 1.0, timeout=patience())
    wait(lambda: arms.cancelled == ["arm", "hand"], "what was not in time is not cancelled")


def test_a_manager_that_is_closed_cancels_calls_before_it_closes_anything(
    arms: Arms, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What hangs as it is closed, such as another bridge, holds up no cancelling."""
    robot = RobotManager(loads(ROBOT), registry=Registry(()), bridges={"arms": arms})
    unobserve = robot._unobserve

    def look() -> None:
        wait(lambda: arms.cancelled == ["arm"])
        unobserve()

    monkeypatch.setattr(robot, "_unobserve", look)
    call = Background(lambda: robot.call("reach", 1.0, timeout=2 * patience()))
    assert arms.called["arm"].wait(patience())
    robot.close()
    with pytest.raises(BridgeError, match="it was cancelled"):
        call.result()


def test_what_cannot_be_cancelled_is_reported_as_not_stopped(
    robot: RobotManager, arms: Arms, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uoarm._safety._SHARE", 0.0)
    arms.can_cancel = False
    thread = threading.Thread(target=lambda: robot.call("reach", 1.0, timeout=2 * patience()))
    thread.start()
    assert arms.called["arm"].wait(patience())
    (outcome,) = robot.stop_all(timeout=patience()).inputs
    assert not outcome.stopped
    assert outcome.cause == "a call of it is under way, which its framework cannot cancel"
    arms.go_on.set()
    thread.join(patience())
    assert robot.stop_all(timeout=patience()).inputs == (), "nothing of it is under way any more"


def test_a_call_that_was_cancelled_before_it_could_be_is_cancelled_when_it_can() -> None:
    calls, call, reports = CallsUnderWay(), CallUnderWay(7), list[str]()
    outer = calls.begin(call)
    assert not calls.cancel_number(7)
    with calls.cancelling(lambda: reports.append("cancelled")):
        assert reports == ["cancelled"]
        assert calls.cancel_number(7)
    calls.end(call, outer)
    assert reports == ["cancelled", "cancelled"]


def test_a_call_that_was_cancelled_before_it_began_never_does() -> None:
    calls = CallsUnderWay()
    assert calls.cancel_number(7)
    with pytest.raises(BridgeError, match="cancelled before it began"):
        calls.begin(CallUnderWay(7))
    for number in (8, None):
        calls.begin(CallUnderWay(number))


def test_a_stop_between_the_listing_of_a_call_and_its_beginning_holds_it(
    robot: RobotManager, arms: Arms, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The worker that makes the call is late, as on a busy machine."""
    call = Bridge.call

    def late(bridge: Bridge, *given: Any, **named: Any) -> Message:
        stopping = Background(lambda: robot.stop_all(timeout=patience()))
        wait(lambda: named["number"] in arms._pending_calls._early)
        try:
            return call(bridge, *given, **named)
        finally:
            stopped.append(stopping)

    stopped: list[Background[StopReport]] = []
    monkeypatch.setattr(Bridge, "call", late)
    with pytest.raises(CommandRefusedError, match="cancelled before it began"):
        robot.call("reach", 1.0, timeout=patience())
    assert stopped[0].result().stopped
    assert not arms.called["arm"].is_set()


def test_a_lifetime_of_a_call_is_checked() -> None:
    with pytest.raises(ConfigurationError, match="lifetime"):
        loads(ROBOT.replace("0.05", "soon"))
