"""Answering a goal: kind by kind, conjunctions first, then the choices with fewest ways left."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any, TypeAlias

from uoarm.schema._errors import OutOfScopeError
from uoarm.schema._values import Repeated, exact, is_small, kind_of, runs_of
from uoarm.schema.regex import TooLong, UnsupportedPatternError, shortest_word
from uoarm.schema.solve._arrays import ArrayView, array_leaf
from uoarm.schema.solve._branch import (
    UNSATISFIABLE,
    Branch,
    Choice,
    Result,
    Unknown,
    Unsatisfiable,
    Witness,
    contradicts,
    tags_of,
)
from uoarm.schema.solve._expand import expand
from uoarm.schema.solve._numbers import find_number, find_number_whole
from uoarm.schema.solve._objects import ObjectView, object_leaf
from uoarm.schema.solve._solver import Asking, Goal, SearchState, Solver, possible_kinds, try_values

View: TypeAlias = "ObjectView | ArrayView"

Judged: TypeAlias = Generator[Goal, Result, "list[Branch] | None"]


def _rank(choice: Choice) -> tuple[bool, int]:
    """Return what orders choices: tagged unions first, since each of their ways settles most."""
    tagged = all(any(s and tags_of(n) for n, s in way.literals) for way in choice.ways)
    return not tagged, len(choice.ways)


def _judge(
    solver: Solver, state: SearchState, view: View | None, choice: Choice, *, many: bool
) -> Judged:
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


def _may_hold(state: SearchState, branch: Branch) -> bool:
    return all(
        (node.number, not sign) not in state.seen and not (sign and contradicts(state.tags, node))
        for node, sign in branch.literals
    )


def _literal_holds(state: SearchState, branch: Branch) -> bool | None:
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


_MAX_TRIED = 200
_MAX_PLACES = 100_000


def answer(solver: Solver, goal: Goal) -> Asking:
    """Answer a goal; the generator yields sub-goals and is sent their results."""
    unknown: Unknown | None = None
    for kind in possible_kinds(goal):
        try:
            result = yield _of_kind(solver, SearchState(kind, goal))
        except OutOfScopeError as error:
            result = Unknown(str(error))
        except UnsupportedPatternError as error:
            result = Unknown(f"a pattern: {error}")
        except TooLong as error:
            result = Unknown(str(error))
        if isinstance(result, Witness):
            return result
        if isinstance(result, Unknown):
            unknown = result
    return unknown or UNSATISFIABLE


def _of_kind(solver: Solver, state: SearchState) -> Asking:
    if state.kind == "number" and any(node.applied() for node, _ in state.goal):
        try:
            return find_number_whole(state.goal, solver.spend)
        except OutOfScopeError:
            pass  # one way of several may still be within it
    if not state.add(Branch(literals=list(state.goal))):
        return UNSATISFIABLE
    if state.kind == "null":
        return try_values(solver, [None], state)
    if state.kind == "boolean":
        return try_values(solver, [False, True], state)
    return (yield _search(solver, state))


def _search(solver: Solver, state: SearchState) -> Asking:
    finite = [atom[1] for atom in state.atoms if atom[0] == "in"]
    if finite:
        smallest = min(finite, key=lambda node: len(node.values))  # type: ignore[attr-defined] # a node
        solver.spend(len(smallest.values) // 16)  # type: ignore[attr-defined] # a node
        return try_values(solver, smallest.values.values(), state)  # type: ignore[attr-defined] # a node
    if not _exclude_composites(solver, state):
        return UNSATISFIABLE
    while state.choices:
        solver.spend()
        view = _view(state)
        many = len(state.choices) > 1
        open_choices: list[Choice] = []
        forced: Branch | None = None
        for choice in state.choices:
            alive = yield from _judge(solver, state, view, choice, many=many)
            if alive is None:
                continue
            if not alive:
                return UNSATISFIABLE
            if len(alive) == 1 and forced is None:
                forced = alive[0]
                continue
            open_choices.append(Choice(alive, choice.refused))
        state.choices = open_choices
        if forced is not None:
            if not state.add(forced):
                return UNSATISFIABLE
            if any(atom[0] == "in" for atom in state.atoms):  # it is one of these values
                return (yield _search(solver, state))
            if not _exclude_composites(solver, state):
                return UNSATISFIABLE
            continue
        if not state.choices:
            break
        return (yield _branch(solver, state))
    return (yield from _leaf(solver, state))


def _view(state: SearchState) -> ObjectView | ArrayView | None:
    if state.kind == "object":
        return ObjectView(state.atoms)
    return ArrayView(state.atoms) if state.kind == "array" else None


def _branch(solver: Solver, state: SearchState) -> Asking:
    """Try the ways of the choice that has fewest, one after another."""
    settled = yield from _without_choices(solver, state)
    if settled is not None:
        return settled
    position = min(range(len(state.choices)), key=lambda n: _rank(state.choices[n]))
    ways = state.choices.pop(position).ways
    unknown: Unknown | None = None
    for way in ways:
        solver.spend()
        trial = state.copy()
        try:
            if not trial.add(way):
                continue
        except OutOfScopeError as error:
            unknown = Unknown(str(error))
            continue
        octets = trial.octets()
        solver.meter.hold(octets)
        result = yield _search(solver, trial)
        solver.meter.release(octets)
        if isinstance(result, Witness):
            return result
        if isinstance(result, Unknown):
            unknown = result
    return unknown or UNSATISFIABLE


def _without_choices(
    solver: Solver, state: SearchState
) -> Generator[Goal | Asking, Result, Result | None]:
    """Leave the choices aside: there may be no value even so, or one that happens to do."""
    if any(atom[0] == "least" and atom[1] > _MAX_TRIED for atom in state.atoms):  # type: ignore[operator] # a size
        return None
    try:
        found = yield from _leaf(solver, state)
        if isinstance(found, Witness):
            if not is_small(found.value, _MAX_TRIED):
                return None
            found = try_values(solver, [found.value], state)
            return found if isinstance(found, Witness) else None
    except (OutOfScopeError, UnsupportedPatternError, TooLong):
        return None
    return found if isinstance(found, Unsatisfiable) else None


def _leaf(solver: Solver, state: SearchState) -> Asking:
    if state.kind == "number":
        excluded = frozenset(
            exact(value)
            for atom in state.atoms
            if atom[0] == "notin"
            for value in atom[1].values.values()  # type: ignore[attr-defined] # a node
            if kind_of(value) == "number"
        )
        solver.spend(len(excluded) // 16)
        return find_number([a for a in state.atoms if a[0] != "notin"], excluded, solver.spend)
    if state.kind == "string":
        return _find_string(solver, state)
    if state.kind == "array":
        return (yield from array_leaf(solver, state))
    return (yield from object_leaf(solver, state))


def _find_string(solver: Solver, state: SearchState) -> Result:
    least, most = 0, None
    tags = {atom[0] for atom in state.atoms}
    if "nul" in tags:
        return (
            UNSATISFIABLE  # what may be any text is taken to have no NUL; what is listed was tried
        )
    for tag, *rest in state.atoms:
        size: Any = rest[0] if rest else None
        if tag == "least":
            least = max(least, size)
        elif tag == "most":
            most = size if most is None else min(most, size)
    with solver.meter.part("patterns"):
        found = shortest_word(
            _patterns(state, "match"),
            _patterns(state, "nomatch"),
            least,
            most,
            [
                value
                for atom in state.atoms
                if atom[0] == "notin"
                for value in atom[1].values.values()  # type: ignore[attr-defined] # a node
                if isinstance(value, str)
            ],
            solver.meter,
            without_nul="nonul" in tags,
        )
    return UNSATISFIABLE if found is None else Witness(found)


def _patterns(state: SearchState, tag: str) -> list[Any]:
    return list(dict.fromkeys(atom[1] for atom in state.atoms if atom[0] == tag))


def _exclude_composites(solver: Solver, state: SearchState) -> bool:
    """Turn `is none of these arrays or objects` into choices about their parts."""
    if state.kind not in {"array", "object"}:
        return True
    for atom in [tuple_ for tuple_ in state.atoms if tuple_[0] == "notin"]:
        state.atoms.remove(atom)
        for key, value in atom[1].values.items():  # type: ignore[attr-defined] # a node
            if kind_of(value) != state.kind:
                continue
            solver.spend()
            shape = solver.make(f"shape of {key}", _shape(value))
            if not state.add(Branch(literals=[(shape, False)])):
                return False
    return True


def _shape(value: object) -> dict[str, object]:
    """Return a schema that only this array or object meets, without naming it whole."""
    if isinstance(value, dict):
        return {
            "properties": {name: {"const": element} for name, element in value.items()},
            "required": list(value),
            "additionalProperties": False,
        }
    assert isinstance(value, list | tuple | Repeated)
    size = len(value)
    shape: dict[str, object] = {"minItems": size, "maxItems": size}
    if size > _MAX_PLACES:
        raise TooLong(f"an array of {size:,} items would have to be distinguished from others")
    if size:
        items = [item for _, item, count in runs_of(value) for _ in range(count)]
        shape["prefixItems"] = [{"const": element} for element in items]
    return shape
