"""The demands on an array, arranged by position."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator
from itertools import product
from typing import Any, TypeAlias

from uoarm.schema._errors import OutOfScopeError
from uoarm.schema.read import SchemaNode
from uoarm.schema.solve._branch import Atom, Literal, Result, Unsatisfiable
from uoarm.schema.solve._solver import Goal

__all__ = ["ArrayView", "Layout"]


class Layout:
    """The demands on an array, arranged by position."""

    def __init__(self, atoms: Iterable[Atom]) -> None:
        self.least = 0
        self.most: int | None = None
        self.at: dict[int, list[Literal]] = {}
        self.tails: list[tuple[int, Literal]] = []
        self.some: list[tuple[int, Literal]] = []
        self.counts: list[tuple[SchemaNode, int, int | None]] = []
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


Verdict: TypeAlias = Generator[Goal, Result, "bool | None"]


class ArrayView:
    """The demands on an array, for quick verdicts on one more."""

    def __init__(self, atoms: Iterable[Atom]) -> None:
        self._layout = Layout(atoms)
        self._counts: dict[int, tuple[int, int | None]] = {}
        for node, least, most in self._layout.counts:
            low, high = self._counts.get(node.number, (0, None))
            if most is not None:
                high = most if high is None else min(most, high)
            self._counts[node.number] = max(low, least), high

    def judge(self, atom: Atom, *, many: bool) -> Verdict:
        """Return True when an atom holds already, False when it cannot, None otherwise."""
        tag = atom[0]
        rest: Any = atom[1:]
        if tag in {"least", "most"}:
            return self._judge_size(tag == "least", rest[0])
        if tag in {"at", "someat"}:
            return (yield from self._judge_item(rest[0], rest[1], some=tag == "someat", many=many))
        if tag in {"tail", "some"}:
            return (yield from self._judge_rest(rest[0], rest[1], some=tag == "some"))
        if tag == "contains":
            return self._judge_count(*rest)
        if tag not in {"unique", "twice"}:
            return None  # a list of values, which is no matter of length or items
        distinct = True if self._fewer_than(2) or self._layout.unique else None
        if self._layout.twice:
            distinct = False
        return distinct if tag == "unique" or distinct is None else not distinct

    def _fewer_than(self, size: int) -> bool:
        return self._layout.most is not None and self._layout.most < size

    def _judge_size(self, at_least: bool, size: int) -> bool | None:  # noqa: FBT001 - private
        if at_least:
            return (
                True if self._layout.least >= size else (False if self._fewer_than(size) else None)
            )
        if self._layout.least > size:
            return False
        return True if self._fewer_than(size + 1) else None

    def _judge_item(self, position: int, literal: Literal, *, some: bool, many: bool) -> Verdict:
        if self._fewer_than(position + 1):
            return not some
        known = self._layout.literals(position)
        there = self._layout.least > position
        if some or there:
            result = yield (*known, literal)
            if isinstance(result, Unsatisfiable):
                return False
        if many and (there or not some):
            result = yield (*known, (literal[0], not literal[1]))
            if isinstance(result, Unsatisfiable):
                return True
        return None

    def _judge_rest(self, start: int, literal: Literal, *, some: bool) -> Verdict:
        if self._fewer_than(start + 1):
            return not some
        if start < self._layout.generic:
            return None
        wanted = literal if some else (literal[0], not literal[1])
        result = yield (*self._layout.literals(start), wanted)
        return (not some) if isinstance(result, Unsatisfiable) else None

    def _judge_count(self, node: Any, least: int, most: int | None) -> bool | None:
        low, high = self._counts.get(node.number, (0, None))
        if self._layout.most is not None:
            high = self._layout.most if high is None else min(high, self._layout.most)
        if (high is not None and least > high) or (most is not None and most < low):
            return False
        if least <= low and (most is None or (high is not None and high <= most)):
            return True
        return None
