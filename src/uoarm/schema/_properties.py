r"""Unicode properties of `\p{...}`: the general categories, by the tables of this Python."""

from __future__ import annotations

import sys
import unicodedata
from functools import lru_cache
from itertools import groupby

from uoarm.schema._charsets import ANY, CharSet, union

__all__ = ["property_chars"]

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
