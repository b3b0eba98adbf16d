"""What a manager logged of its events leads to the same actions, without a thread or a bridge."""

from __future__ import annotations

import logging

import pytest
from tests.control.world import FACE, Plans

from uoarm import RobotManager
from uoarm._control import _actions as act
from uoarm._control import _events as ev
from uoarm._control import _executor
from uoarm._control._state import State
from uoarm._control._step import step
from uoarm._control._trace import read
from uoarm.config import loads
from uoarm.model import Health, Plan
from uoarm.testing import MemoryBridge, wait

NUMBER = {"type": "integer"}
ROBOT = FACE + "failover: {return_after: 0.05, wait: 1}\n"


@pytest.fixture
def played(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> tuple[State, list[tuple[act.Action, ...]], list[str]]:
    """Let a manager live through deaths and a return; return its beginning, actions and log."""
    done: list[tuple[act.Action, ...]] = []
    begun: list[State] = []

    def watched(state: State, event: ev.Event, now: float) -> tuple[State, tuple[act.Action, ...]]:
        begun.append(state)
        after, actions = step(state, event, now)
        done.append(actions)
        return after, actions

    monkeypatch.setattr(_executor, "step", watched)
    caplog.set_level(logging.DEBUG, "uoarm.control")
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
    lines = [one.getMessage() for one in caplog.records if one.name == "uoarm.control"]
    return begun[0], done, lines


def test_a_log_of_events_replays_to_the_same_actions(
    played: tuple[State, list[tuple[act.Action, ...]], list[str]],
) -> None:
    state, done, lines = played
    plans = Plans(ROBOT)
    every = {one.name for one in plans.robot.components()}

    def find_plan(function: str, components: tuple[str, ...]) -> Plan:
        return plans(function, frozenset(every - {*components, "finder"}))

    assert len(lines) == len(done) > 15
    for line, actions in zip(lines, done, strict=True):
        event, now = read(line, find_plan)
        state, again = step(state, event, now)
        assert list(map(repr, again)) == list(map(repr, actions)), line
