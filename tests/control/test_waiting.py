"""How often a connection that waits looks for what takes over: soon at first, then more seldom."""

from __future__ import annotations

from itertools import pairwise

import pytest
from tests.control.world import FACE, Plans, World, discovered

from uoarm._control.engine import actions as act
from uoarm.model import ConnectionState, FailoverPolicy, Health

PLANS = Plans(FACE)
FIRST, MOST, SLACK = 0.1, 5.0, 0.001
HOUR = 3600.0


class Waiting(World):
    """A connection whose candidates are dead, and when it was looked for another."""

    def __init__(
        self, wait: float, function: str = "camera", dead: tuple[str, ...] = ("best", "spare")
    ) -> None:
        super().__init__(PLANS, FailoverPolicy(wait=wait))
        self.looked: list[float] = []
        self.request("c1", function)
        self.settle_now()
        for name in dead:
            self.die(name)
            self.settle_now()
        assert self.state.connections["c1"].state is ConnectionState.WAITING

    def _keep(self, action: act.Action) -> None:
        if isinstance(action, act.FindReplacement):
            self.looked.append(self.now)
        super()._keep(action)

    def settle_now(self) -> None:
        """Do all that can be done at this moment."""
        while self.lanes:
            self.do(next(iter(self.lanes)))

    def wait_until(self, time: float) -> None:
        """Let time pass, and do what is due in between."""
        while self.wake_at is not None and self.wake_at <= time:
            self.pass_time(max(0.0, self.wake_at - self.now))
            self.settle_now()
        self.now = max(self.now, time)  # without an event: nothing has asked for one


def test_it_looks_at_once_and_then_after_an_eighth_of_what_it_has_waited() -> None:
    world = Waiting(HOUR)
    world.wait_until(HOUR / 2)
    pauses = [after - before for before, after in pairwise(world.looked[1:])]
    assert pauses[0] <= FIRST + SLACK
    assert all(after >= before - SLACK for before, after in pairwise(pauses))
    assert pauses[-1] == pytest.approx(MOST)
    for pause, time in zip(pauses, world.looked[2:], strict=True):
        assert pause <= max(FIRST, time / 8) + SLACK
    assert len(world.looked) < HOUR / 2 / MOST + 100


def test_what_is_reported_to_be_well_is_looked_at_soon() -> None:
    world = Waiting(HOUR)
    world.wait_until(HOUR / 2)
    world.revive("best")
    world._report("best", Health.OK)
    world.wait_until(world.now + FIRST)
    assert world.state.connections["c1"].state is ConnectionState.RUNNING


def test_what_is_in_use_and_well_again_is_no_reason_to_look() -> None:
    world = Waiting(HOUR, "face", ("finder",))
    world.request("c2", "camera")
    world.wait_until(HOUR / 2)
    looked, due = len(world.looked), world.wake_at
    for health in (Health.DEGRADED, Health.OK):
        world._report("best", health)
    assert (len(world.looked), world.wake_at) == (looked, due)


def test_other_candidates_are_looked_at_soon() -> None:
    world = Waiting(HOUR)
    world.wait_until(HOUR / 2)
    world.discover(Plans(discovered(FACE)))
    world.wait_until(world.now + FIRST)
    assert world.state.connections["c1"].state is ConnectionState.RUNNING


def test_reports_one_after_the_other_have_it_look_no_more_often() -> None:
    world = Waiting(HOUR)
    world.wait_until(HOUR / 2)
    before = len(world.looked)
    for _ in range(1000):
        world._report("best", Health.OK)
        world.wait_until(world.now + FIRST / 100)
    assert len(world.looked) - before <= 1000 / 100 + 1


def test_the_end_of_the_wait_is_noticed_on_time() -> None:
    world = Waiting(30.0)
    world.wait_until(30.0 - SLACK)
    assert world.state.connections["c1"].state is ConnectionState.WAITING
    world.wait_until(30.0)
    assert "c1" not in world.state.connections


def test_what_died_long_ago_is_forgotten_also_where_nothing_is_sought() -> None:
    world = World(PLANS, FailoverPolicy(enabled=False))
    for identity, name in (("c1", "best"), ("c2", "spare")):
        world.request(identity, "camera")
        world.settle()
        world.die(name)
        world.settle()
        world.pass_time(HOUR)
    assert set(world.state.failed) == {"spare"}
