"""Nodes: schemas read once, with every keyword of the vocabulary as a typed field."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet
from fractions import Fraction
from typing import NamedTuple, Protocol, TypeAlias

from attrs import define, field

from uoarm.schema._meter import Meter
from uoarm.schema._values import Key
from uoarm.schema.regex import CodeUnits

__all__ = ["NodeReader", "Reference", "SchemaNode", "Scope"]

Scope: TypeAlias = "tuple[tuple[str, str], ...]"
"""Names of dynamic anchors, each with the base of the document that has set it."""


class NodeReader(Protocol):
    """What nodes ask of the document that they were read from."""

    @property
    def meter(self) -> Meter:
        """The budget that work on the document is spent from."""

    def resolve(self, reference: Reference) -> SchemaNode:
        """Return the node that a reference leads to."""

    def either(self, nodes: Sequence[SchemaNode]) -> SchemaNode:
        """Return a node that accepts what one of some nodes accepts."""


class Reference(NamedTuple):
    """A reference: its keyword, where it points to, and the dynamic scope that it stands in."""

    keyword: str
    absolute: str
    scope: Scope


@define(eq=False)
class SchemaNode:
    """One schema. Equal content has the same `number`, so that comparing is comparing integers.

    A node that holds something out of scope says so in `unsupported`. `never` is `false`. `tags`
    are found when first asked for, by `_tags`.
    """

    number: int
    raw: object
    document: NodeReader
    never: bool = False
    unsupported: str = ""
    kinds: frozenset[str] | None = None
    integer_only: bool = False
    values: dict[Key, object] | None = None
    minimum: Fraction | None = None
    maximum: Fraction | None = None
    above: Fraction | None = None
    below: Fraction | None = None
    multiple: Fraction | None = None
    min_length: int = 0
    max_length: int | None = None
    max_utf8: int | None = None
    max_utf16: int | None = None
    no_nul: bool = False
    pattern: str | None = None
    prefix: tuple[SchemaNode, ...] = ()
    items: SchemaNode | None = None
    min_items: int = 0
    max_items: int | None = None
    contains: SchemaNode | None = None
    min_contains: int = 1
    max_contains: int | None = None
    unique: bool = False
    unevaluated_items: SchemaNode | None = None
    properties: dict[str, SchemaNode] = field(factory=dict)
    patterns: tuple[tuple[str, SchemaNode], ...] = ()
    additional: SchemaNode | None = None
    unevaluated_properties: SchemaNode | None = None
    names: SchemaNode | None = None
    required: tuple[str, ...] = ()
    min_properties: int = 0
    max_properties: int | None = None
    dependent_required: tuple[tuple[str, tuple[str, ...]], ...] = ()
    dependent_schemas: tuple[tuple[str, SchemaNode], ...] = ()
    all_of: tuple[SchemaNode, ...] = ()
    any_of: tuple[SchemaNode, ...] | None = None
    one_of: tuple[SchemaNode, ...] | None = None
    negated: SchemaNode | None = None
    condition: SchemaNode | None = None
    then: SchemaNode | None = None
    otherwise: SchemaNode | None = None
    reference: Reference | None = None
    tags: Mapping[str, AbstractSet[Key]] | None = None

    def target(self) -> SchemaNode:
        """Return the node that the reference leads to."""
        assert self.reference is not None
        return self.document.resolve(self.reference)

    @property
    def texts(self) -> list[str | CodeUnits]:
        """What a text must be found to be: of a pattern, of so many code units."""
        texts: list[str | CodeUnits] = [] if self.pattern is None else [self.pattern]
        if self.max_utf8 is not None:
            texts.append(CodeUnits(4, self.max_utf8))
        if self.max_utf16 is not None:
            texts.append(CodeUnits(2, self.max_utf16))
        return texts

    def applied(self) -> list[SchemaNode]:
        """Return the schemas that this one applies to the same value."""
        single = [self.negated, self.condition, self.then, self.otherwise]
        found = [node for node in single if node is not None]
        found += [*self.all_of, *(self.any_of or ()), *(self.one_of or ())]
        found += [node for _, node in self.dependent_schemas]
        return found if self.reference is None else [*found, self.target()]
