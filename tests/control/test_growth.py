"""What is done for one connection does not grow with what died beside it."""

from __future__ import annotations

import math

import pytest
from tests.control.world import Plans, World

from uoarm._control.engine import actions as act
from uoarm._control.engine import events as ev
from uoarm._control.revisions import find_replacement
from uoarm.errors import ResolutionError
from uoarm.model import FailoverPolicy, Health, Plan, PortRef, ValidationMode

NAMES = tuple(f"camera{number}" for number in range(12))
HEAD = "version: 1\nbridges: {one: {plugin: memory}}\nfunctions:\n"
CAMERAS = f"{HEAD}  camera:\n    components:\n" + "".join(
    f"      - {{name: {name}, bridge: one, priority: {priority}, output: {{endpoint: [{name}]}}}}\n"
    for priority, name in enumerate(reversed(NAMES))
)
APART = HEAD + "".join(
    f"  {name}s:\n    components:\n"
    f"      - {{name: {name}, bridge: one, output: {{endpoint: [{name}]}}}}\n"
    for name in NAMES
)


class Counted:
    """Plans that count how often one is asked for."""

    def __init__(self) -> None:
        self.plans = Plans(CAMERAS)
        self.asked = 0

    def __call__(self, function: str, excluded: frozenset[str]) -> Plan:
        self.asked += 1
        return self.plans(function, excluded)


@pytest.mark.parametrize("dead", range(len(NAMES)))
def test_what_failed_longest_ago_takes_over_where_nothing_else_can(dead: int) -> None:
    """Of those that failed, in the order of their deaths, the first that is not excluded."""
    resolve = Counted()
    plan = resolve("camera", frozenset())
    failed = (*NAMES[6:], *NAMES[:6])
    found = find_replacement(plan, None, frozenset(failed[:dead]), failed, resolve)
    assert found.provider.component.name == failed[dead]
    assert resolve.asked <= 3 + math.ceil(math.log2(len(failed)))


def test_where_nothing_takes_over_the_number_of_deaths_costs_no_search() -> None:
    resolve = Counted()
    plan = resolve("camera", frozenset())
    with pytest.raises(ResolutionError):
        find_replacement(plan, None, frozenset(NAMES), NAMES, resolve)
    assert resolve.asked == 2


def test_a_bridge_that_dies_with_many_is_no_longer_a_list_in_each_connection() -> None:
    """A connection knows what it lost itself; the names that died are one value for all."""
    world = World(Plans(APART), FailoverPolicy(wait=10.0))
    sought: list[act.FindReplacement] = []
    keep = world._keep

    def kept(action: act.Action) -> None:
        if isinstance(action, act.FindReplacement):
            sought.append(action)
        keep(action)

    for name in NAMES:
        function = f"{name}s"
        plan, waiter = world.plans(function, frozenset()), f"request {name}"
        world.asked += (waiter,)
        world.post(
            ev.Requested(
                name,
                PortRef(function),
                ValidationMode.OFF,
                waiter,
                plan,
                has_callback=False,
                revision=0,
            )
        )
    world.settle()
    world._keep = kept  # type: ignore[method-assign]
    world.dead |= frozenset(NAMES)
    world.post(ev.HealthReported("one", Health.LOST, "it crashed"))
    records = world.state.connections.values()
    assert [record.failure and len(record.failure.lost) for record in records] == [1] * len(NAMES)
    assert len(sought) == len(NAMES)
    assert len({id(action.failed) for action in sought}) == 1
