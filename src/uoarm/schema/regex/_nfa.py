"""Nondeterministic automata with assertions, and how a pattern is wrong or not decided."""

from __future__ import annotations

from collections.abc import Iterator

from uoarm.schema.regex._charsets import CharSet

__all__ = ["MalformedPatternError", "Nfa", "UnsupportedPatternError"]

_MAX_STATES = 20_000


class UnsupportedPatternError(ValueError):
    """The pattern is no regular expression, or not one that is decided here."""


class MalformedPatternError(UnsupportedPatternError):
    """The pattern breaks the grammar."""


class Nfa:
    """States with edges.

    `always` edges are free; `asserts` are free where an assertion holds ("begin", "end",
    "boundary", "inside"); `looks` are free where what follows begins with a match of another
    automaton, or does not. The last state is never left again. `disputed` says that an engine which
    is not one of ECMA-262 reads the pattern otherwise.
    """

    def __init__(self) -> None:
        self.always: list[list[int]] = []
        self.asserts: list[list[tuple[str, int]]] = []
        self.looks: list[list[tuple[bool, Nfa, int]]] = []
        self.edges: list[list[tuple[CharSet, int]]] = []
        self.first = self.last = 0
        self.disputed = False

    def state(self) -> int:
        """Add a state and return it."""
        if len(self.always) >= _MAX_STATES:
            raise UnsupportedPatternError("the pattern is too large")
        self.always.append([])
        self.asserts.append([])
        self.looks.append([])
        self.edges.append([])
        return len(self.always) - 1

    def copy(self, start: int, size: int) -> None:
        """Add a copy of some states in a row, of which no edge leads to another.

        A look ahead is shared by the copies.
        """
        at = len(self.always) - start
        for index in range(start, start + size):
            self.state()
            self.always[-1].extend(to + at for to in self.always[index])
            self.asserts[-1].extend((kind, to + at) for kind, to in self.asserts[index])
            self.looks[-1].extend((sign, inner, to + at) for sign, inner, to in self.looks[index])
            self.edges[-1].extend((chars, to + at) for chars, to in self.edges[index])

    def parts(self) -> Iterator[Nfa]:
        """Yield this automaton and all that it looks ahead with."""
        waiting = [self]
        seen = {id(self)}  # copies of a look ahead share their automaton
        for nfa in waiting:
            yield nfa
            for looks in nfa.looks:
                for _, inner, _ in looks:
                    if id(inner) not in seen:
                        seen.add(id(inner))
                        waiting.append(inner)

    def looks_ahead(self) -> bool:
        """Say whether there is a look ahead."""
        return any(self.looks)

    def sees_words(self) -> bool:
        """Say whether it matters where words begin and end."""
        return any(
            kind in {"boundary", "inside"}
            for part in self.parts()
            for asserts in part.asserts
            for kind, _ in asserts
        )
