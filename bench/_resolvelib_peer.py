"""The same question put to `resolvelib`, pip's resolver: a yardstick, and a second opinion."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from attrs import frozen
from resolvelib import AbstractProvider, BaseReporter, ResolutionImpossible, Resolver

from uoarm._resolve import Catalogue, EdgeCheck, Structures
from uoarm.model import Component, Input, PortRef, Robot

__all__ = ["resolve_with_resolvelib"]

_ROUNDS = 100_000


@frozen
class _Requirement:
    """A function, and the input that it must fit; None for the application's own request."""

    function: str
    consumer: Component | None = None
    port: Input | None = None


class _Provider(AbstractProvider[Any, Any, str]):
    def __init__(self, robot: Robot, catalogue: Catalogue, check: EdgeCheck) -> None:
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
        bad = {one.name for one in incompatibilities[identifier]}
        return [
            one
            for one in self._robot.functions[identifier].components
            if one.name not in bad
            and isinstance(self._catalogue.structures(one), Structures)
            and all(self.is_satisfied_by(each, one) for each in wanted)
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
    robot: Robot, catalogue: Catalogue, check: EdgeCheck, name: str
) -> dict[str, str] | None:
    """Return component names by function, None when there is no plan. Knows nothing of cycles."""
    resolver = Resolver(_Provider(robot, catalogue, check), BaseReporter[Any, Any, str]())
    try:
        result = resolver.resolve([_Requirement(name)], max_rounds=_ROUNDS)
    except ResolutionImpossible:
        return None
    return {function: component.name for function, component in result.mapping.items()}
