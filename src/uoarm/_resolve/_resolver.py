"""The resolver: the plan for a function, found once and kept until something changes.

A plan that can take the place of another is found here, too.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping

from attrs import frozen

from uoarm._adapt import check_edge
from uoarm._resolve._catalogue import EdgeCheck, StructureCatalogue
from uoarm._resolve._proofs import EdgeChecks
from uoarm._resolve._search import Search
from uoarm._spelling import did_you_mean
from uoarm.config import fed_by
from uoarm.errors import ResolutionError
from uoarm.model import (
    Function,
    MessageStructure,
    Plan,
    Rejection,
    Robot,
    format_rejections,
)

Resolve = Callable[[str, frozenset[str]], Plan]
"""Resolves a function without the components of these names, or raises ResolutionError."""

_BUDGET = 1_000_000
_SEARCHES = 3
_TRIES = 50
# A candidate that was not there is looked for again after ten times as long as asking for it took.
_PATIENCE = 10.0
_LEAST_SECONDS, _MOST_SECONDS = 1.0, 30.0


class NoPlanError(ResolutionError):
    """No plan satisfies a request.

    Attributes:
        rejections: its candidates, each with its reasons and what those rest on.
        is_unavailable: whether a component that was tried was not available: once it is, there may
            be a plan.
    """

    def __init__(
        self,
        function: str,
        rejections: tuple[Rejection, ...],
        *,
        is_unavailable: bool = False,
    ) -> None:
        super().__init__(f"no component can provide {function!r}:\n{format_rejections(rejections)}")
        self.function = function
        self.rejections = rejections
        self.is_unavailable = is_unavailable


@frozen
class _CachedPlan:
    """A plan, and the time from which on it must be sought anew."""

    plan: Plan
    until: float


class Resolver:
    """Resolves functions of one robot. Thread safe; deterministic.

    Args:
        catalogue: knows the structures of components.
        budget: candidates tried at most in one search.
        clock: a monotonic clock, in seconds.
    """

    def __init__(
        self,
        robot: Robot,
        catalogue: StructureCatalogue,
        check_edge: EdgeCheck,
        *,
        budget: int = _BUDGET,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._functions = robot.functions
        self._fit = EdgeChecks(catalogue, check_edge)
        self._budget = budget
        self._clock = clock
        self._plans: dict[str, _CachedPlan] = {}
        self._revision = 0
        self._lock = threading.Lock()

    def known(self, name: str) -> Plan | None:
        """Return the plan that was found before and still holds, None when it must be sought.

        One that passed over a candidate because it was not there holds for a second, or for ten
        times as long as asking for that candidate took, half a minute at most.
        """
        kept = self._plans.get(name)
        if kept is None or (kept.until < math.inf and kept.until <= self._clock()):
            return None
        return kept.plan

    def resolve(self, name: str, *, excluded: frozenset[str] = frozenset()) -> Plan:
        """Return the plan of highest priority.

        Args:
            name: the function asked for.
            excluded: components that may not be used; such a plan is not kept.

        Raises:
            NoPlanError: nothing fits, or there is no such function.
            ResolutionError: the search was given up.
        """
        plan = self.known(name)
        if plan is not None and not excluded:
            return plan
        if name not in self._functions:
            hint = did_you_mean(name, self._functions)
            text = f"there is no function {name!r} in the configuration{hint}"
            raise ResolutionError(text, error_code="UOA-202")
        # What is invalidated meanwhile may be in the plan: it is sought anew, and not kept when
        # there is no end of that.
        for _ in range(_SEARCHES):
            revision = self._revision
            search = Search(self._functions, self._fit, excluded, self._budget, self._clock)
            found = search.run(name)
            if revision == self._revision:
                break
        if not isinstance(found, Plan):
            raise NoPlanError(name, found, is_unavailable=search.seconds_unavailable is not None)
        if not excluded:
            until = self._until(search.seconds_unavailable)
            with self._lock:
                if revision == self._revision:
                    self._plans[name] = _CachedPlan(found, until)
        return found

    def invalidate(self, components: Collection[str]) -> None:
        """Forget the plans that use one of these, and those that passed something over.

        Edges stay judged: they depend on structures alone.
        """
        with self._lock:
            self._revision += 1
            self._plans = {
                name: kept
                for name, kept in self._plans.items()
                if not kept.plan.rejected
                and all(step.component.name not in components for step in kept.plan.steps)
            }

    def use(self, functions: Mapping[str, Function]) -> None:
        """Resolve other functions from now on.

        Plans are kept whose functions, and all that may feed those, are the same.
        """
        with self._lock:
            # In this order: a search that begins meanwhile must not take old functions for new.
            before, self._functions = self._functions, functions
            self._revision += 1
            changed = {
                function
                for function in {*before, *functions}
                if before.get(function) != functions.get(function)
            }
            # What is fed by what is the same has the same feeds before and after.
            components = (
                component for function in before.values() for component in function.components
            )
            gone = fed_by(changed, components)
            self._plans = {name: plan for name, plan in self._plans.items() if name not in gone}

    def _until(self, seconds_unavailable: float | None) -> float:
        if seconds_unavailable is None:
            return math.inf
        seconds = max(_LEAST_SECONDS, min(_MOST_SECONDS, _PATIENCE * seconds_unavailable))
        return self._clock() + seconds


def find_replacement(
    plan: Plan,
    output: str | None,
    excluded: frozenset[str],
    failed: tuple[str, ...],
    resolve: Resolve,
) -> Plan:
    """Return the plan of highest priority that gives the application what its own gave.

    Its provider has the same output and inputs, emits nothing that the old one could not emit,
    and takes all that the old one took. What failed lately is used only where there is nothing
    else, and of that first what failed longest ago: a bridge may well find a component that does
    not do what is expected of it, so that being there again does not mean being well.

    Args:
        plan: the application's own.
        output: the output that the application receives, None where it receives none.
        excluded: components that may not be used.
        failed: components that failed lately, longest ago first.
        resolve: resolves a function.

    Raises:
        ResolutionError: there is none; the text says why each candidate is none.
    """
    failed = tuple(name for name in failed if name not in excluded)

    def found_without(*, first: int) -> Plan | None:
        try:
            return _find(plan, output, excluded.union(failed[first:]), resolve)
        except ResolutionError:
            return None

    found = found_without(first=0) if failed else None
    if found is not None:
        return found
    found = _find(plan, output, excluded, resolve)  # where even this fails, nothing helps
    # As few as possible of those that failed longest ago are allowed. What is found with fewer is
    # found with more, so that halving finds them: thousands may have died with one bridge.
    too_few, enough = 0, len(failed)
    while enough - too_few > 1:
        middle = (too_few + enough) // 2
        with_fewer = found_without(first=middle)
        if with_fewer is None:
            too_few = middle
        else:
            found, enough = with_fewer, middle
    return found


def _find(plan: Plan, output: str | None, excluded: frozenset[str], resolve: Resolve) -> Plan:
    unfit: list[str] = []
    for _ in range(_TRIES):
        try:
            found = resolve(plan.function, excluded)
        except ResolutionError as error:
            raise ResolutionError("\n".join([*unfit, str(error)])) from error
        difference = _difference(plan, found, output)
        if not difference:
            return found
        name = found.provider.component.name
        unfit.append(f"component {name!r} is no replacement: {difference}")
        excluded |= {name}
    raise ResolutionError("\n".join(unfit))


def _difference(dead: Plan, plan: Plan, output: str | None) -> str:
    """Say what the application would notice, or nothing."""
    old, new = dead.provider, plan.provider
    if output is not None:
        found = new.structures.get(f"output.{output}")
        if found is None:
            return f"it has no output {output!r}"
        text = _refusal(found, old.structures[f"output.{output}"])
        if text:
            return f"its output {output!r} is another: {text}"
    taken = {port.name for port in new.component.inputs if port.source is None}
    for port in old.component.inputs:
        if port.source is not None:
            continue
        if port.name not in taken:
            return f"it has no input {port.name!r} for the application"
        key = f"input.{port.name}"
        text = _refusal(old.structures[key], new.structures[key])
        if text:
            return f"its input {port.name!r} is another: {text}"
    return ""


def _refusal(producer: MessageStructure, consumer: MessageStructure) -> str:
    if producer == consumer:
        return ""
    verdict = check_edge(producer, consumer)
    if verdict.compatible:
        return ""
    return "; ".join(
        f"{reason.path or 'message'}: {reason.sentence}" for reason in verdict.reasons[:3]
    )


def reachable_functions(functions: Mapping[str, Function], name: str) -> Iterator[Function]:
    """Yield a function and all that may feed it, as far as they are configured."""
    seen, sought = {name}, [name]
    while sought:
        function = functions.get(sought.pop())
        if function is None:
            continue
        yield function
        ports = [port for component in function.components for port in component.inputs]
        sources = {port.source.function for port in ports if port.source is not None}
        sought += sources - seen
        seen |= sources


def reachable_components(functions: Mapping[str, Function], name: str) -> frozenset[str]:
    """Return the names of all components that a plan of a function may have."""
    reached = reachable_functions(functions, name)
    return frozenset(component.name for function in reached for component in function.components)
