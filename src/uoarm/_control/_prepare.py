"""From a plan to a connection that only needs to be opened: which output, which checks."""

from __future__ import annotations

from uoarm._control._connection import Connection
from uoarm._control._course import Course
from uoarm._control._opening import OpenPlan
from uoarm._control._pool import Pool
from uoarm._dataplane import Clock, Route, make_check
from uoarm.errors import UsageError
from uoarm.model import Deliver, Plan, PortRef, QueuePolicy, ValidationMode

__all__ = ["prepare", "reference"]


def reference(name: str) -> PortRef:
    """Read `function` or `function.output`."""
    function, dot, port = name.partition(".")
    return PortRef(function, port if dot else None)


def prepare(
    plan: Plan,
    wanted: PortRef,
    identity: str,
    *,
    pool: Pool,
    validate: ValidationMode,
    queue: QueuePolicy,
    clock: Clock,
) -> Connection:
    """Return the connection of a plan; nothing is open yet.

    Raises:
        UsageError: the provider has several outputs and `wanted` does not say which.
    """
    output = _output(plan, wanted)
    opened = OpenPlan(plan, identity, pool, validate, clock)
    if output is None:
        return Connection(Course(identity, opened, queue))

    def receive(of: Plan, hand: Deliver) -> Route:
        place = f"{of.provider.component.name}.{output}"
        check = make_check(of.provider.structures[f"output.{output}"], validate, place)
        return Route(place, identity, hand, clock=clock, check=check)

    return Connection(Course(identity, opened, queue, output=output, receive=receive))


def _output(plan: Plan, wanted: PortRef) -> str | None:
    """Return the name of the output that the application receives, None where it has none."""
    component = plan.provider.component
    if not component.outputs and wanted.port is None:
        return None
    output = component.output(wanted.port)
    if output is None:
        names = ", ".join(f"{wanted.function}.{one.name}" for one in component.outputs)
        raise UsageError(f"say which output of {wanted.function!r} is meant: {names or 'none'}")
    return output.name
