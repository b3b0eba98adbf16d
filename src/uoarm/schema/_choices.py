"""Judging the ways of a choice before any is tried, and the order in which choices are tried."""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeAlias

from uoarm.schema._array_view import ArrayView
from uoarm.schema._branch import Branch, Choice
from uoarm.schema._expand import expand
from uoarm.schema._objects import ObjectView
from uoarm.schema._results import Result
from uoarm.schema._solve import Goal, Solver, State
from uoarm.schema._tags import contradicts, tags_of

View: TypeAlias = "ObjectView | ArrayView"
__all__ = ["judge", "rank"]

Judged: TypeAlias = Generator[Goal, Result, "list[Branch] | None"]
Holds: TypeAlias = Generator[Goal, Result, "bool | None"]


def rank(choice: Choice) -> tuple[bool, int]:
    """Return what orders choices: tagged unions first, since each of their ways settles most."""
    tagged = all(any(s and tags_of(n) for n, s in way.literals) for way in choice.ways)
    return not tagged, len(choice.ways)


def judge(solver: Solver, state: State, view: View | None, choice: Choice, *, many: bool) -> Judged:
    """Return the branches that may still hold, or None when the choice holds already."""
    if choice.refused is not None and contradicts(state.tags, choice.refused):
        return None
    alive: list[Branch] = []
    for number, branch in enumerate(choice.ways):
        if not number % 64:
            solver.spend()
        single = len(branch.atoms) + len(branch.literals) == 1 and not branch.choices
        if not (branch.atoms or branch.literals or branch.choices):
            return None
        if single and branch.literals:
            holds = _literal_holds(state, branch)
        elif single and view is not None:
            holds = yield from view.judge(branch.atoms[0], many=many)
        else:
            holds = None if _may_hold(state, branch) else False
        if holds is True:
            return None
        if holds is None:
            alive.append(branch)
    return alive


def _may_hold(state: State, branch: Branch) -> bool:
    return all(
        (node.number, not sign) not in state.seen and not (sign and contradicts(state.tags, node))
        for node, sign in branch.literals
    )


def _literal_holds(state: State, branch: Branch) -> bool | None:
    """Return True when a single literal holds already, False when it cannot, None otherwise."""
    node, sign = branch.literals[0]
    if (node.number, sign) in state.seen:
        return True
    if node.unsupported:
        return None
    if not _may_hold(state, branch):
        return False
    if contradicts(state.tags, node):
        return True
    if not sign and node.kinds is not None and state.kind not in node.kinds:
        return True
    return False if expand((node, sign), state.kind) is None else None
