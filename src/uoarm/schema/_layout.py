"""The demands on an array, arranged by position."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from uoarm.schema._branch import Atom, Literal
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
        else:
            self.twice = True

    @property
    def generic(self) -> int:
        """The first position from which on all are alike."""
        return max([*(n + 1 for n in self.at), *(start for start, _ in self.tails), 0])

    def literals(self, position: int) -> Goal:
        """Return what the item at a position must meet."""
        tail = (literal for start, literal in self.tails if position >= start)
        return (*self.at.get(position, ()), *tail)
