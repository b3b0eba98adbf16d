"""Where the generators of instances take their choices from: hypothesis, or a random source."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Protocol, TypeVar

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hypothesis.strategies import SearchStrategy

Item = TypeVar("Item")

CHARACTERS = "a0Az_-. \n\u00e9\u2028\U0001f600"
"""Drawn for free strings: a line end, a line separator, two bytes, four bytes, a surrogate pair."""

_FREE_LENGTH = 24


class Choices(Protocol):
    """What a generator may ask for; every method is one choice."""

    def item(self, items: Sequence[Item]) -> Item:
        """One of ``items``, which must not be empty."""
        ...

    def integer(self, low: int, high: int) -> int:
        """An integer from ``low`` to ``high``, both included."""
        ...

    def matching(self, pattern: str) -> str:
        """A string in which ``pattern`` is probably found; any string when it cannot be read."""
        ...


class Draw(Protocol):
    """What hypothesis hands to a composite strategy, and ``data().draw``."""

    def __call__(self, strategy: SearchStrategy[Item], label: object = None) -> Item:
        """One example of ``strategy``."""
        ...


class DrawnChoices:
    """Choices drawn by hypothesis, so that a failing example shrinks."""

    def __init__(self, draw: Draw) -> None:
        from hypothesis import strategies  # noqa: PLC0415 - hypothesis is no dependency of uoarm

        self._draw = draw
        self._strategies = strategies

    def item(self, items: Sequence[Item]) -> Item:
        """One of ``items``; shrinks to the first."""
        return items[self.integer(0, len(items) - 1)]

    def integer(self, low: int, high: int) -> int:
        """An integer in the range; shrinks towards ``low``."""
        return self._draw(self._strategies.integers(low, high))

    def matching(self, pattern: str) -> str:
        """A string that hypothesis finds for ``pattern`` read with Python's rules."""
        try:
            compiled = re.compile(pattern, re.ASCII)
        except re.error:
            return CHARACTERS[self.integer(0, 1)]
        return self._draw(self._strategies.from_regex(compiled))


def chance(choices: Choices, percent: int) -> bool:
    """True in about ``percent`` of 100 cases; shrinks to False."""
    return choices.integer(0, 99) >= 100 - percent


def text(choices: Choices, length: int) -> str:
    """A free string of ``length`` code points; one character repeated when it is long."""
    if length > _FREE_LENGTH:
        return choices.item(CHARACTERS) * length
    return "".join(choices.item(CHARACTERS) for _ in range(length))
