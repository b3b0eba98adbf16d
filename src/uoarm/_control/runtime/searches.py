"""Searches for plans of connections that run, and the events that answer them.

Among them are replacements: plans that can go on behind the handle of one whose component died.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection
from typing import Protocol

from uoarm._adapt import check_edge
from uoarm._control.reconciler import actions as act
from uoarm._control.reconciler import events as ev
from uoarm._control.reconciler.state import names
from uoarm.errors import ResolutionError, UoarmError
from uoarm.model import MessageStructure, Plan

__all__ = ["Resolve", "check_preferred", "find_replacement", "seek_replacement"]

_TRIES = 50
_log = logging.getLogger("uoarm")

Resolve = Callable[[str, frozenset[str]], Plan]
"""Resolves a function without the components of these names, or raises ResolutionError."""


class Resolving(Protocol):
    """A revision of the configuration, in which plans are found."""

    @property
    def candidates(self) -> int:
        """How many changes of candidates there were in it."""

    def resolve(
        self, name: str, excluded: frozenset[str] = ..., avoided: frozenset[str] = ...
    ) -> Plan:
        """Return the best plan; raises ResolutionError."""

    def forget(self, components: Collection[str]) -> None:
        """Ask for the structures of components again the next time."""


def seek_replacement(action: act.FindReplacement, revision: Resolving) -> ev.ReplacementSought:
    """Look for a plan that the application cannot tell from its own."""
    asked = action.connection, action.attempt
    try:
        plan = find_replacement(
            action.plan,
            action.output,
            action.excluded,
            action.failed,
            lambda name, excluded: revision.resolve(name, excluded, action.avoided),
        )
    except Exception as error:  # noqa: BLE001 - the state learns of it whatever it is
        if not isinstance(error, UoarmError):
            _log.exception("looking for a replacement failed")
        return ev.ReplacementSought(*asked, None, str(error), action.switchover)
    return ev.ReplacementSought(
        *asked, plan, switchover=action.switchover, candidates=revision.candidates
    )


def check_preferred(action: act.CheckPreferred, revision: Resolving) -> ev.PreferredChecked:
    """See whether a plan is what a request would get now."""
    wanted = names(action.plan)
    revision.forget(wanted)
    try:
        found = names(revision.resolve(action.plan.function, avoided=action.avoided))
    except Exception as error:  # noqa: BLE001 - the state learns of it whatever it is
        if not isinstance(error, UoarmError):
            _log.exception("looking for a preferred plan failed")
        found = ()
    return ev.PreferredChecked(action.connection, found == wanted)


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
