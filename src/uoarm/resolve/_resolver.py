"""The resolver: the plan for a function, found once and kept until something changes."""

from __future__ import annotations

import difflib
import threading

from uoarm.errors import ResolutionError
from uoarm.model import Plan, Rejection, Robot
from uoarm.resolve._explain import tell_rejections
from uoarm.resolve._fit import Fit
from uoarm.resolve._protocols import Catalogue, EdgeCheck
from uoarm.resolve._search import Search

__all__ = ["NoPlanError", "Resolver"]

_BUDGET = 1_000_000


class NoPlanError(ResolutionError):
    """No plan satisfies a request.

    Attributes:
        function: the function asked for.
        rejections: its candidates, each with its reasons and what those rest on.
    """

    def __init__(self, function: str, rejections: tuple[Rejection, ...]) -> None:
        super().__init__(f"no component can provide {function!r}:\n{tell_rejections(rejections)}")
        self.function = function
        self.rejections = rejections


class Resolver:
    """Resolves functions of one robot. Thread safe; deterministic.

    Args:
        robot: the configuration.
        catalogue: knows the structures of components.
        check_edge: judges edges.
        budget: candidates tried at most in one search.
    """

    def __init__(
        self,
        robot: Robot,
        catalogue: Catalogue,
        check_edge: EdgeCheck,
        *,
        budget: int = _BUDGET,
    ) -> None:
        self._functions = robot.functions
        self._fit = Fit(catalogue, check_edge)
        self._budget = budget
        self._plans: dict[str, Plan] = {}
        self._lock = threading.Lock()

    def known(self, name: str) -> Plan | None:
        """Return the plan that was found before and still holds, None when it must be sought."""
        return self._plans.get(name)

    def resolve(self, name: str, *, excluded: frozenset[str] = frozenset()) -> Plan:
        """Return the plan of highest priority.

        Args:
            name: the function asked for.
            excluded: components that may not be used; such a plan is not kept.

        Raises:
            NoPlanError: nothing fits, or there is no such function.
            ResolutionError: the search was given up.
        """
        plan = self._plans.get(name)
        if plan is not None and not excluded:
            return plan
        if name not in self._functions:
            close = difflib.get_close_matches(name, self._functions, n=1)
            hint = f"; did you mean {close[0]!r}?" if close else ""
            raise ResolutionError(f"there is no function {name!r} in the configuration{hint}")
        found = Search(self._functions, self._fit, excluded, self._budget).run(name)
        if not isinstance(found, Plan):
            raise NoPlanError(name, found)
        if not excluded:
            with self._lock:
                self._plans[name] = found
        return found

    def invalidate(self, component: str | None = None) -> None:
        """Forget the plans that use a component, and those that passed something over.

        None forgets every plan. Edges stay judged: they depend on structures alone.
        """
        with self._lock:
            self._plans = {
                name: plan
                for name, plan in self._plans.items()
                if component is not None
                and not plan.rejected
                and all(step.component.name != component for step in plan.steps)
            }
