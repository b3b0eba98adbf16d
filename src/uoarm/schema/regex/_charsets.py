r"""Sets of characters as sorted ranges of code points, and those that `\p{...}` names.

The general categories are those of the tables of this Python.
"""

from __future__ import annotations

import sys
import unicodedata
from bisect import bisect_right
from functools import lru_cache
from itertools import groupby
from typing import TypeAlias

__all__ = ["ANY", "CLASSES", "DOT", "CharSet", "complement", "contains", "property_chars", "union"]

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
