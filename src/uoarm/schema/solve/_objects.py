"""Finding an object: which names it has, and a value for each."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Sequence
from typing import Any, TypeAlias

from uoarm.schema.read import SchemaNode
from uoarm.schema.regex import TooLong, found_in
from uoarm.schema.solve._branch import (
    UNSATISFIABLE,
    Atom,
    Literal,
    Result,
    Unknown,
    Unsatisfiable,
    Witness,
)
from uoarm.schema.solve._evaluate import accepts, named_rules
from uoarm.schema.solve._solver import Asking, Goal, SearchState, Solver

Verdict: TypeAlias = Generator[Goal, Result, "bool | None"]
_MAX_CLASSES = 8
_MAX_FILL = 3_000


class ObjectView:
    """The demands on an object, arranged by name."""

    def __init__(self, atoms: Iterable[Atom]) -> None:
        self.members: dict[str, list[Literal]] = {}
        self.patterns: list[tuple[str, Literal]] = []
        self.rests: list[tuple[SchemaNode, Literal]] = []
        self.names: list[Literal] = []
        self.has: dict[str, None] = {}
        self.lacks: set[str] = set()
        self.least = 0
        self.most: int | None = None
        self.demands: list[Atom] = []
        for atom in atoms:
            self._take(atom)

    def _take(self, atom: Atom) -> None:
        tag, rest = atom[0], atom[1:]
        operand: Any = rest[0]
        if tag == "member":
            self.members.setdefault(operand, []).append(rest[1])  # type: ignore[arg-type] # a literal
        elif tag == "pattern":
            self.patterns.append((operand, rest[1]))  # type: ignore[arg-type] # a literal
        elif tag == "rest":
            self.rests.append((operand, rest[1]))  # type: ignore[arg-type] # a literal
        elif tag == "names":
            self.names.append(operand)
        elif tag == "has":
            self.has[operand] = None
        elif tag == "lacks":
            self.lacks.add(operand)
        elif tag == "least":
            self.least = max(self.least, operand)
        elif tag == "most":
            self.most = operand if self.most is None else min(self.most, operand)
        elif tag == "somemember":
            self.has[operand] = None
            self.members.setdefault(operand, []).append(rest[1])  # type: ignore[arg-type] # a literal
        else:
            self.demands.append(atom)

    def literals(self, name: str) -> Goal:
        """Return what the value of a name must meet."""
        found = list(self.members.get(name, ()))
        found += [
            literal
            for pattern, literal in self.patterns
            if found_in(pattern, name, literal[0].document.meter.spend)
        ]
        found += [literal for node, literal in self.rests if not named_rules(node, name)]
        return tuple(found)

    def allows(self, name: str) -> bool:
        return name not in self.lacks and all(
            accepts(node, name) == sign for node, sign in self.names
        )

    def judge(self, atom: Atom, *, many: bool) -> Verdict:
        """Return True when an atom holds already, False when it cannot, None otherwise."""
        tag: object = atom[0]
        name: Any = atom[1]
        if tag == "lacks":
            return False if name in self.has else (True if name in self.lacks else None)
        if tag == "has":
            if name in self.has:
                return True
            if not self.allows(name):
                return False
            result = yield self.literals(name)
            return False if isinstance(result, Unsatisfiable) else None
        if tag == "somemember":
            if not self.allows(name):
                return False
            literal: Any = atom[2]
            known = self.literals(name)
            result = yield (*known, literal)
            if isinstance(result, Unsatisfiable):
                return False
            if many and name in self.has:
                result = yield (*known, (literal[0], not literal[1]))
                return True if isinstance(result, Unsatisfiable) else None
            return None
        if tag == "least":
            return True if len(self.has) >= name else None
        if tag == "most":
            return False if len(self.has) > name else None
        return None


def object_leaf(solver: Solver, state: SearchState) -> Asking:
    """Answer a goal of which only atoms about an object are left."""
    view = ObjectView(state.atoms)
    if view.most is not None and (view.least > view.most or len(view.has) > view.most):
        return UNSATISFIABLE
    return (yield _meet_demands(solver, view, view.demands, {}))


def _meet_demands(
    solver: Solver, view: ObjectView, demands: Sequence[Atom], extra: dict[str, tuple[Literal, ...]]
) -> Asking:
    """Choose a name for each demand that some member must meet, then fill the object.

    One member may meet several. Names of a class are alike to every demand that is left, so that
    one of each class stands for all of them.
    """
    if not demands:
        return (yield from _fill(solver, view, extra))
    demand, rest = demands[0], demands[1:]
    tag: object = demand[0]
    literal: Any = demand[-1]
    if tag == "somename":
        wanted: list[Literal] = [literal]
    elif tag == "somepattern":
        wanted = [(_matching(solver, str(demand[1])), True)]
    else:
        wanted = _unnamed(solver, demand[1])  # type: ignore[arg-type] # a node
    needed: tuple[Literal, ...] = () if tag == "somename" else (literal,)
    unknown: Unknown | None = None
    known = list(dict.fromkeys((*view.has, *_mentioned(view), *extra)))
    for name in known:
        if not all(accepts(node, name) == sign for node, sign in wanted):
            continue
        result = yield _with_name(solver, view, rest, extra, name, needed)
        if isinstance(result, Witness):
            return result
        unknown = result if isinstance(result, Unknown) else unknown
    for kind in _name_classes(solver, view, rest):
        named = yield _name_goal(solver, view, [*wanted, *kind], known)
        if isinstance(named, Witness):
            result = yield _with_name(solver, view, rest, extra, named.value, needed)
            if isinstance(result, Witness):
                return result
            unknown = result if isinstance(result, Unknown) else unknown
        unknown = named if isinstance(named, Unknown) else unknown
    return unknown or UNSATISFIABLE


def _with_name(
    solver: Solver,
    view: ObjectView,
    rest: Sequence[Atom],
    extra: dict[str, tuple[Literal, ...]],
    name: str,
    needed: tuple[Literal, ...],
) -> Asking:
    solver.spend()
    literals = (*extra.get(name, ()), *needed)
    if not view.allows(name):
        return UNSATISFIABLE
    result = yield (*view.literals(name), *literals)
    if not isinstance(result, Witness):
        return result
    return (yield _meet_demands(solver, view, rest, {**extra, name: literals}))


def _fill(solver: Solver, view: ObjectView, extra: dict[str, tuple[Literal, ...]]) -> Asking:
    """Give every name that must be there a value, and add names until there are enough."""
    made: dict[str, Any] = {}
    for name in (*view.has, *(n for n in extra if n not in view.has)):
        if not view.allows(name):
            return UNSATISFIABLE
        result = yield (*view.literals(name), *extra.get(name, ()))
        if not isinstance(result, Witness):
            return result
        made[name] = result.value
    if view.most is not None and len(made) > view.most:
        return UNSATISFIABLE
    unknown: Unknown | None = None
    if len(made) < view.least:
        for name in _mentioned(view):
            if len(made) >= view.least:
                break
            if name not in made and view.allows(name):
                result = yield view.literals(name)
                if isinstance(result, Witness):
                    made[name] = result.value
                unknown = result if isinstance(result, Unknown) else unknown
    if len(made) < view.least:
        shortage = yield from _add_fresh(solver, view, made)
        if shortage is not None:
            return unknown or shortage
    return Witness(made)


def _add_fresh(
    solver: Solver, view: ObjectView, made: dict[str, Any]
) -> Generator[Goal, Result, Result | None]:
    """Add names that nothing mentions until there are enough; return why that cannot be done."""
    if view.least > _MAX_FILL:
        return Unknown(f"an object of {view.least:,} members would be needed")
    unknown: Unknown | None = None
    mentioned = _mentioned(view)
    for kind in _name_classes(solver, view):
        while len(made) < view.least:
            named = yield _name_goal(solver, view, kind, [*mentioned, *made])
            if not isinstance(named, Witness):
                unknown = named if isinstance(named, Unknown) else unknown
                break
            result = yield view.literals(named.value)
            if not isinstance(result, Witness):
                unknown = result if isinstance(result, Unknown) else unknown
                break
            made[named.value] = result.value
    return None if len(made) >= view.least else unknown or UNSATISFIABLE


def _mentioned(view: ObjectView) -> list[str]:
    """Return every name that a demand mentions by itself."""
    names = dict.fromkeys(view.members)
    for node, _ in view.rests:
        names.update(dict.fromkeys(node.properties))
    for demand in view.demands:
        if demand[0] == "somerest":
            names.update(dict.fromkeys(demand[1].properties))  # type: ignore[attr-defined] # a node
    names.update(view.has)
    names.update(dict.fromkeys(sorted(view.lacks)))
    return list(names)


def _name_classes(
    solver: Solver, view: ObjectView, demands: Sequence[Atom] = ()
) -> list[list[Literal]]:
    """Return the classes of names that the patterns in play and some demands distinguish."""
    patterns = dict.fromkeys(pattern for pattern, _ in view.patterns)
    for node in [n for n, _ in view.rests] + [d[1] for d in view.demands if d[0] == "somerest"]:
        patterns.update(dict.fromkeys(pattern for pattern, _ in node.patterns))  # type: ignore[attr-defined] # a node
    patterns.update((str(demand[1]), None) for demand in demands if demand[0] == "somepattern")
    nodes = {node.number: node for node in (_matching(solver, name) for name in patterns)}
    for demand in demands:
        if demand[0] == "somename":
            literal: Any = demand[-1]
            nodes[literal[0].number] = literal[0]
    if len(nodes) > _MAX_CLASSES:
        raise TooLong(f"{len(nodes)} patterns of names meet")
    classes: list[list[Literal]] = [[]]
    for node in nodes.values():
        classes = [[*class_, (node, sign)] for class_ in classes for sign in (False, True)]
    return classes


def _name_goal(
    solver: Solver, view: ObjectView, wanted: Iterable[Literal], taken: Iterable[str]
) -> Goal:
    """Return the goal of a name: a string that is allowed, of a class, and not taken."""
    names = sorted(set(taken) | view.lacks)
    string = solver.make("a string", {"type": "string"})
    goal: list[Literal] = [(string, True), *view.names, *wanted]
    if names:
        goal.append((solver.make(f"one of {names}", {"enum": names}), False))
    return tuple(goal)


def _matching(solver: Solver, pattern: str) -> SchemaNode:
    return solver.make(f"match {pattern}", {"pattern": pattern})


def _unnamed(solver: Solver, node: SchemaNode) -> list[Literal]:
    """Return what a name must meet to be none that a schema names."""
    literals: list[Literal] = [(_matching(solver, name), False) for name, _ in node.patterns]
    if node.properties:
        names = sorted(node.properties)
        literals.append((solver.make(f"one of {names}", {"enum": names}), False))
    return literals
