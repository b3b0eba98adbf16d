"""Demands on a value of one kind: atoms, further literals, and choices of which one must hold.

Atoms, by their first item:

any kind    ("in", node) one of the node's values; ("notin", node) none of them
number      ("low", bound, strict), ("high", bound, strict), ("multiple", m), ("notmultiple", m)
string      ("least", n), ("most", n), ("match", pattern), ("nomatch", pattern),
            ("nonul",), ("nul",)
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

from collections.abc import Callable, Generator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from typing import Any, Protocol, TypeAlias, TypeVar

from attrs import define, field, frozen

from uoarm.schema._errors import OutOfScopeError
from uoarm.schema._values import Key
from uoarm.schema.read import SchemaNode

KINDS = ("null", "boolean", "number", "string", "array", "object")

Literal: TypeAlias = "tuple[SchemaNode, bool]"
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
    refused: SchemaNode | None = None


@frozen
class Witness:
    """A value that does."""

    value: Any


@frozen
class Unsatisfiable:
    """No value does."""


@frozen
class Unknown:
    """It is not known; the cause says what was too much."""

    cause: str


Result: TypeAlias = "Witness | Unsatisfiable | Unknown"
UNSATISFIABLE = Unsatisfiable()


_MAX_DEPTH = 20_000

Q = TypeVar("Q")
A = TypeVar("A")
Asked_contra = TypeVar("Asked_contra", contravariant=True)
Answer_T = TypeVar("Answer_T")


class AnswerCache(Protocol[Asked_contra, Answer_T]):
    """Remembers answers, so that what is shared is worked out once."""

    def find(self, question: Asked_contra) -> Answer_T | None:
        """Return the answer to a question, None where it is not known; may raise what it raised."""

    def keep(self, question: Asked_contra, answer: Answer_T | OutOfScopeError) -> None:
        """Take in an answer, or the error that came instead of one."""


def run(
    question: Q,
    answer: Callable[[Q], Generator[Q, A, A]],
    memory: AnswerCache[Q, A] | None = None,
) -> A:
    """Answer a question by running its generator; what it yields is answered the same way.

    An OutOfScopeError of an answer is thrown into whatever asked for it.
    """
    stack = [answer(question)]
    asking = [question]
    result: A | None = None
    failure: OutOfScopeError | None = None
    while stack:
        try:
            if failure is not None:
                thrown, failure = failure, None
                asked = stack[-1].throw(thrown)
            else:
                asked = stack[-1].send(result)  # type: ignore[arg-type] # None starts a generator
        except StopIteration as done:
            stack.pop()
            result = done.value
            if memory is not None:
                memory.keep(asking[-1], done.value)
            asking.pop()
            continue
        except OutOfScopeError as error:
            stack.pop()
            failure = error
            if memory is not None:
                memory.keep(asking[-1], error)
            asking.pop()
            continue
        result = None
        if memory is not None:
            try:
                result = memory.find(asked)
            except OutOfScopeError as error:
                failure = error
                continue
        if result is None:
            if len(stack) > _MAX_DEPTH:
                raise OutOfScopeError(f"more than {_MAX_DEPTH:,} schemas within one another")
            stack.append(answer(asked))
            asking.append(asked)
    if failure is not None:
        raise failure
    return result  # type: ignore[return-value] # the last generator returned it


def _number_atoms(node: SchemaNode) -> list[Atom]:
    atoms: list[Atom] = []
    if node.integer_only:
        atoms.append(("multiple", 1))
    if node.minimum is not None:
        atoms.append(("low", node.minimum, False))
    if node.above is not None:
        atoms.append(("low", node.above, True))
    if node.maximum is not None:
        atoms.append(("high", node.maximum, False))
    if node.below is not None:
        atoms.append(("high", node.below, True))
    if node.multiple is not None:
        atoms.append(("multiple", node.multiple))
    return atoms


_OPPOSITE = {"low": "high", "high": "low", "multiple": "notmultiple"}


def _number_violations(node: SchemaNode) -> list[Atom]:
    return [
        (_OPPOSITE[str(tag)], rest[0], not rest[1]) if len(rest) > 1 else ("notmultiple", rest[0])
        for tag, *rest in _number_atoms(node)
    ]


def _string_atoms(node: SchemaNode) -> list[Atom]:
    atoms = _sizes(node.min_length, node.max_length)
    atoms.extend(("match", pattern) for pattern in node.texts)
    return [*atoms, ("nonul",)] if node.no_nul else atoms


def _string_violations(node: SchemaNode) -> list[Atom]:
    atoms = _sizes_violated(node.min_length, node.max_length)
    atoms.extend(("nomatch", pattern) for pattern in node.texts)
    return [*atoms, ("nul",)] if node.no_nul else atoms


def _array_atoms(node: SchemaNode) -> list[Atom]:
    atoms = _sizes(node.min_items, node.max_items)
    atoms.extend(("at", n, (subschema, True)) for n, subschema in enumerate(node.prefix))
    if node.items is not None:
        atoms.append(("tail", len(node.prefix), (node.items, True)))
    if node.contains is not None:
        atoms.append(("contains", node.contains, node.min_contains, node.max_contains))
    if node.unique:
        atoms.append(("unique",))
    return atoms


def _array_violations(node: SchemaNode) -> list[Atom]:
    atoms = _sizes_violated(node.min_items, node.max_items)
    atoms.extend(("someat", n, (subschema, False)) for n, subschema in enumerate(node.prefix))
    if node.items is not None:
        atoms.append(("some", len(node.prefix), (node.items, False)))
    if node.contains is not None:
        if node.min_contains > 0:
            atoms.append(("contains", node.contains, 0, node.min_contains - 1))
        if node.max_contains is not None:
            atoms.append(("contains", node.contains, node.max_contains + 1, None))
    if node.unique:
        atoms.append(("twice",))
    return atoms


def _object_atoms(node: SchemaNode) -> list[Atom]:
    atoms = _sizes(node.min_properties, node.max_properties)
    atoms.extend(("has", name) for name in node.required)
    atoms.extend(("member", name, (property_, True)) for name, property_ in node.properties.items())
    atoms.extend(("pattern", pattern, (subschema, True)) for pattern, subschema in node.patterns)
    if node.additional is not None:
        atoms.append(("rest", node, (node.additional, True)))
    if node.names is not None:
        atoms.append(("names", (node.names, True)))
    return atoms


def _object_violations(node: SchemaNode) -> list[Atom]:
    atoms: list[Atom] = [("lacks", name) for name in node.required]
    atoms.extend(
        ("somemember", name, (property_, False)) for name, property_ in node.properties.items()
    )
    atoms.extend(
        ("somepattern", pattern, (subschema, False)) for pattern, subschema in node.patterns
    )
    if node.additional is not None:
        atoms.append(("somerest", node, (node.additional, False)))
    if node.names is not None:
        atoms.append(("somename", (node.names, False)))
    return atoms + _sizes_violated(node.min_properties, node.max_properties)


def _sizes(least: int, most: int | None) -> list[Atom]:
    atoms: list[Atom] = [("least", least)] if least else []
    return atoms if most is None else [*atoms, ("most", most)]


def _sizes_violated(least: int, most: int | None) -> list[Atom]:
    atoms: list[Atom] = [("most", least - 1)] if least else []
    return atoms if most is None else [*atoms, ("least", most + 1)]


def _nothing(node: SchemaNode) -> list[Atom]:
    del node
    return []


ATOMS = {
    "null": _nothing,
    "boolean": _nothing,
    "number": _number_atoms,
    "string": _string_atoms,
    "array": _array_atoms,
    "object": _object_atoms,
}
VIOLATIONS = {
    "null": _nothing,
    "boolean": _nothing,
    "number": _number_violations,
    "string": _string_violations,
    "array": _array_violations,
    "object": _object_violations,
}


Tags: TypeAlias = Mapping[str, "AbstractSet[Key]"]

_MAX_CONJUNCTS = 50


def tags_of(node: SchemaNode) -> Tags:
    """Return the tags of a schema, kept with it once they are known."""
    if node.tags is None:
        node.tags = _find(node)
    return node.tags


def contradicts(known: Tags, node: SchemaNode) -> bool:
    """Say whether no object with the known tags can be one of a schema."""
    if not known:
        return False
    return any(
        name in known and known[name].isdisjoint(keys) for name, keys in tags_of(node).items()
    )


def certainly_disjoint(nodes: Sequence[SchemaNode], kind: str) -> bool:
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


def _find(node: SchemaNode) -> Tags:
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
