"""What a schema, or its negation, demands of a value of one kind.

A literal is a node with a sign. Expanding it for a kind gives atoms (demands of one sort each,
see below), further literals, and choices: lists of branches of which one must hold. Negation is
pushed in here: not-all becomes one-fails, a lower bound becomes an upper one.
The sorts of atoms are listed in `_branch`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from uoarm.schema._errors import OutOfScopeError
from uoarm.schema.read import SchemaNode
from uoarm.schema.solve._atoms import ATOMS, VIOLATIONS, certainly_disjoint
from uoarm.schema.solve._branch import Branch, Choice, Literal
from uoarm.schema.solve._unevaluated import items_fail, items_hold, members_fail, members_hold

__all__ = ["expand"]

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
        holds = Branch(literals=[(node.condition, True), *_if_there(node.then, sign=True)])
        fails = Branch(literals=[(node.condition, False), *_if_there(node.otherwise, sign=True)])
        whole.choices.append(Choice([holds, fails]))
    if kind == "object":
        whole.choices.extend(_dependencies(node))
        if node.unevaluated_properties is not None:
            whole.choices.append(Choice(members_hold(node, node.unevaluated_properties)))
    elif kind == "array" and node.unevaluated_items is not None:
        whole.choices.append(Choice(items_hold(node, node.unevaluated_items)))
    return whole


def _if_there(node: SchemaNode | None, *, sign: bool) -> list[Literal]:
    return [] if node is None else [(node, sign)]


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
