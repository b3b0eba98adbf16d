"""The resolver: the plan for a function, found once and kept until something changes."""

from __future__ import annotations

import difflib
import math
import threading
import time
from collections.abc import Callable, Collection, Mapping

from attrs import frozen

from uoarm._resolve._catalogue import EdgeCheck, StructureCatalogue
from uoarm._resolve._proofs import EdgeChecks
from uoarm._resolve._search import Search
from uoarm.config import fed_by
from uoarm.errors import ResolutionError
from uoarm.model import Function, Plan, Rejection, Robot, format_rejections

__all__ = ["NoPlanError", "Resolver"]

_BUDGET = 1_000_000
_SEARCHES = 3
# A candidate that was not there is looked for again after ten times as long as asking for it took.
_PATIENCE = 10.0
_LEAST_SECONDS, _MOST_SECONDS = 1.0, 30.0


class NoPlanError(ResolutionError):
    """No plan satisfies a request.

    Attributes:
        function: the function asked for.
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
        robot: the configuration.
        catalogue: knows the structures of components.
        check_edge: judges edges.
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
            close = difflib.get_close_matches(name, self._functions, n=1)
            hint = f"; did you mean {close[0]!r}?" if close else ""
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
