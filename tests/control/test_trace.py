"""What a manager logged of its events leads to the same actions, without a thread or a bridge.

Below `field` are logs of soaks that failed, pasted as they were written.
"""

from __future__ import annotations

import copy
import importlib
import logging
import pickle
import re
from collections.abc import Callable, Mapping
from http import HTTPStatus
from pathlib import Path

import pytest
from tests.control.event_log import read_event
from tests.control.world import FACE, Plans
from tests.sweeps import for_all

import uoarm
from uoarm import RobotManager
from uoarm._control.engine import actions as act
from uoarm._control.engine import events as ev
from uoarm._control.engine.draft import InputInUseError
from uoarm._control.engine.events import write_event
from uoarm._control.engine.state import State
from uoarm._control.engine.step import step
from uoarm._control.live import driver
from uoarm._resolve import NoPlanError
from uoarm.client import ServerError
from uoarm.config import loads
from uoarm.errors import (
    BridgeError,
    CommandRefusedError,
    FailureReason,
    ListenError,
    UoarmError,
)
from uoarm.model import ConnectionState, FailoverPolicy, Health, Plan
from uoarm.server.access._admission import RefusedError, WrongTokenError
from uoarm.testing import MemoryBridge, wait

NUMBER = {"type": "integer"}
ROBOT = FACE + "failover: {return_after: 0.05, wait: 1}\n"


class Steps:
    """The steps of the managers of a test: states before them, and plans that they were given."""

    def __init__(self) -> None:
        self.begun: list[State] = []
        self.plans: dict[tuple[str, ...], Plan] = {}
        self._done: list[tuple[act.Action, ...]] = []

    def step(
        self, state: State, event: ev.Event, now: float
    ) -> tuple[State, tuple[act.Action, ...]]:
        self.begun.append(state)
        plan = getattr(event, "plan", None)
        if plan is not None:
            self.plans[plan.names] = plan
        after, actions = step(state, event, now)
        self._done.append(actions)
        return after, actions

    def logged(self, caplog: pytest.LogCaptureFixture) -> list[tuple[str, tuple[act.Action, ...]]]:
        """Return the actions of each step with the line that was logged before it."""
        # In this order: a plan may have run out after its manager was closed, in a thread.
        done = tuple(self._done)

        def lines() -> list[str]:
            records = tuple(caplog.records)
            return [record.getMessage() for record in records if record.name == "uoarm.control"]

        wait(lambda: len(lines()) >= len(done))
        return list(zip(lines(), done, strict=False))


@pytest.fixture
def steps(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> Steps:
    found = Steps()
    monkeypatch.setattr(driver, "step", found.step)
    caplog.set_level(logging.DEBUG, "uoarm.control")
    return found


def test_a_log_of_events_replays_to_the_same_actions(
    steps: Steps, caplog: pytest.LogCaptureFixture
) -> None:
    one, two = MemoryBridge("one", {}), MemoryBridge("two", {})
    one.emitter("best", NUMBER)
    two.emitter("spare", NUMBER)
    two.loop("finder", NUMBER)
    with RobotManager(loads(ROBOT), bridges={"one": one, "two": two}) as robot:
        face, camera = robot.request("face"), robot.request("camera")
        two.report(Health.DEGRADED, "it is hot")
        one.die("best", "it was unplugged")
        wait(lambda: face.gaps and camera.gaps)
        one.emitter("best", NUMBER)
        wait(lambda: len(face.gaps) == len(camera.gaps) == 2)
        camera.kill()
        two.die("finder", "it fell")
        wait(lambda: face.ended)
    plans = Plans(ROBOT)
    every = {component.name for component in plans.robot.components()}

    def find_plan(function: str, components: tuple[str, ...]) -> Plan:
        return plans(function, frozenset(every - {*components, "finder"}))

    logged, state = steps.logged(caplog), steps.begun[0]
    assert len(logged) > 15
    for line, actions in logged:
        event, now = read_event(line, find_plan)
        state, again = step(state, event, now)
        assert list(map(repr, again)) == list(map(repr, actions)), line


# How those are made that need more than a text.
MADE: Mapping[type[UoarmError], Callable[[str], UoarmError]] = {
    NoPlanError: lambda text: NoPlanError(text, (), is_unavailable=True),
    InputInUseError: lambda text: InputInUseError(text, "best"),
    ListenError: lambda text: ListenError(text, 9080, PermissionError(13, "")),
    CommandRefusedError: lambda text: CommandRefusedError(text, "leased"),
    ServerError: lambda text: ServerError("busy", text),
    RefusedError: lambda text: RefusedError(HTTPStatus.NOT_FOUND, text),
    WrongTokenError: lambda text: WrongTokenError(HTTPStatus.FORBIDDEN, text),
}


def _every_error() -> list[type[UoarmError]]:
    source = Path(uoarm.__file__).parents[1]
    for path in source.glob("uoarm/**/*.py"):
        if re.search(r"^class \w+Error\(", path.read_text(encoding="utf-8"), re.MULTILINE):
            importlib.import_module(".".join(path.relative_to(source).with_suffix("").parts))
    found: list[type[UoarmError]] = [UoarmError]
    for class_ in found:
        found += class_.__subclasses__()
    own = [class_ for class_ in found if class_.__module__.split(".")[0] == "uoarm"]
    return sorted(own, key=lambda item: item.__name__)


EVERY_ERROR = _every_error()


def test_no_two_errors_have_one_name() -> None:
    assert len({kind.__name__ for kind in EVERY_ERROR}) == len(EVERY_ERROR)


@for_all("kind", EVERY_ERROR)
def test_every_error_is_read_back_as_itself(kind: type[UoarmError]) -> None:
    error = MADE.get(kind, kind)("it is 'hot'\nand \"wet\"")
    _assert_same(error, ev.Resolved("c1", None, error))
    _assert_same(error, ev.Opened(1, (), error))


@for_all("kind", [*EVERY_ERROR, None])
def test_an_error_is_the_same_in_another_process_and_copied(kind: type[UoarmError] | None) -> None:
    error = _StalledError(joint=2) if kind is None else MADE.get(kind, kind)("hot\nor wet")
    for again in (pickle.loads(pickle.dumps(error)), copy.copy(error), copy.deepcopy(error)):
        assert type(again) is type(error)
        assert (again.args, str(again), vars(again)) == (error.args, str(error), vars(error))
        assert getattr(again, "errno", None) == getattr(error, "errno", None)


class _StalledError(BridgeError):
    """An error of a plugin."""

    def __init__(self, *, joint: int) -> None:
        super().__init__(f"joint {joint} stalled", FailureReason.REFUSED)
        self.joint = joint


@pytest.mark.parametrize(
    "error",
    [_StalledError(joint=2), BridgeError("gone", FailureReason.UNAVAILABLE), RuntimeError("bug")],
    ids=lambda error: type(error).__name__,
)
def test_the_errors_of_plugins_and_of_others_are_read_back_by_name_and_text(
    error: Exception,
) -> None:
    _assert_same(error, ev.Opened(1, (), error))


def _assert_same(error: Exception, event: ev.Event) -> None:
    again, _ = read_event(write_event(event, 1.0), lambda *_: pytest.fail("there is no plan"))
    assert type(again) is type(event)
    got = getattr(again, "error", None)
    assert isinstance(error, UoarmError) is (type(got) is type(error))
    assert (repr(got), str(got)) == (repr(error), str(error))
    assert getattr(got, "reason", None) == getattr(error, "reason", None)


NEEDS = """
version: 1
bridges: {one: {plugin: memory}}
functions:
  camera: {needs: {structure: {type: integer}}}
"""


def test_what_is_discovered_is_in_the_log_and_replays(
    steps: Steps, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uoarm._resolve._discovery._EVERY_SECONDS", 0.05)
    one = MemoryBridge("one", {})
    one.emitter("first", NUMBER)
    with RobotManager(loads(NEEDS), bridges={"one": one}) as robot:
        camera = robot.request("camera")
        one.emitter("second", NUMBER)
        wait(lambda: len(robot.config.functions["camera"].components) == 2)
        one.die("first", "it was unplugged")
        wait(lambda: camera.gaps)
    logged, state = steps.logged(caplog), steps.begun[0]
    events = []
    for line, actions in logged:
        event, now = read_event(line, lambda _, these: steps.plans[these])
        events.append(event)
        state, again = step(state, event, now)
        assert list(map(repr, again)) == list(map(repr, actions)), line
    seen = [item for item in events if isinstance(item, ev.CandidatesChanged)]
    assert "camera@one/second" in seen[1].bridges
    assert "+ component camera@one/second" in seen[1].summary


SOAK = """
version: 1
bridges: {one: {plugin: memory}, two: {plugin: memory}, three: {plugin: memory},
          four: {plugin: memory}}
functions:
  numbers:
    components:
      - {name: first, bridge: one, priority: 2, output: {endpoint: [numbers]}}
      - {name: second, bridge: two, priority: 1, output: {endpoint: [numbers]}}
  found:
    components:
      - {name: near, bridge: three, priority: 2, input: {from: numbers, endpoint: [finder]},
         output: {endpoint: [finder]}}
      - {name: far, bridge: four, priority: 1, input: {from: numbers, endpoint: [finder]},
         output: {endpoint: [finder]}}
"""


def _asked(action: act.Action) -> tuple[object, ...] | None:
    """Return what comes back of an action; None: nothing."""
    match action:
        case act.Resolve():
            return ev.Resolved, action.connection
        case act.Open():
            return ev.Opened, action.batch
        case act.FindReplacement():
            return ev.ReplacementSought, action.connection, action.attempt, action.switchover
        case act.CheckPreferred():
            return ev.PreferredChecked, action.connection
        case act.SwitchInputs():
            return ev.InputsSwitched, action.switchover
    return None


def _answered(event: ev.Event) -> tuple[object, ...] | None:
    """Return which action an event answers; None: it answers none."""
    match event:
        case ev.Resolved() | ev.PreferredChecked():
            return type(event), event.connection
        case ev.Opened():
            return type(event), event.batch
        case ev.ReplacementSought():
            return type(event), event.connection, event.attempt, event.switchover
        case ev.InputsSwitched():
            return type(event), event.switchover
    return None


def test_a_soak_that_took_waiting_for_the_end_goes_on() -> None:
    """Both detectors had died within seconds, at a load of eight; the soak gave up, wrongly."""
    plans = Plans(SOAK)
    every = {component.name for component in plans.robot.components()}
    policy = FailoverPolicy(wait=90.0, limit=1_000_000, return_after=0.5)
    state = State(
        policy, {component.name: component.bridge for component in plans.robot.components()}
    )
    log = Path(__file__).parent / "field" / "both_detectors_died.jsonl"
    asked: set[tuple[object, ...]] = set()
    seen: list[tuple[ConnectionState, tuple[str, ...]]] = []
    for line in log.read_text(encoding="utf-8").splitlines():
        event, now = read_event(
            line, lambda name, these: plans(name, frozenset(every.difference(these)))
        )
        answer = _answered(event)
        if answer is not None:
            assert answer in asked, line
            asked.remove(answer)
        state, actions = step(state, event, now)
        asked |= {tuple_ for tuple_ in map(_asked, actions) if tuple_ is not None}
        for action in actions:  # what ran out was closed with it when this was logged
            if isinstance(action, act.Finish):
                state, _ = step(state, ev.RanOut(action.placement.user), now)
        assert all(item.error is None for item in actions if isinstance(item, act.Reply)), line
        record = state.connections["c1"]
        if record.has_plan:
            now_seen = record.state, record.components
            seen += [] if seen[-1:] == [now_seen] else [now_seen]
    before = seen.index((ConnectionState.WAITING, ("first",)))
    assert seen[before - 1] == (ConnectionState.RUNNING, ("first", "near"))
    assert seen[before + 1] == (ConnectionState.RUNNING, ("first", "far"))
