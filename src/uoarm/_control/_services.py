"""Services that raise: counted by name, since nothing of a service stays open between calls."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial

from uoarm._control._failure_watch import FailureWatch
from uoarm._dataplane import Clock
from uoarm._raised import is_raised
from uoarm.model import Component, ComponentStatus, FailureLimits, Health

__all__ = ["ServiceFailures"]


class ServiceFailures:
    """Watches the services that have raised, at most as many as are configured. Thread safe.

    Args:
        limits: gives when one is lost.
        clock: seconds.
        tell: told when the verdict on one changes.
        is_avoided: says whether one that was lost is still avoided; after that it has another
            chance.
    """

    def __init__(
        self,
        limits: Callable[[], FailureLimits],
        clock: Clock,
        tell: Callable[[Component, Health, str], None],
        is_avoided: Callable[[str], bool],
    ) -> None:
        self._limits = limits
        self._clock = clock
        self._tell = tell
        self._is_avoided = is_avoided
        self._lock = threading.Lock()
        self._watches: dict[str, tuple[Component, FailureWatch]] = {}

    def answered(self, component: Component) -> None:
        """Take in that a service replied."""
        found = self._watches.get(component.name)
        if found is None:
            return
        if found[1].health is Health.LOST:
            self._begin(component)
            self._tell(component, Health.OK, "it answers again")
        elif found[1].is_alert:
            found[1].took()

    def failed(self, component: Component, error: BaseException) -> None:
        """Take in that a call failed."""
        if not is_raised(error):
            return
        found = self._watches.get(component.name)
        if found is None or (
            found[1].health is Health.LOST and not self._is_avoided(component.name)
        ):
            self._begin(component)
        # Where the service ran in this process, what it raised itself is the cause.
        self._watches[component.name][1].raised("the service", error.__cause__ or error)

    def statuses(self) -> tuple[ComponentStatus, ...]:
        """Return what the status map shows of services that have raised."""
        return tuple(
            ComponentStatus(
                name=component.name,
                function=component.function,
                bridge=component.bridge,
                health=watch.health,
                users=(),
                cause=watch.cause,
                failed=watch.failed,
                last_error=watch.last_error,
            )
            for component, watch in tuple(self._watches.values())
        )

    def _begin(self, component: Component) -> None:
        """Judge a service afresh; what was counted stays."""
        watch = FailureWatch(
            component.name, self._limits(), self._clock, partial(self._tell, component)
        )
        with self._lock:
            before = self._watches.get(component.name)
            if before is not None:
                watch.failed, watch.last_error = before[1].failed, before[1].last_error
            self._watches[component.name] = component, watch
