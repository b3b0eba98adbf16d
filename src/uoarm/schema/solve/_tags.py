"""Tags: members that every object of a schema must have, with a value out of a list.

They tell the branches of a tagged union apart at once, without asking field by field.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from typing import TypeAlias

from uoarm.schema._values import Key
from uoarm.schema.read import Node

__all__ = ["Tags", "certainly_disjoint", "contradicts", "tags_of"]

Tags: TypeAlias = Mapping[str, "AbstractSet[Key]"]

_MAX_CONJUNCTS = 50


def tags_of(node: Node) -> Tags:
    """Return the tags of a schema, kept with it once they are known."""
    if node.tags is None:
        node.tags = _find(node)
    return node.tags


def contradicts(known: Tags, node: Node) -> bool:
    """Say whether no object with the known tags can be one of a schema."""
    if not known:
        return False
    return any(
        name in known and known[name].isdisjoint(keys) for name, keys in tags_of(node).items()
    )


def certainly_disjoint(nodes: Sequence[Node], kind: str) -> bool:
    """Say whether no value of a kind can meet two of some schemas, as far as is seen at once."""
    if any(node.unsupported for node in nodes):
        return False
    if all(node.values is not None for node in nodes):
        return _apart([node.values.keys() for node in nodes if node.values is not None])
    if kind != "object" or not nodes:
        return False
    tags = [tags_of(node) for node in nodes]
    return any(
        all(name in tag for tag in tags) and _apart([tag[name] for tag in tags]) for name in tags[0]
    )


def _apart(sets: Sequence[AbstractSet[Key]]) -> bool:
    return len(frozenset[Key]().union(*sets)) == sum(len(set_) for set_ in sets)


def _find(node: Node) -> Tags:
    conjuncts = [node]
    for conjunct in conjuncts:
        conjuncts.extend(conjunct.all_of)
        if conjunct.reference is not None:
            conjuncts.append(conjunct.target())
        if conjunct.unsupported or len(conjuncts) > _MAX_CONJUNCTS:
            return {}
    required = {name for conjunct in conjuncts for name in conjunct.required}
    return {
        name: rule.values.keys()
        for conjunct in conjuncts
        for name, rule in conjunct.properties.items()
        if rule.values is not None and name in required and not rule.unsupported
    }
