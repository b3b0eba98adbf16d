"""Counts the turns of a loop that waits, and how many of them ended early with nothing to do."""

from __future__ import annotations

from attrs import frozen

__all__ = ["TurnCounter", "Turns"]

_FIRST_REST_SECONDS = 0.001
_LONGEST_REST_SECONDS = 0.02


@frozen
class Turns:
    """Turns of a loop.

    Attributes:
        all: how many there were.
        empty: how many of them ended before their time and found nothing to do.
    """

    all: int
    empty: int


class TurnCounter:
    """Counts the turns of a loop, and says how long it rests so that it never spins.

    What ends every wait and is never taken would make the loop turn without work, for a whole core.
    One such turn is no harm, many in a row are: they come further and further apart, up to 20 ms.

    `add` is for the loop's thread alone, `turns` for any thread.
    """

    def __init__(self) -> None:
        self._all = 0
        self._empty = 0
        self._in_a_row = 0

    @property
    def turns(self) -> Turns:
        """What was counted."""
        return Turns(self._all, self._empty)

    def add(self, *, empty: bool, complete: bool = True) -> float:
        """Count one turn; return how many seconds to rest after it.

        Args:
            empty: whether it ended before its time and found nothing to do.
            complete: whether it waited for all there is; where not, the next turn does instead.
        """
        self._all += 1
        if not empty:
            self._in_a_row = 0
            return 0.0
        self._empty += 1
        if not complete:
            return 0.0
        self._in_a_row += 1
        if self._in_a_row == 1:
            return 0.0
        exponent = min(self._in_a_row - 2, 16)  # the limit is reached long before
        return min(_LONGEST_REST_SECONDS, _FIRST_REST_SECONDS * 2.0**exponent)
