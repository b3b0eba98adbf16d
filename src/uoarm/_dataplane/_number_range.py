"""Ranges of numbers: of one, of a list at the speed of C, of an array of numpy by its type."""

from __future__ import annotations

import math
from typing import Any

from attrs import frozen

__all__ = ["NumberRange"]


@frozen
class NumberRange:
    """Which numbers: `low <= x <= high`, and perhaps those that are not finite."""

    kinds: frozenset[type]
    low: float
    high: float
    any_nonfinite: bool
    bounded: bool

    def accepts(self, value: Any) -> bool:
        kind: Any = value.__class__
        if kind not in self.kinds:
            return False
        return self.low <= value <= self.high or (
            kind is float
            and (not self.bounded or (self.any_nonfinite and not math.isfinite(value)))
        )

    def accepts_all(self, values: list[Any] | tuple[Any, ...]) -> bool:
        """Judge a list at the speed of C, by its kinds and its extremes."""
        if not self.kinds.issuperset(map(type, values)):
            return False
        if not self.bounded or not values:
            return True
        low, high = self.low, self.high
        if self.any_nonfinite:
            return not any(
                map(math.isfinite, [value for value in values if not low <= value <= high])
            )
        if not (low <= min(values) and max(values) <= high):
            return False
        try:
            return not math.isnan(sum(values))  # as it is wherever one of them is
        except OverflowError:
            return False

    def accepts_buffer(self, buffer: Any) -> bool:
        """Judge an array of numpy by what its type can hold, else by its extremes."""
        kind = buffer.dtype.kind
        if kind == "f":
            if float not in self.kinds:
                return False
            if not self.bounded:
                return True
            limit = _float_limit(buffer.dtype)
            if self.any_nonfinite:
                return self.low <= -limit and limit <= self.high
        elif kind in "iu":
            bits = 8 * buffer.dtype.itemsize
            low, high = (
                (0, 2**bits - 1) if kind == "u" else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
            )
            if self.low <= low and high <= self.high:
                return True
        else:
            return False
        if not buffer.size:
            return True
        # NaN is the least and the greatest of an array that has one, and within no range.
        return bool(self.low <= buffer.min().item() and buffer.max().item() <= self.high)


def _float_limit(dtype: Any) -> float:
    return 3.4028234663852886e38 if dtype.itemsize <= 4 else math.inf  # noqa: PLR2004 - float32
