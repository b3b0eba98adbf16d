"""Replacements: plans that can go on behind the handle of a plan whose component died."""

from __future__ import annotations

from collections.abc import Callable

from uoarm._adapt import check_edge
from uoarm.errors import ResolutionError
from uoarm.model import MessageStructure, Plan

__all__ = ["Resolve", "find_replacement"]

_TRIES = 50

Resolve = Callable[[str, frozenset[str]], Plan]
"""Resolves a function without the components of these names, or raises ResolutionError."""


def find_replacement(
    plan: Plan,
    output: str | None,
    excluded: frozenset[str],
    failed: tuple[str, ...],
    resolve: Resolve,
) -> Plan:
    """Return the plan of highest priority that the application cannot tell from its own.

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
    while True:
        try:
            return _find(plan, output, excluded.union(failed), resolve)
        except ResolutionError:
            if not failed:
                raise
            failed = failed[1:]


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
        told = _refusal(found, old.structures[f"output.{output}"])
        if told:
            return f"its output {output!r} is another: {told}"
    taken = {port.name for port in new.component.inputs if port.source is None}
    for port in old.component.inputs:
        if port.source is not None:
            continue
        if port.name not in taken:
            return f"it has no input {port.name!r} for the application"
        key = f"input.{port.name}"
        told = _refusal(old.structures[key], new.structures[key])
        if told:
            return f"its input {port.name!r} is another: {told}"
    return ""


def _refusal(producer: MessageStructure, consumer: MessageStructure) -> str:
    if producer == consumer:
        return ""
    verdict = check_edge(producer, consumer)
    if verdict.compatible:
        return ""
    return "; ".join(f"{one.path or 'message'}: {one.sentence}" for one in verdict.reasons[:3])
