"""What a schema, or its negation, demands of a value of one kind.

A literal is a node with a sign. Expanding it for a kind gives atoms (demands of one sort each,
see below), further literals, and choices: lists of branches of which one must hold. Negation is
pushed in here: not-all becomes one-fails, a lower bound becomes an upper one.
The sorts of atoms are listed in `_branch`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations
from typing import TypeAlias

from attrs import frozen

from uoarm.schema._errors import OutOfScopeError
from uoarm.schema.read import SchemaNode
from uoarm.schema.solve._branch import (
    ATOMS,
    VIOLATIONS,
    Branch,
    Choice,
    Literal,
    certainly_disjoint,
)
from uoarm.schema.solve._evaluate import named_rules

Condition: TypeAlias = "tuple[SchemaNode, bool] | str"
"""A schema that holds or fails, or the name of a member that is there."""
Guard: TypeAlias = "tuple[Condition, ...]"

_MAX_SOURCES = 1_000

# `unevaluatedProperties` and `unevaluatedItems` see what the schemas beside them, applied to the
# same value, have evaluated. Each of these is a source with a guard: what must hold, given that the
# whole holds but for the unevaluated rule itself, for the source to count. That a part is evaluated
# is known once it is known which sources hold. A demand may assume fewer sources than hold, since
# that demands more; a violation is shown by sources that fail.


@frozen
class EvaluatedParts:
    """One schema that evaluates parts where its guard holds; `all_parts` when it leaves none."""

    node: SchemaNode
    guard: Guard
    all_parts: bool


def _sources(node: SchemaNode, kind: str) -> list[EvaluatedParts]:
    """Return what may evaluate members (of an "object") or items (of an "array") for a node.

    Raises:
        OutOfScopeError: there are too many.
    """
    found: list[EvaluatedParts] = []
    waiting: list[tuple[SchemaNode, Guard]] = [(node, ())]
    for subschema, guard in waiting:
        if len(waiting) > _MAX_SOURCES:
            raise OutOfScopeError("too many schemas stand beside an unevaluated keyword")
        if subschema.unsupported:
            raise OutOfScopeError(subschema.unsupported)
        if subschema.never or (subschema.kinds is not None and kind not in subschema.kinds):
            continue
        everything = _evaluates_all(subschema, kind, rooted=subschema is node)
        if everything or _evaluates_some(subschema, kind):
            found.append(EvaluatedParts(subschema, guard, everything))
        if not everything or subschema is node:
            waiting.extend((inner, guard + more) for inner, more in _beside(subschema, kind))
    return found


def _evaluates_all(node: SchemaNode, kind: str, *, rooted: bool) -> bool:
    if kind == "array":
        return node.items is not None or (node.unevaluated_items is not None and not rooted)
    return node.additional is not None or (node.unevaluated_properties is not None and not rooted)


def _evaluates_some(node: SchemaNode, kind: str) -> bool:
    if kind == "array":
        return bool(node.prefix) or node.contains is not None
    return bool(node.properties or node.patterns)


def _beside(node: SchemaNode, kind: str) -> Iterator[tuple[SchemaNode, Guard]]:
    """Yield the schemas that a node applies to the same value, each with its own condition."""
    for subschema in node.all_of:
        yield subschema, ()
    if node.reference is not None:
        yield node.target(), ()
    for subschema in (*(node.any_of or ()), *(node.one_of or ())):
        yield subschema, ((subschema, True),)
    if node.condition is not None:
        yield node.condition, ((node.condition, True),)
        if node.then is not None:
            yield node.then, ((node.condition, True),)
        if node.otherwise is not None:
            yield node.otherwise, ((node.condition, False),)
    if kind == "object":
        for name, rule in node.dependent_schemas:
            yield rule, (name,)


_MAX_SPLIT = 6


def members_hold(node: SchemaNode, rule: SchemaNode) -> list[Branch]:
    """Return the ways in which every member is evaluated or meets the rule."""
    always, whole, partly = _sorted(_sources(node, "object"))
    ways = [_held(source.guard) for source in whole]
    if any(not source.guard for source in whole):
        return [Branch()]
    wide = [source for source in partly if source.node.patterns]
    narrow = [source for source in partly if not source.node.patterns]
    for used in _subsets(wide, "patterns of names"):
        sure = [*always, *used]
        cover = _cover(node, sure, sure)
        way = _held([condition for source in used for condition in source.guard])
        for name in _names(narrow):
            if not named_rules(cover, name):
                holders = [
                    _held(source.guard) for source in narrow if name in source.node.properties
                ]
                meets = Branch([("member", name, (rule, True))])
                way.choices.append(Choice([meets, *holders]))
        way.atoms.append(("rest", _cover(node, [*sure, *narrow], sure), (rule, True)))
        ways.append(way)
    return ways


def members_fail(node: SchemaNode, rule: SchemaNode) -> list[Branch]:
    """Return the ways in which some member is not evaluated and fails the rule."""
    always, whole, partly = _sorted(_sources(node, "object"))
    if any(not source.guard for source in whole) or rule.raw is True:
        return []
    cover = _cover(node, always, always)
    ways: list[Branch] = []
    for name in _names(partly):
        if not named_rules(cover, name):
            way = Branch([("somemember", name, (rule, False))])
            way.choices += [_failed(source.guard) for source in whole]
            way.choices += [
                _failed(source.guard) for source in partly if named_rules(source.node, name)
            ]
            ways.append(way)
    wide = [source for source in partly if source.node.patterns]
    for avoided in _subsets(wide, "patterns of names"):
        rest = _cover(node, [*always, *partly], [*always, *avoided])
        way = Branch([("somerest", rest, (rule, False))])
        way.choices += [_failed(source.guard) for source in whole]
        way.choices += [_failed(source.guard) for source in wide if source not in avoided]
        ways.append(way)
    return ways


def items_hold(node: SchemaNode, rule: SchemaNode) -> list[Branch]:
    """Return the ways in which every item is evaluated or meets the rule."""
    always, whole, partly = _sorted(_sources(node, "array"))
    ways = [_held(source.guard) for source in whole]
    if any(not source.guard for source in whole):
        return [Branch()]
    counting = [source for source in partly if source.node.contains is not None]
    for used in _subsets(counting, "contains"):
        sure = [*always, *used]
        covered = _longest(sure)
        meets = _or_contained(node, rule, sure)
        guard = [condition for source in used for condition in source.guard]
        way = _held(guard)
        way.atoms.append(("tail", covered, (meets, True)))
        ways.append(way)
        for source in partly:
            if len(source.node.prefix) > covered:
                way = _held([*guard, *source.guard])
                way.atoms.append(("tail", len(source.node.prefix), (meets, True)))
                ways.append(way)
    return ways


def items_fail(node: SchemaNode, rule: SchemaNode) -> list[Branch]:
    """Return the ways in which some item is not evaluated and fails the rule."""
    always, whole, partly = _sorted(_sources(node, "array"))
    if any(not source.guard for source in whole) or rule.raw is True:
        return []
    ways: list[Branch] = []
    covered = _longest(always)
    starts = {len(source.node.prefix) for source in partly if len(source.node.prefix) > covered}
    counting = [source for source in partly if source.node.contains is not None]
    for failed in _subsets(counting, "contains"):
        meets = _or_contained(node, rule, [*always, *failed])
        for start in sorted({covered, *starts}):
            way = Branch([("some", start, (meets, False))])
            out = [source for source in partly if len(source.node.prefix) > start]
            out += [source for source in counting if source not in failed]
            way.choices += [_failed(source.guard) for source in (*whole, *out)]
            ways.append(way)
    return ways


def _sorted(
    found: Iterable[EvaluatedParts],
) -> tuple[list[EvaluatedParts], list[EvaluatedParts], list[EvaluatedParts]]:
    """Return what always evaluates some parts, what evaluates all, what may evaluate some."""
    always: list[EvaluatedParts] = []
    whole: list[EvaluatedParts] = []
    partly: list[EvaluatedParts] = []
    for source in found:
        if source.all_parts:
            whole.append(source)
        elif source.guard:
            partly.append(source)
        else:
            always.append(source)
    return always, whole, partly


def _subsets(found: Sequence[EvaluatedParts], what: str) -> Iterator[tuple[EvaluatedParts, ...]]:
    if len(found) > _MAX_SPLIT:
        raise OutOfScopeError(f"more than {_MAX_SPLIT} schemas with {what} may be evaluated or not")
    for count in range(len(found), -1, -1):
        yield from combinations(found, count)


def _held(guard: Iterable[Condition]) -> Branch:
    held = Branch()
    for item in guard:
        if isinstance(item, str):
            held.atoms.append(("has", item))
        else:
            held.literals.append(item)
    return held


def _failed(guard: Guard) -> Choice:
    ways = [
        Branch([("lacks", item)])
        if isinstance(item, str)
        else Branch(literals=[(item[0], not item[1])])
        for item in guard
    ]
    return Choice(ways)


def _names(found: Iterable[EvaluatedParts]) -> list[str]:
    return list(dict.fromkeys(name for source in found for name in source.node.properties))


def _cover(
    node: SchemaNode, named: Iterable[EvaluatedParts], matched: Iterable[EvaluatedParts]
) -> SchemaNode:
    """Return a node that names the members that some sources name or match."""
    return SchemaNode(
        node.number,
        node.raw,
        node.document,
        properties={
            name: rule for source in named for name, rule in source.node.properties.items()
        },
        patterns=tuple(pattern for source in matched for pattern in source.node.patterns),
    )


def _longest(found: Iterable[EvaluatedParts]) -> int:
    return max((len(source.node.prefix) for source in found), default=0)


def _or_contained(
    node: SchemaNode, rule: SchemaNode, found: Iterable[EvaluatedParts]
) -> SchemaNode:
    """Return what an item meets that follows a rule or counts as contained."""
    contained = [source.node.contains for source in found if source.node.contains is not None]
    return node.document.either([rule, *contained])


_MAX_RIVALS = 600


def expand(literal: Literal, kind: str) -> Branch | None:
    """Return what a literal demands of a value of a kind; None when no value will do."""
    node, sign = literal
    if node.never:
        return None if sign else Branch()
    if sign:
        return _positive(node, kind)
    if node.kinds is not None and kind not in node.kinds:
        return Branch()
    branches = _violations(node, kind)
    node.document.meter.spend(len(branches) // 8)
    if not branches:
        return None
    if len(branches) == 1:
        return branches[0]
    return Branch(choices=[Choice(branches, node)])


def _positive(node: SchemaNode, kind: str) -> Branch | None:
    if node.kinds is not None and kind not in node.kinds:
        return None
    whole = Branch()
    if node.values is not None:
        whole.atoms.append(("in", node))
    whole.atoms.extend(ATOMS[kind](node))
    whole.literals.extend((subschema, True) for subschema in node.all_of)
    if node.reference is not None:
        whole.literals.append((node.target(), True))
    if node.any_of is not None:
        whole.choices.append(_any_one(node.any_of))
    if node.one_of is not None:
        whole.choices.append(_exactly_one(node.one_of, kind))
    if node.negated is not None:
        whole.literals.append((node.negated, False))
    if node.condition is not None:
        holds = Branch(literals=[(node.condition, True), *_if_there(node.then)])
        fails = Branch(literals=[(node.condition, False), *_if_there(node.otherwise)])
        whole.choices.append(Choice([holds, fails]))
    if kind == "object":
        whole.choices.extend(_dependencies(node))
        if node.unevaluated_properties is not None:
            whole.choices.append(Choice(members_hold(node, node.unevaluated_properties)))
    elif kind == "array" and node.unevaluated_items is not None:
        whole.choices.append(Choice(items_hold(node, node.unevaluated_items)))
    return whole


def _if_there(node: SchemaNode | None) -> list[Literal]:
    return [] if node is None else [(node, True)]


def _possible(nodes: Iterable[SchemaNode], kind: str) -> list[SchemaNode]:
    return [
        node
        for node in nodes
        if node.unsupported
        or not (node.never or (node.kinds is not None and kind not in node.kinds))
    ]


def _check_few(nodes: Sequence[SchemaNode]) -> None:
    if len(nodes) > _MAX_RIVALS:
        raise OutOfScopeError(f"a oneOf of more than {_MAX_RIVALS} schemas that may overlap")
    if nodes:
        nodes[0].document.meter.spend(len(nodes) ** 2 // 8)


def _any_one(nodes: Sequence[SchemaNode]) -> Choice:
    ways: list[Branch] = []
    for number, node in enumerate(nodes, 1):
        if not number % 8:
            node.document.meter.spend()
        ways.append(Branch(literals=[(node, True)]))
    return Choice(ways)


def _exactly_one(nodes: Iterable[SchemaNode], kind: str) -> Choice:
    possible = _possible(nodes, kind)
    if certainly_disjoint(possible, kind):
        return _any_one(possible)
    _check_few(possible)
    ways: list[Branch] = []
    for i, node in enumerate(possible):
        node.document.meter.spend(1 + len(possible) // 8)
        ways.append(Branch(literals=[(other, i == j) for j, other in enumerate(possible)]))
    return Choice(ways)


def _two_at_once(nodes: Iterable[SchemaNode], kind: str) -> list[Branch]:
    possible = _possible(nodes, kind)
    if certainly_disjoint(possible, kind):
        return []
    _check_few(possible)
    ways: list[Branch] = []
    for place, node in enumerate(possible):
        node.document.meter.spend(1 + len(possible) // 8)
        ways += [Branch(literals=[(node, True), (two, True)]) for two in possible[place + 1 :]]
    return ways


def _dependencies(node: SchemaNode) -> list[Choice]:
    needs = [
        Choice(
            [Branch([("lacks", name)]), Branch([("has", name), *(("has", text) for text in names)])]
        )
        for name, names in node.dependent_required
    ]
    rules = [
        Choice([Branch([("lacks", name)]), Branch([("has", name)], [(rule, True)])])
        for name, rule in node.dependent_schemas
    ]
    return needs + rules


def _violations(node: SchemaNode, kind: str) -> list[Branch]:
    """Return the ways in which a value of a kind can fail a node, each as a branch."""
    ways: list[Branch] = []
    if node.values is not None:
        ways.append(Branch([("notin", node)]))
    ways.extend(Branch([atom]) for atom in VIOLATIONS[kind](node))
    ways.extend(Branch(literals=[(subschema, False)]) for subschema in node.all_of)
    if node.reference is not None:
        ways.append(Branch(literals=[(node.target(), False)]))
    if node.any_of is not None:
        ways.append(Branch(literals=[(subschema, False) for subschema in node.any_of]))
    if node.one_of is not None:
        ways.append(Branch(literals=[(subschema, False) for subschema in node.one_of]))
        ways.extend(_two_at_once(node.one_of, kind))
    if node.negated is not None:
        ways.append(Branch(literals=[(node.negated, True)]))
    if node.condition is not None:
        if node.then is not None:
            ways.append(Branch(literals=[(node.condition, True), (node.then, False)]))
        if node.otherwise is not None:
            ways.append(Branch(literals=[(node.condition, False), (node.otherwise, False)]))
    if kind == "object":
        for name, names in node.dependent_required:
            ways.extend(Branch([("has", name), ("lacks", text)]) for text in names)
        for name, rule in node.dependent_schemas:
            ways.append(Branch([("has", name)], [(rule, False)]))
        if node.unevaluated_properties is not None:
            ways.extend(members_fail(node, node.unevaluated_properties))
    elif kind == "array" and node.unevaluated_items is not None:
        ways.extend(items_fail(node, node.unevaluated_items))
    return ways
