"""Demands on a value of one kind: atoms, further literals, and choices of which one must hold.

Atoms, by their first item:

any kind    ("in", node) one of the node's values; ("notin", node) none of them
number      ("low", bound, strict), ("high", bound, strict), ("multiple", m), ("notmultiple", m)
string      ("least", n), ("most", n), ("match", pattern), ("nomatch", pattern)
array       ("least", n), ("most", n), ("at", i, literal) if there is an i-th,
            ("tail", start, literal), ("someat", i, literal), ("some", start, literal),
            ("contains", node, least, most), ("unique",), ("twice",)
object      ("least", n), ("most", n), ("has", name), ("lacks", name),
            ("member", name, literal) if present, ("somemember", name, literal),
            ("pattern", pattern, literal), ("somepattern", pattern, literal),
            ("rest", node, literal) names that the node does not name, ("somerest", node, literal),
            ("names", literal), ("somename", literal)
"""

from __future__ import annotations

from typing import TypeAlias

from attrs import define, field

from uoarm.schema.read import Node

__all__ = ["KINDS", "Atom", "Branch", "Choice", "Literal"]

KINDS = ("null", "boolean", "number", "string", "array", "object")

Literal: TypeAlias = "tuple[Node, bool]"
Atom: TypeAlias = "tuple[object, ...]"


@define
class Branch:
    """Demands that hold together."""

    atoms: list[Atom] = field(factory=list)
    literals: list[Literal] = field(factory=list)
    choices: list[Choice] = field(factory=list)


@define
class Choice:
    """Ways of which one must hold; they are those to fail a schema where `refused` is given."""

    ways: list[Branch]
    refused: Node | None = None
