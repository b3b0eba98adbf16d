"""Requests: from the name of a function to its plan, and to a connection that runs."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import partial
from typing import Any

from uoarm import _bounded
from uoarm._control.connection import Connection
from uoarm._control.discovery.candidate_watch import CandidateWatch
from uoarm._control.live.connection_runtime import ConnectionRuntime
from uoarm._control.reconciler.events import Requested
from uoarm._control.reconciler.state import recently
from uoarm._control.runtime.event_dispatcher import EventDispatcher
from uoarm._control.runtime.executor import Executor
from uoarm._control.runtime.revisions import Revision, Revisions
from uoarm._dataplane import Clock
from uoarm._hints.applications import MessageType
from uoarm._spans import span
from uoarm.errors import UsageError
from uoarm.model import (
    Health,
    MessageStructure,
    Plan,
    PortRef,
    QueuePolicy,
    ValidationMode,
)

__all__ = ["Requests"]


class Requests:
    """Finds plans and opens connections, for any thread.

    Args:
        revisions: of the configuration, in which plans are found.
        executor: opens what a plan needs.
        candidates: of functions with needs; the first round of discovery is waited for.
        events: where what a callback raises is told.
        clock: seconds.
    """

    def __init__(
        self,
        revisions: Revisions,
        executor: Executor,
        candidates: CandidateWatch,
        events: EventDispatcher,
        clock: Clock,
    ) -> None:
        self._revisions = revisions
        self._executor = executor
        self._candidates = candidates
        self._events = events
        self._clock = clock
        self._numbers = itertools.count(1)

    def resolve(self, name: str, timeout: float) -> Plan:
        """Return the plan that `open` would open; errors are those of `RobotManager.resolve`."""
        left = self._candidates.wait(timeout)
        function = _reference(name).function
        revision = self._revisions.current
        known = self._known(function, revision)
        if known is not None:
            return known
        avoided = recently(self._executor.state.avoided, self._clock())
        with span("resolve", function=function):
            return _bounded.run(
                f"resolving {function!r}",
                left,
                lambda: revision.resolve(function, avoided=avoided),
            )

    def open(
        self,
        name: str,
        as_type: Any,
        mode: ValidationMode,
        queue: QueuePolicy,
        on_message: Callable[[Any], None] | None,
        timeout: float,
    ) -> Connection[Any]:
        """Open a function's whole plan; errors are those of `RobotManager.request`."""
        wanted = _reference(name)
        left = self._candidates.wait(timeout)
        wanted_type = self._typed(as_type, name, left)
        revision = self._revisions.current
        identity = f"c{next(self._numbers)}"
        report = partial(self._events.post, f"connection {identity}", Health.DEGRADED.value)
        runtime = ConnectionRuntime(identity, queue, report)
        if on_message is not None:
            take = on_message if wanted_type is None else wanted_type.callback(on_message)
            runtime.receiver.inbox.subscribe(take)
        event = Requested(
            runtime.id,
            wanted,
            mode,
            waiter=f"request {runtime.id}",
            plan=self._known(wanted.function, revision),
            is_heard=on_message is not None,
            revision=revision.number,
            candidates=revision.candidates,
        )
        connection = Connection(runtime, self._executor, wanted_type)
        self._executor.request(runtime, event, f"request for {name!r}", left)
        if wanted_type is not None:
            try:  # of the plan that was opened, which may be another one than was found above
                wanted_type.require(_given(connection.plan, connection.output, name).schema)
            except UsageError:
                connection.kill()
                raise
        return connection

    def _typed(self, hint: Any, name: str, timeout: float) -> MessageType[Any] | None:
        """Return the type that an application wants, proven to be what the function gives."""
        if hint is None:
            return None
        wanted: MessageType[Any] = MessageType(hint, f"function {name!r}")
        reference = _reference(name)
        plan = self.resolve(reference.function, timeout=timeout)
        wanted.require(_given(plan, reference.port, name).schema)
        return wanted

    def _known(self, function: str, revision: Revision) -> Plan | None:
        """Return the plan that was found before, unless it may use what is avoided now."""
        avoided = recently(self._executor.state.avoided, self._clock())
        return None if avoided else revision.resolver.known(function)


def _given(plan: Plan, output: str | None, name: str) -> MessageStructure:
    """Return the structure of the messages that an application receives of a plan."""
    component = plan.provider.component
    given = component.output(output)
    if given is None:
        names = ", ".join(item.name for item in component.outputs)
        has = (
            f"has the outputs {names}" if names else "has no output, so that `as_type` says nothing"
        )
        raise UsageError(f"function {name!r} {has}")
    return plan.provider.structures[f"output.{given.name}"]


def _reference(name: str) -> PortRef:
    """Read `function` or `function.output`."""
    function, dot, port = name.partition(".")
    return PortRef(function, port if dot else None)
