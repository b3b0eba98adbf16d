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

from collections.abc import Callable, Generator
from typing import Any, Protocol, TypeAlias, TypeVar

from attrs import define, field, frozen

from uoarm.schema._errors import OutOfScopeError
from uoarm.schema.read import SchemaNode

__all__ = [
    "EMPTY",
    "KINDS",
    "AnswerCache",
    "Atom",
    "Branch",
    "Choice",
    "Empty",
    "Found",
    "Literal",
    "Result",
    "Unknown",
    "run",
]

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
class Found:
    """A value that does."""

    value: Any


@frozen
class Empty:
    """No value does."""


@frozen
class Unknown:
    """Nobody knows; the cause says what was too much."""

    cause: str


Result: TypeAlias = "Found | Empty | Unknown"
EMPTY = Empty()


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
