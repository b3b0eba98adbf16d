"""What JSON text would cost, found before a parser is let loose on it.

Everything here is a few passes in C over the text. Whatever a scan takes for a string ends where
the parser's does, up to the first mistake in the text, and there the parser stops.
"""

from __future__ import annotations

import re
from array import array
from itertools import accumulate

from uoarm.errors import ControlMessageError
from uoarm.model._budget import Spending

__all__ = ["count_names", "scan_json"]

_STRING = re.compile(r'"[^"]*(?:"|\Z)')
_BRACKETS = bytes.maketrans(b"[{]}", b"\x01\x01\xff\xff")
_OTHERS = bytes(index for index in range(256) if index not in b"[{]}")


def scan_json(text: str, spending: Spending) -> None:
    """Refuse text that would cost more than its budget; spend what it costs otherwise.

    Linear in the length of the text, and without a pass over its strings where that is not needed:
    brackets, commas and colons within them count as if they stood outside, unless the budget would
    not allow it.

    Raises:
        ControlMessageError: it holds too much, or is nested too deep.
    """
    opened = text.count("[") + text.count("{")
    elements = 1 + opened + text.count(",") + text.count(":")
    left = spending.budget.elements - spending.elements
    if elements > left or opened > spending.budget.depth:
        outside = _without_strings(text, 2 * left)
        opened = outside.count("[") + outside.count("{")
        elements = 1 + opened + outside.count(",") + outside.count(":")
        spending.add(elements)
        if opened > spending.budget.depth:
            spending.depth(_depth(outside))
    else:
        spending.add(elements)


def count_names(text: str) -> int:
    """Return how many names of members JSON text has, those that are given twice included."""
    return _without_strings(text, len(text)).count(":")


def _without_strings(text: str, quotes: int) -> str:
    """Return what stands outside of strings; each string is a value or a name."""
    plain = text
    if "\\" in text:
        plain = text.replace("\\\\", "").replace('\\"', "")
    if plain.count('"') > quotes:
        raise ControlMessageError(f"it holds more than {quotes // 2:,} texts")
    return _STRING.sub("", plain)


def _depth(outside: str) -> int:
    steps = outside.encode("utf-8", "replace").translate(_BRACKETS, _OTHERS)
    return max(accumulate(array("b", steps)), default=0)
