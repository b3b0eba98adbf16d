"""Judging a single demand on an array by those that are known already."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from typing import Any, TypeAlias

from uoarm.schema._branch import Atom, Literal
from uoarm.schema._layout import Layout
from uoarm.schema._results import Empty, Result
from uoarm.schema._solve import Goal

__all__ = ["ArrayView"]

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
            if isinstance(result, Empty):
                return False
        if many and (there or not some):
            result = yield (*known, (literal[0], not literal[1]))
            if isinstance(result, Empty):
                return True
        return None

    def _judge_rest(self, start: int, literal: Literal, *, some: bool) -> Verdict:
        if self._fewer_than(start + 1):
            return not some
        if start < self._layout.generic:
            return None
        wanted = literal if some else (literal[0], not literal[1])
        result = yield (*self._layout.literals(start), wanted)
        return (not some) if isinstance(result, Empty) else None

    def _judge_count(self, node: Any, least: int, most: int | None) -> bool | None:
        low, high = self._counts.get(node.number, (0, None))
        if self._layout.most is not None:
            high = self._layout.most if high is None else min(high, self._layout.most)
        if (high is not None and least > high) or (most is not None and most < low):
            return False
        if least <= low and (most is None or (high is not None and high <= most)):
            return True
        return None
