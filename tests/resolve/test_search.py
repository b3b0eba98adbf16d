"""The search finds what plain backtracking finds, on random graphs with conflicts and cycles."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest
from attrs import frozen
from hypothesis import given
from hypothesis import strategies as st

from uoarm._resolve import NoPlanError, Resolver, Structures, Unavailable, _search
from uoarm.errors import ResolutionError
from uoarm.model import (
    Component,
    Endpoint,
    Function,
    Input,
    Meaning,
    MessageStructure,
    Output,
    PortRef,
    Reason,
    Robot,
    Role,
)
from uoarm.testing import ManualClock


@frozen
class Verdict:
    compatible: bool
    reasons: tuple[Reason, ...] = (Reason("they differ"),)
    losses: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    unstated: tuple[str, ...] = ()


class World:
    """Structures are numbers; an edge fits when its pair of numbers is not forbidden."""

    def __init__(self, missing: frozenset[str], forbidden: frozenset[tuple[int, int]]) -> None:
        self.missing, self.forbidden = missing, forbidden
        self.asked: list[str] = []

    def structures(self, component: Component) -> Structures | Unavailable:
        self.asked.append(component.name)
        if component.name in self.missing:
            return Unavailable("it is not there")
        kind = MessageStructure({"const": component.priority % 3})
        ports = {f"input.{input_.name}": kind for input_ in component.inputs}
        return Structures({**ports, "output.default": kind})

    def check(
        self,
        producer: MessageStructure,
        consumer: MessageStructure,
        mapping: Mapping[str, object] | None,
        allow_loss: tuple[str, ...],
        meaning: Meaning,
    ) -> Verdict:
        return Verdict((_number(producer), _number(consumer)) not in self.forbidden)


def _number(structure: MessageStructure) -> int:
    schema: Any = structure.schema
    return int(schema["const"])


def component(function: str, number: int, needs: tuple[str, ...]) -> Component:
    name = f"{function}{number}"

    def endpoint(port: str, role: Role) -> Endpoint:
        return Endpoint("b", name, role, (name,), port)

    inputs = tuple(
        Input(f"in{n}", endpoint(f"in{n}", Role.INPUT), PortRef(need))
        for n, need in enumerate(needs)
    )
    output = Output("default", endpoint("default", Role.OUTPUT))
    return Component(name, function, "b", 100 - number, inputs, (output,))


NAMES = ["f", "g", "h", "i"]
needs = st.lists(st.sampled_from(NAMES), max_size=2, unique=True).map(tuple)


@st.composite
def robots(draw: st.DrawFn) -> Robot:
    functions = {}
    for name in NAMES:
        lists = draw(st.lists(needs, min_size=1, max_size=3))
        made = tuple(component(name, n, list_) for n, list_ in enumerate(lists))
        functions[name] = Function(name, made)
    return Robot({}, functions)


worlds = st.builds(
    World,
    st.frozensets(st.sampled_from([f"{n}{i}" for n in NAMES for i in range(3)]), max_size=3),
    st.frozensets(st.tuples(st.integers(0, 2), st.integers(0, 2)), max_size=4),
)


def plain_backtracking(robot: Robot, world: World, name: str) -> dict[str, str] | None:
    """The first assignment of depth-first chronological search, or None: the definition."""

    def fits(chosen: dict[str, Component]) -> bool:
        for item in chosen.values():
            kind = item.priority % 3
            for port in item.inputs:
                assert port.source is not None
                fed = chosen.get(port.source.function)
                if fed is not None and (fed.priority % 3, kind) in world.forbidden:
                    return False
        return not cyclic(chosen)

    def cyclic(chosen: dict[str, Component]) -> bool:
        def reaches(start: str, goal: str, seen: set[str]) -> bool:
            if start not in chosen or start in seen:
                return False
            for port in chosen[start].inputs:
                assert port.source is not None
                if port.source.function == goal or reaches(
                    port.source.function, goal, seen | {start}
                ):
                    return True
            return False

        return any(reaches(text, text, set()) for text in chosen)

    def extend(chosen: dict[str, Component], agenda: list[str]) -> dict[str, Component] | None:
        agenda = [text for text in agenda if text not in chosen]
        if not agenda:
            return chosen
        for candidate in robot.functions[agenda[0]].components:
            if candidate.name in world.missing:
                continue
            trial = {**chosen, agenda[0]: candidate}
            if fits(trial):
                wanted = [p.source.function for p in candidate.inputs if p.source is not None]
                found = extend(trial, [*wanted, *agenda[1:]])
                if found is not None:
                    return found
        return None

    found = extend({}, [name])
    return None if found is None else {key: c.name for key, c in found.items()}


@given(robots(), worlds)
def test_the_plan_is_the_first_of_plain_backtracking(robot: Robot, world: World) -> None:
    expected = plain_backtracking(robot, world, "f")
    try:
        plan = Resolver(robot, world, world.check).resolve("f")
    except NoPlanError as error:
        assert expected is None, str(error)
        assert error.rejections
        return
    assert {step.component.function: step.component.name for step in plan.steps} == expected


@given(robots(), worlds)
def test_a_plan_is_ordered_whole_and_deterministic(robot: Robot, world: World) -> None:
    try:
        plan = Resolver(robot, world, world.check).resolve("f")
    except NoPlanError:
        return
    assert plan == Resolver(robot, world, world.check).resolve("f")
    assert plan.provider.component.function == "f"
    place = {step.component.name: n for n, step in enumerate(plan.steps)}
    assert all(place[edge.producer] < place[edge.consumer] for edge in plan.edges)
    assert len(plan.edges) == sum(len(step.component.inputs) for step in plan.steps)
    assert plan.function in str(plan)


def test_a_chain_of_ten_thousand_resolves() -> None:
    functions = {
        f"f{n}": Function(f"f{n}", (component(f"f{n}", 0, (f"f{n + 1}",) if n < 9999 else ()),))
        for n in range(10_000)
    }
    world = World(frozenset(), frozenset())
    resolver = Resolver(Robot({}, functions), world, world.check, clock=ManualClock())
    assert len(resolver.resolve("f0").steps) == 10_000


def test_hopeless_branches_are_not_tried_again_and_again() -> None:
    """Twenty functions of three candidates each, all of which need what nothing provides."""
    functions = {"none": Function("none", (component("none", 0, ()),))}
    for n in range(20):
        below = f"f{n + 1}" if n < 19 else "none"
        made = tuple(component(f"f{n}", i, (below,)) for i in range(3))
        functions[f"f{n}"] = Function(f"f{n}", made)
    world = World(frozenset({"none0"}), frozenset())
    with pytest.raises(NoPlanError):
        Resolver(Robot({}, functions), world, world.check, budget=1000).resolve("f0")


def test_a_search_without_end_is_given_up() -> None:
    functions = {"f": Function("f", tuple(component("f", n, ("f",)) for n in range(50)))}
    world = World(frozenset(), frozenset())
    with pytest.raises(ResolutionError, match="given up"):
        Resolver(Robot({}, functions), world, world.check, budget=10).resolve("f")


def test_what_was_passed_over_is_said_with_its_reason() -> None:
    first, second = component("f", 0, ()), component("f", 1, ())
    robot = Robot({}, {"f": Function("f", (first, second))})
    world = World(frozenset({"f0"}), frozenset())
    plan = Resolver(robot, world, world.check).resolve("f")
    assert plan.rejected[0].component == "f0"
    assert "it is not there" in str(plan)


def test_a_plan_is_kept_until_it_is_invalidated() -> None:
    robot = Robot({}, {"f": Function("f", (component("f", 0, ()),))})
    world = World(frozenset(), frozenset())
    resolver = Resolver(robot, world, world.check)
    plan = resolver.resolve("f")
    assert resolver.resolve("f") is plan
    resolver.invalidate({"f0"})
    assert resolver.resolve("f") is not plan


def test_many_components_are_forgotten_at_once() -> None:
    """Of a bridge that dies with thousands, each plan is looked at once."""
    functions = {f"f{n}": Function(f"f{n}", (component(f"f{n}", 0, ()),)) for n in range(100)}
    robot = Robot({}, functions)
    world = World(frozenset(), frozenset())
    resolver = Resolver(robot, world, world.check)
    plans = {name: resolver.resolve(name) for name in functions}
    lost = {f"f{n}0" for n in range(50)}
    resolver.invalidate(lost)
    for name, plan in plans.items():
        assert (resolver.known(name) is plan) == (plan.provider.component.name not in lost)


def test_other_functions_let_only_those_plans_be_sought_anew_that_they_concern() -> None:
    functions = {
        "f": Function("f", (component("f", 0, ("g",)),)),
        "g": Function("g", (component("g", 0, ("h",)),)),
        "h": Function("h", (component("h", 0, ()),)),
        "other": Function("other", (component("other", 0, ("shared",)),)),
        "shared": Function("shared", (component("shared", 0, ()),)),
    }
    world = World(frozenset(), frozenset())
    resolver = Resolver(Robot({}, functions), world, world.check)
    before = {name: resolver.resolve(name) for name in functions}
    changed = Function("h", (component("h", 0, ()), component("h", 1, ())))
    resolver.use({**functions, "h": changed, "new": Function("new", (component("new", 0, ()),))})
    assert [name for name in functions if resolver.known(name) is None] == ["f", "g", "h"]
    assert resolver.resolve("other") is before["other"]
    assert resolver.resolve("new").provider.component.name == "new0"


def two_candidates() -> Robot:
    return Robot({}, {"f": Function("f", (component("f", 0, ()), component("f", 1, ())))})


class Slow(World):
    """Every question about what is missing takes time."""

    def __init__(self, clock: ManualClock, seconds: float) -> None:
        super().__init__(frozenset({"f0"}), frozenset())
        self.clock, self.seconds = clock, seconds

    def structures(self, component: Component) -> Structures | Unavailable:
        found = super().structures(component)
        if isinstance(found, Unavailable):
            self.clock.advance(self.seconds)
        return found


@pytest.mark.parametrize(("seconds", "patience"), [(0.0, 1.0), (0.5, 5.0), (20.0, 30.0)])
def test_what_was_not_there_is_looked_for_again(seconds: float, patience: float) -> None:
    clock = ManualClock()
    world = Slow(clock, seconds)
    resolver = Resolver(two_candidates(), world, world.check, clock=clock)
    spare = resolver.resolve("f")
    assert spare.provider.component.name == "f1"
    world.missing = frozenset()
    clock.advance(patience - 0.01)
    assert resolver.resolve("f") is spare
    clock.advance(0.02)
    assert resolver.known("f") is None
    better = resolver.resolve("f")
    assert better.provider.component.name == "f0"
    clock.advance(1e9)
    assert resolver.resolve("f") is better


def test_what_does_not_fit_is_not_tried_again_until_something_changes() -> None:
    clock = ManualClock()
    functions = {
        "f": Function("f", (component("f", 0, ("g",)), component("f", 1, ("g",)))),
        "g": Function("g", (component("g", 0, ()),)),
    }
    world = World(frozenset(), frozenset({(1, 1)}))
    resolver = Resolver(Robot({}, functions), world, world.check, clock=clock)
    plan = resolver.resolve("f")
    assert len(plan.rejected) == 1
    clock.advance(1e9)
    assert resolver.resolve("f") is plan


class Heavy(World):
    """Every check of an edge takes a second, and the structures of each are others."""

    def __init__(self, clock: ManualClock) -> None:
        super().__init__(frozenset(), frozenset())
        self.clock = clock

    def structures(self, component: Component) -> Structures | Unavailable:
        kind = MessageStructure({"const": component.name})
        ports = {f"input.{input_.name}": kind for input_ in component.inputs}
        return Structures({**ports, "output.default": kind})

    def check(
        self,
        producer: MessageStructure,
        consumer: MessageStructure,
        mapping: Mapping[str, object] | None,
        allow_loss: tuple[str, ...],
        meaning: Meaning,
    ) -> Verdict:
        self.clock.advance(1.0)
        return Verdict(compatible=True)


def test_checks_that_take_too_long_are_given_up_and_the_edge_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(_search, "_CHECK_SECONDS", 30.0)
    functions = {
        f"f{n}": Function(f"f{n}", (component(f"f{n}", 0, (f"f{n + 1}",) if n < 49 else ()),))
        for n in range(50)
    }
    clock = ManualClock()
    world = Heavy(clock)
    resolver = Resolver(Robot({}, functions), world, world.check, clock=clock)
    with pytest.raises(ResolutionError, match=r"took 31 s.*f310.default -> f300\..*1.0 s"):
        resolver.resolve("f0")
    assert len(resolver.resolve("f20").steps) == 30  # what was checked is known
