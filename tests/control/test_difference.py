"""What should be open and what remains to be done, asked of states on their way."""

from __future__ import annotations

import pytest
from tests.control.world import FACE, Plans, World

from uoarm._control.engine import actions as act
from uoarm._control.engine.difference import desired, difference
from uoarm._control.engine.move import MovePhase
from uoarm._control.engine.state import Kind
from uoarm.model import ConnectionState, FailoverPolicy

SEEKING, OPENING, SWITCHING = MovePhase.SEEKING, MovePhase.OPENING, MovePhase.SWITCHING
TAKING_OVER, DRAINING = MovePhase.TAKING_OVER, MovePhase.DRAINING


@pytest.fixture
def world() -> World:
    return World(Plans(FACE), FailoverPolicy(wait=5.0, return_after=1.0))


def phases(world: World, identity: str) -> list[MovePhase]:
    remaining = difference(world.state, world.state.connections[identity])
    return [item.phase for item in remaining]


def test_a_request_is_sought_then_opened_then_runs(world: World) -> None:
    assert desired(world.state) == frozenset()
    world.request("c1", "face")
    assert phases(world, "c1") == [SEEKING, OPENING, TAKING_OVER]
    assert desired(world.state) == frozenset(), "which plan is wanted is not known yet"
    world.do("request c1")
    opening, taking_over = difference(world.state, world.state.connections["c1"])
    assert opening.phase is OPENING
    assert opening.awaits, "the step had it begun"
    assert (taking_over.phase, taking_over.awaits) == (TAKING_OVER, ())
    assert desired(world.state) == frozenset(opening.parts), "nothing of it is open yet"
    kinds = [part.kind for part in opening.parts]
    assert kinds.index(Kind.EDGE) < max(
        place for place, kind in enumerate(kinds) if kind is Kind.OUTPUT
    ), "an output opens after the edge that it feeds"
    world.do("request c1")
    assert phases(world, "c1") == []
    assert world.open == desired(world.state)


def test_what_another_opens_is_waited_for_and_asked_for_when_that_fails(world: World) -> None:
    for identity in ("c1", "c2"):
        world.request(identity, "face")
        world.do(f"request {identity}")
    (batch,) = world.state.batches
    first, *_ = difference(world.state, world.state.connections["c2"])
    assert first.phase is OPENING
    assert set(first.awaits) == {batch}
    world.do("request c1", fails_at=0)
    first, *_ = difference(world.state, world.state.connections["c2"])
    assert set(first.awaits).isdisjoint({batch}), "it has a batch of its own now"
    assert "c1" not in {record.id for record in world.state.connections.values() if record.plans}


def test_a_death_seeks_opens_and_takes_over_and_what_drains_is_open_until_then(
    world: World,
) -> None:
    world.request("c1", "camera")
    world.settle()
    world.die("best")
    assert phases(world, "c1") == [SEEKING, OPENING, TAKING_OVER]
    (before,) = world.state.connections["c1"].plans
    while world.state.connections["c1"].move is not None:
        world.do(next(iter(world.lanes)))
    assert phases(world, "c1") == []
    component = before.parts[0]
    assert component.kind is Kind.COMPONENT
    assert component in desired(world.state), "it drains"
    world.settle()
    assert component not in desired(world.state)


def test_members_of_a_switchover_wait_for_each_other(world: World) -> None:
    for identity in ("c1", "c2"):
        world.request(identity, "face")
        world.settle()
    world.die("best")
    world.settle()
    world.revive("best")
    while not any(isinstance(actions[0], act.Open) for actions in world.lanes.values()):
        if world.lanes:
            world.do(next(iter(world.lanes)))
        else:
            world.pass_time(0.3)
    (group,) = world.state.switchovers.values()
    assert set(group.members) == {"c1", "c2"}
    for identity, other in (("c1", "c2"), ("c2", "c1")):
        opening, switching, taking_over = difference(world.state, world.state.connections[identity])
        assert (opening.phase, switching.phase) == (OPENING, SWITCHING)
        assert set(switching.awaits) == {other}
        assert not switching.is_begun
        assert taking_over.phase is TAKING_OVER
    while not any(isinstance(actions[0], act.SwitchInputs) for actions in world.lanes.values()):
        world.do(next(iter(world.lanes)))
    for identity in group.members:
        switching, _ = difference(world.state, world.state.connections[identity])
        assert (switching.phase, switching.is_begun) == (SWITCHING, True)
    world.settle()
    assert phases(world, "c1") == phases(world, "c2") == []


def test_an_end_wants_nothing_more_at_once_and_has_only_to_drain(world: World) -> None:
    world.request("c1", "face")
    world.settle()
    world.kill("c1")
    assert phases(world, "c1") == [DRAINING]
    assert world.state.connections["c1"].state is ConnectionState.CLOSING
    assert desired(world.state) == frozenset()
    assert world.open, "what is open closes"
    world.settle()
    assert world.open == frozenset()
