"""Availability: which components can be had now, and which of them a request would choose."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from uoarm._resolve import StructureCache, Unavailable
from uoarm.errors import ResolutionError
from uoarm.model import Availability, Component, FunctionStatus, Plan, Robot

__all__ = ["check_availability"]

_AT_ONCE = 16


def check_availability(
    robot: Robot, structures: StructureCache, resolve: Callable[[str], Plan]
) -> tuple[FunctionStatus, ...]:
    """Ask for every component, several at once, and resolve every function.

    Blocks as long as the slowest bridge takes to answer; each answer has its limit.
    """

    def ask(component: Component) -> Availability:
        answer = structures.structures(component)
        cause = answer.sentence if isinstance(answer, Unavailable) else ""
        return Availability(component.name, component.bridge, component.priority, cause)

    with ThreadPoolExecutor(_AT_ONCE, thread_name_prefix="uoarm-availability") as pool:
        found = {
            availability.component: availability
            for availability in pool.map(ask, robot.components())
        }
    return tuple(
        _judge(name, tuple(found[item.name] for item in function.components), resolve)
        for name, function in robot.functions.items()
    )


def _judge(
    name: str, candidates: tuple[Availability, ...], resolve: Callable[[str], Plan]
) -> FunctionStatus:
    try:
        plan = resolve(name)
    except ResolutionError as error:
        return FunctionStatus(name, None, candidates, str(error))
    return FunctionStatus(name, plan.provider.component.name, candidates)
