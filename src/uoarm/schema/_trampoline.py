"""Running generators that ask for sub-results, on an explicit stack instead of Python's."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import TypeVar

from uoarm.schema._errors import OutOfScopeError

__all__ = ["run"]

_MAX_DEPTH = 20_000

Q = TypeVar("Q")
A = TypeVar("A")


def run(
    question: Q,
    answer: Callable[[Q], Generator[Q, A, A]],
    observe: Callable[[Q, A], None] | None = None,
) -> A:
    """Answer a question by running its generator; what it yields is answered the same way.

    An OutOfScopeError of an answer is thrown into whatever asked for it. `observe` is told every
    question with its answer.
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
            asked = asking.pop()
            if observe is not None:
                observe(asked, done.value)
        except OutOfScopeError as error:
            stack.pop()
            asking.pop()
            failure = error
        else:
            if len(stack) > _MAX_DEPTH:
                raise OutOfScopeError(f"more than {_MAX_DEPTH:,} schemas within one another")
            stack.append(answer(asked))
            asking.append(asked)
            result = None
    if failure is not None:
        raise failure
    return result  # type: ignore[return-value] # the last generator returned it
