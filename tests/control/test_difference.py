"""What should be open and what remains to be done, asked of states on their way."""

from __future__ import annotations

import pytest
from tests.control.world import FACE, Plans, World, desired

from uoarm._control.engine import actions as act
from uoarm._control.engine import events as ev
from uoarm._control.engine.move import MovePhase
from uoarm._control.engine.placement import Kind
from uoarm._control.engine.state import State
from uoarm._control.engine.step import difference, step
from uoarm.errors import ConnectionClosedError
from uoarm.model import ConnectionState, FailoverPolicy, Health, PortRef, ValidationMode

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
    assert opening.batches, "the step had it begun"
    assert (taking_over.phase, taking_over.batches) == (TAKING_OVER, ())
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
    assert set(first.batches) == {batch}
    world.do("request c1", fails_at=0)
    first, *_ = difference(world.state, world.state.connections["c2"])
    assert set(first.batches).isdisjoint({batch}), "it has a batch of its own now"
    assert phases(world, "c1") == [SEEKING, OPENING, TAKING_OVER], "without what did not open"


@pytest.mark.parametrize("error", [KeyboardInterrupt(), ConnectionClosedError("given up")])
def test_who_is_interrupted_or_gives_up_as_its_plan_opens_gets_no_other_plan(
    world: World, error: BaseException
) -> None:
    world.request("c1", "camera")
    world.do("request c1")
    (batch,) = world.state.batches
    world.lanes.pop("request c1")
    world.post(ev.Opened(batch, (), error))
    world.settle()
    assert world.state.connections.get("c1") is None
    assert world.replies == ("request c1",)


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


def test_what_was_reported_of_a_native_link_ends_with_it(world: World) -> None:
    for identity, function in (("c1", "face"), ("c2", "camera")):
        world.request(identity, function)
        world.settle()
    (edge,) = world.state.edges.values()
    (number, end), _ = edge.ends
    name, bridge = edge.edge.producer, world.state.components[number].step.component.bridge

    def healths(*reports: Health) -> list[Health]:
        for health in reports:
            world.post(ev.HealthReported(bridge, health, "so it is", name, end))
        return [world.state.components[number].health.health, *reports]

    assert healths(Health.DEGRADED) == [Health.DEGRADED] * 2
    world.kill("c1")
    world.settle()
    assert healths() == [Health.OK]
    assert healths(Health.DEGRADED) == [Health.OK, Health.DEGRADED], "it came too late"
    assert not world.state.components[number].health.reported


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
        assert set(switching.members) == {other}
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


class Known:
    """A state in which candidates changed, and requests with a plan that was found before."""

    def __init__(self) -> None:
        self.plans = Plans(FACE)
        self.bridges = {item.name: item.bridge for item in self.plans.robot.components()}
        self.state = State(FailoverPolicy(), self.bridges)

    def post(self, event: ev.Event) -> tuple[act.Action, ...]:
        self.state, actions = step(self.state, event, 0.0)
        return actions

    def change_candidates(self, *superseded: str) -> None:
        number = self.state.candidates + 1
        self.post(ev.CandidatesChanged(self.bridges, "another", number, frozenset(superseded)))

    def is_opened(self, candidates: int) -> bool:
        """Say whether a plan that was found with so many changes is opened, not sought anew."""
        identity = f"c{self.state.requests + 1}"
        plan = self.plans("camera", frozenset())
        actions = self.post(
            ev.Requested(
                identity,
                PortRef("camera", None),
                ValidationMode.OFF,
                f"request {identity}",
                plan,
                revision=self.state.revision,
                candidates=candidates,
            )
        )
        kinds = {type(action) for action in actions}
        assert len(kinds & {act.Open, act.Resolve}) == 1
        return act.Open in kinds


def test_a_plan_found_too_many_changes_of_candidates_ago_is_sought_anew() -> None:
    known = Known()
    for _ in range(17):
        known.change_candidates("another")
    assert not known.is_opened(candidates=0), "what the first change superseded is not known"
    assert known.is_opened(candidates=1), "none of those since then has a component of the plan"


def test_candidates_are_counted_anew_in_another_configuration() -> None:
    known = Known()
    known.change_candidates("best")
    assert not known.is_opened(candidates=0)
    known.post(ev.Configured(1, "w", known.state.policy, known.bridges, frozenset(), frozenset()))
    assert known.is_opened(candidates=0), "or its plan would be sought for ever"


def test_who_waits_for_what_can_take_over_has_all_before_it(world: World) -> None:
    world.request("c1", "camera")
    world.settle()
    for name in ("best", "spare"):
        world.die(name)
        while world.lanes:
            world.do(next(iter(world.lanes)))
    waiting, *later = difference(world.state, world.state.connections["c1"])
    assert (waiting.phase, waiting.is_begun) == (MovePhase.WAITING, True)
    assert [item.phase for item in later] == [OPENING, TAKING_OVER]


@pytest.mark.parametrize(
    ("end", "is_killed"), [("kill", True), ("failure", False), ("finish", False), ("stop", False)]
)
def test_what_waits_is_discarded_only_where_the_application_kills(
    world: World, end: str, is_killed: bool
) -> None:
    """What has come before a source finishes, or anything fails, is for the application still."""
    world.request("c1", "camera")
    world.settle()
    match end:
        case "kill":
            world.kill("c1")
        case "failure":
            world.asked += ("kill",)
            world.post(ev.Killed("c1", "kill", "too slow", is_failure=True))
        case "finish":
            world.finish("best")
            world.do("c1!drain")
        case "stop":
            world.stop()
    assert world.state.connections["c1"].is_killed is is_killed
    world.settle()
    world.check_at_rest()
