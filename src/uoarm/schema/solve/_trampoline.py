"""Running generators that ask for sub-results, on an explicit stack instead of Python's."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Protocol, TypeVar

from uoarm.schema._errors import OutOfScopeError

__all__ = ["Memory", "run"]

_MAX_DEPTH = 20_000

Q = TypeVar("Q")
A = TypeVar("A")
Asked_contra = TypeVar("Asked_contra", contravariant=True)
Told = TypeVar("Told")


class Memory(Protocol[Asked_contra, Told]):
    """Remembers answers, so that what is shared is worked out once."""

    def find(self, question: Asked_contra) -> Told | None:
        """Return the answer to a question, None where it is not known; may raise what it raised."""

    def keep(self, question: Asked_contra, answer: Told | OutOfScopeError) -> None:
        """Take in an answer, or the error that came instead of one."""


def run(
    question: Q,
    answer: Callable[[Q], Generator[Q, A, A]],
    memory: Memory[Q, A] | None = None,
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
