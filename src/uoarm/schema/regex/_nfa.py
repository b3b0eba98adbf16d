"""Nondeterministic automata with assertions, and how a pattern is wrong or not decided."""

from __future__ import annotations

import sys
import unicodedata
from bisect import bisect_right
from collections.abc import Iterator
from functools import cached_property, lru_cache
from itertools import groupby
from typing import TypeAlias

CharSet: TypeAlias = "tuple[tuple[int, int], ...]"

_LAST = 0x10FFFF
ANY: CharSet = ((0, _LAST),)


def union(first: CharSet, second: CharSet) -> CharSet:
    merged: list[tuple[int, int]] = []
    for low, high in sorted((*first, *second)):
        if merged and low <= merged[-1][1] + 1:
            merged[-1] = (merged[-1][0], max(high, merged[-1][1]))
        else:
            merged.append((low, high))
    return tuple(merged)


def complement(chars: CharSet) -> CharSet:
    gaps: list[tuple[int, int]] = []
    start = 0
    for low, high in union(chars, ()):
        if low > start:
            gaps.append((start, low - 1))
        start = high + 1
    if start <= _LAST:
        gaps.append((start, _LAST))
    return tuple(gaps)


def contains(chars: CharSet, code: int) -> bool:
    """Say whether a code point is in the set."""
    place = bisect_right(chars, (code, _LAST))
    return place > 0 and chars[place - 1][1] >= code


_DIGIT: CharSet = ((0x30, 0x39),)
_WORD: CharSet = union(((0x30, 0x39), (0x41, 0x5A), (0x5F, 0x5F), (0x61, 0x7A)), ())
_SPACE: CharSet = union(
    (
        (0x09, 0x0D), (0x20, 0x20), (0xA0, 0xA0), (0x1680, 0x1680), (0x2000, 0x200A),
        (0x2028, 0x2029), (0x202F, 0x202F), (0x205F, 0x205F), (0x3000, 0x3000), (0xFEFF, 0xFEFF),
    ),
    (),
)  # fmt: skip
DOT: CharSet = complement(((0x0A, 0x0A), (0x0D, 0x0D), (0x2028, 0x2029)))
CLASSES = {
    "d": _DIGIT,
    "D": complement(_DIGIT),
    "w": _WORD,
    "W": complement(_WORD),
    "s": _SPACE,
    "S": complement(_SPACE),
}


_NAMES = {
    "Cased_Letter": "LC", "Close_Punctuation": "Pe", "Connector_Punctuation": "Pc", "Control": "Cc",
    "Currency_Symbol": "Sc", "Dash_Punctuation": "Pd", "Decimal_Number": "Nd",
    "Enclosing_Mark": "Me", "Final_Punctuation": "Pf", "Format": "Cf", "Initial_Punctuation": "Pi",
    "Letter": "L", "Letter_Number": "Nl", "Line_Separator": "Zl", "Lowercase_Letter": "Ll",
    "Mark": "M", "Math_Symbol": "Sm", "Modifier_Letter": "Lm", "Modifier_Symbol": "Sk",
    "Nonspacing_Mark": "Mn", "Number": "N", "Open_Punctuation": "Ps", "Other": "C",
    "Other_Letter": "Lo", "Other_Number": "No", "Other_Punctuation": "Po", "Other_Symbol": "So",
    "Paragraph_Separator": "Zp", "Private_Use": "Co", "Punctuation": "P", "Separator": "Z",
    "Space_Separator": "Zs", "Spacing_Mark": "Mc", "Surrogate": "Cs", "Symbol": "S",
    "Titlecase_Letter": "Lt", "Unassigned": "Cn", "Uppercase_Letter": "Lu",
    "Combining_Mark": "M", "cntrl": "Cc", "digit": "Nd", "punct": "P",
}  # fmt: skip


@lru_cache(maxsize=128)
def property_chars(text: str) -> CharSet | None:
    """Return the characters of a property as it stands between the braces; None when unknown."""
    key, _, value = text.rpartition("=")
    if key not in {"", "General_Category", "gc"}:
        return None
    if not key and value == "ASCII":
        return ((0, 0x7F),)
    if not key and value == "Any":
        return ANY
    wanted = _NAMES.get(value, value)
    parts = ("Lu", "Ll", "Lt") if wanted == "LC" else (wanted,)
    found: CharSet = ()
    for name, chars in _categories().items():
        if name in parts or name[0] in parts:
            found = union(found, chars)
    return found or None


@lru_cache(maxsize=1)
def _categories() -> dict[str, CharSet]:
    """Return the characters of each two-letter category."""
    ranges: dict[str, list[tuple[int, int]]] = {}
    start = 0
    for name, run in groupby(map(unicodedata.category, map(chr, range(sys.maxunicode + 1)))):
        end = start + sum(1 for _ in run)
        ranges.setdefault(name, []).append((start, end - 1))
        start = end
    return {name: tuple(found) for name, found in ranges.items()}


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

    @cached_property
    def weight(self) -> int:
        """Its states, with those of what it looks ahead with: asked for once it is complete."""
        return sum(len(part.always) for part in self.parts())

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

    def sees_words(self) -> bool:
        """Say whether it matters where words begin and end."""
        return any(
            kind in {"boundary", "inside"}
            for part in self.parts()
            for asserts in part.asserts
            for kind, _ in asserts
        )
