"""The demands on an array, arranged by position."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import product
from typing import Any

from uoarm.schema._branch import Atom, Literal
from uoarm.schema._errors import OutOfScopeError
from uoarm.schema._node import Node
from uoarm.schema._solve import Goal

__all__ = ["Layout"]


class Layout:
    """The demands on an array, arranged by position."""

    def __init__(self, atoms: Iterable[Atom]) -> None:
        self.least = 0
        self.most: int | None = None
        self.at: dict[int, list[Literal]] = {}
        self.tails: list[tuple[int, Literal]] = []
        self.some: list[tuple[int, Literal]] = []
        self.counts: list[tuple[Node, int, int | None]] = []
        self.unique = self.twice = False
        for atom in atoms:
            self._take(atom)

    def _take(self, atom: Atom) -> None:
        tag = atom[0]
        rest: Any = atom[1:]
        if tag == "least":
            self.least = max(self.least, rest[0])
        elif tag == "most":
            self.most = rest[0] if self.most is None else min(self.most, rest[0])
        elif tag == "at":
            self.at.setdefault(rest[0], []).append(rest[1])
        elif tag == "someat":
            self.at.setdefault(rest[0], []).append(rest[1])
            self.least = max(self.least, rest[0] + 1)
        elif tag == "tail":
            self.tails.append((rest[0], rest[1]))
        elif tag == "some":
            self.some.append((rest[0], rest[1]))
        elif tag == "contains":
            self.counts.append(rest)
        elif tag == "unique":
            self.unique = True
        elif tag == "twice":
            self.twice = True
        else:
            raise OutOfScopeError(f"internal: {tag!r} is no demand on the layout of an array")

    @property
    def generic(self) -> int:
        """The first position from which on all are alike."""
        return max([*(n + 1 for n in self.at), *(start for start, _ in self.tails), 0])

    def literals(self, position: int) -> Goal:
        """Return what the item at a position must meet."""
        tail = (literal for start, literal in self.tails if position >= start)
        return (*self.at.get(position, ()), *tail)

    def sign_vectors(self) -> Iterator[tuple[bool, ...]]:
        """Yield every way in which an item may meet or fail the counted schemas."""
        return product((True, False), repeat=len(self.counts))

    def signed(self, signs: tuple[bool, ...]) -> Goal:
        """Return what an item meets that meets and fails the counted schemas as given."""
        return tuple((node, sign) for (node, _, _), sign in zip(self.counts, signs, strict=True))

    def classes(self, position: int) -> Iterator[tuple[tuple[bool, ...], Goal]]:
        """Yield what an item at a position must meet, by what it counts for."""
        for signs in self.sign_vectors():
            yield signs, (*self.literals(position), *self.signed(signs))

    def count_on(self, counts: tuple[int, ...], signs: tuple[bool, ...]) -> tuple[int, ...] | None:
        """Return the counts after one more item, None when there are too many.

        Counts that no longer matter stay where they are.
        """
        after = []
        for (_, least, most), count, sign in zip(self.counts, counts, signs, strict=True):
            more = count + sign
            if most is not None and more > most:
                return None
            after.append(min(more, least) if most is None else more)
        return tuple(after)

    def enough(self, counts: tuple[int, ...]) -> bool:
        """Say whether no counted schema lacks items."""
        return all(n >= least for (_, least, _), n in zip(self.counts, counts, strict=True))
