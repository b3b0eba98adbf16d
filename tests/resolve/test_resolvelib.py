"""A second opinion: pip's resolver agrees on what can be resolved, and on the plan itself."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from attrs import frozen
from hypothesis import given
from hypothesis import strategies as st
from resolvelib import AbstractProvider, BaseReporter, ResolutionImpossible
from resolvelib import Resolver as OtherResolver
from tests.resolve.test_search import World, component

from uoarm._resolve import EdgeCheck, NoPlanError, Resolver, StructureCatalogue, Structures
from uoarm.model import Component, Function, Input, PortRef, Robot

_ROUNDS = 100_000


@frozen
class _Requirement:
    """A function, and the input that it must fit; None for the application's own request."""

    function: str
    consumer: Component | None = None
    port: Input | None = None


class _Provider(AbstractProvider[Any, Any, str]):
    def __init__(self, robot: Robot, catalogue: StructureCatalogue, check: EdgeCheck) -> None:
        self._robot = robot
        self._catalogue = catalogue
        self._check = check
        self._judged: dict[tuple[str, str, str], bool] = {}

    def identify(self, requirement_or_candidate: _Requirement | Component) -> str:
        return requirement_or_candidate.function

    def get_preference(self, identifier: str, *_: object, **__: object) -> str:
        return identifier

    def find_matches(
        self,
        identifier: str,
        requirements: Mapping[str, Iterator[_Requirement]],
        incompatibilities: Mapping[str, Iterator[Component]],
    ) -> Iterable[Component]:
        wanted = list(requirements[identifier])
        bad = {candidate.name for candidate in incompatibilities[identifier]}
        return [
            candidate
            for candidate in self._robot.functions[identifier].components
            if candidate.name not in bad
            and isinstance(self._catalogue.structures(candidate), Structures)
            and all(self.is_satisfied_by(requirement, candidate) for requirement in wanted)
        ]

    def is_satisfied_by(self, requirement: _Requirement, candidate: Component) -> bool:
        """Judge each edge once, as ours does."""
        consumer, port = requirement.consumer, requirement.port
        if consumer is None or port is None:
            return True
        key = candidate.name, consumer.name, port.name
        if key not in self._judged:
            self._judged[key] = self._fits(candidate, consumer, port)
        return self._judged[key]

    def _fits(self, candidate: Component, consumer: Component, port: Input) -> bool:
        assert port.source is not None
        output = candidate.output(port.source.port)
        sent = self._catalogue.structures(candidate)
        taken = self._catalogue.structures(consumer)
        if output is None or not isinstance(sent, Structures) or not isinstance(taken, Structures):
            return False
        return self._check(
            sent.by_port[f"output.{output.name}"],
            taken.by_port[f"input.{port.name}"],
            port.mapping,
            port.allow_loss,
            port.meaning,
        ).compatible

    def get_dependencies(self, candidate: Component) -> Iterable[_Requirement]:
        fed: list[tuple[PortRef, Input]] = [
            (port.source, port) for port in candidate.inputs if port.source is not None
        ]
        return [_Requirement(source.function, candidate, port) for source, port in fed]


def resolve_with_resolvelib(
    robot: Robot, catalogue: StructureCatalogue, check: EdgeCheck, name: str
) -> dict[str, str] | None:
    """Return component names by function, None when there is no plan. Knows nothing of cycles."""
    resolver = OtherResolver(_Provider(robot, catalogue, check), BaseReporter[Any, Any, str]())
    try:
        result = resolver.resolve([_Requirement(name)], max_rounds=_ROUNDS)
    except ResolutionImpossible:
        return None
    return {function: component.name for function, component in result.mapping.items()}


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
