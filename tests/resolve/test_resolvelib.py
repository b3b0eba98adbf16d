"""A second opinion: pip's resolver agrees on what can be resolved, and on the plan itself."""

from __future__ import annotations

from bench._resolvelib_peer import resolve_with_resolvelib
from hypothesis import given
from hypothesis import strategies as st
from tests.resolve.test_search import World, component

from uoarm._resolve import NoPlanError, Resolver
from uoarm.model import Function, Robot

NAMES = ["a", "b", "c", "d", "e", "f"]


@st.composite
def acyclic_robots(draw: st.DrawFn) -> Robot:
    """Functions that need later ones only: resolvelib knows nothing of cycles."""
    functions = {}
    for place, name in enumerate(NAMES):
        later = NAMES[place + 1 :]
        needs = st.lists(st.sampled_from(later or [""]), max_size=2 if later else 0, unique=True)
        lists = draw(st.lists(needs, min_size=1, max_size=3))
        made = tuple(component(name, n, tuple(list_)) for n, list_ in enumerate(lists))
        functions[name] = Function(name, made)
    return Robot({}, functions)


missing = st.frozensets(st.sampled_from([f"{n}{i}" for n in NAMES for i in range(3)]), max_size=8)
forbidden = st.frozensets(st.tuples(st.integers(0, 2), st.integers(0, 2)), max_size=5)


def ours(robot: Robot, world: World) -> dict[str, str] | None:
    try:
        plan = Resolver(robot, world, world.check).resolve("a")
    except NoPlanError:
        return None
    return {step.component.function: step.component.name for step in plan.steps}


@given(acyclic_robots(), missing)
def test_where_every_edge_fits_both_find_the_same_plan(robot: Robot, gone: frozenset[str]) -> None:
    world = World(gone, frozenset())
    assert ours(robot, world) == resolve_with_resolvelib(robot, world, world.check, "a")


@given(acyclic_robots(), st.builds(World, missing, forbidden))
def test_both_agree_on_whether_there_is_a_plan(robot: Robot, world: World) -> None:
    mine = ours(robot, world)
    theirs = resolve_with_resolvelib(robot, world, world.check, "a")
    assert (mine is None) == (theirs is None)
