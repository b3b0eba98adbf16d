"""A cache that is bounded by what its entries weigh, for patterns of very different size."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from threading import Lock
from typing import Generic, TypeVar

__all__ = ["Kept"]

T = TypeVar("T")


class Kept(Generic[T]):
    """Makes what belongs to a text, and keeps it until others weigh too much.

    May be called from several threads; two of them may make the same thing at once.

    Args:
        make: makes it; what it raises is not kept.
        weigh: says how much it weighs, which may grow.
        most: what all may weigh together.
    """

    def __init__(self, make: Callable[[str], T], weigh: Callable[[T], int], most: int) -> None:
        self._make = make
        self._weigh = weigh
        self._most = most
        self._lock = Lock()
        self._kept: OrderedDict[str, T] = OrderedDict()

    def __call__(self, text: str) -> T:
        """Return what belongs to a text."""
        with self._lock:
            found = self._kept.get(text)
            if found is not None:
                self._kept.move_to_end(text)
                return found
        made = self._make(text)
        with self._lock:
            self._kept[text] = made
            weight = sum(self._weigh(item) for item in self._kept.values())
            while weight > self._most and len(self._kept) > 1:
                weight -= self._weigh(self._kept.popitem(last=False)[1])
        return made

    def cache_clear(self) -> None:
        """Forget everything."""
        with self._lock:
            self._kept.clear()
