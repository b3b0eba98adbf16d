"""A small universe of JSON values, complete to its size: the oracle by brute force."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

SCALARS: Sequence[object] = (
    None, True, False, 0, 1, 2, 3, -1, 0.5, 1.5, 0.1, 10, 11, "", "a", "b", "ab", "ba", "abc",
    "a\n", "x-", "A", "\u2028", "0", "\U0001f600",
)  # fmt: skip
_FEW: Sequence[object] = (None, True, 0, 1, "", "a", [], {})
_NAMES = ("a", "b", "c")
_ABSENT = object()


def universe() -> Iterator[object]:
    """Some three thousand values: scalars, arrays of up to three, objects over three names."""
    yield from SCALARS
    for length in range(4):
        for items in product(_FEW, repeat=length):
            yield list(items)
    yield from ([value] for value in SCALARS)
    for values in product((_ABSENT, *_FEW), repeat=len(_NAMES)):
        yield {n: v for n, v in zip(_NAMES, values, strict=True) if v is not _ABSENT}
    for value in SCALARS:
        yield from ({name: value} for name in (*_NAMES, "x-a"))
    for value in _FEW:
        yield from ({"a": {name: value}} for name in _NAMES)
        yield from ({"a": [value]}, [[value]], [{"a": value}], {"x-a": value, "a": 1})
