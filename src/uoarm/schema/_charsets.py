"""Sets of characters as sorted ranges of code points."""

from __future__ import annotations

from bisect import bisect_right
from typing import TypeAlias

__all__ = ["ANY", "CLASSES", "DOT", "CharSet", "complement", "contains", "union"]

CharSet: TypeAlias = "tuple[tuple[int, int], ...]"

_LAST = 0x10FFFF
ANY: CharSet = ((0, _LAST),)


def union(one: CharSet, other: CharSet) -> CharSet:
    """Return the characters of either set."""
    merged: list[tuple[int, int]] = []
    for low, high in sorted((*one, *other)):
        if merged and low <= merged[-1][1] + 1:
            merged[-1] = (merged[-1][0], max(high, merged[-1][1]))
        else:
            merged.append((low, high))
    return tuple(merged)


def complement(chars: CharSet) -> CharSet:
    """Return every other character."""
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
