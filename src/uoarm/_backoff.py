"""Pauses, as data without a clock: between attempts, and between turns of a loop that waits."""

from __future__ import annotations

import math
from random import Random

from attrs import field, frozen
from attrs.validators import ge, gt, le

_FIRST_REST_SECONDS = 0.001
_LONGEST_REST_SECONDS = 0.02


@frozen
class Backoff:
    """Seconds between attempts: each pause is `factor` times the one before, `most` at the most.

    Attributes:
        first: the pause after the first attempt that failed.
        most: the longest pause.
        factor: by which each is longer than the one before.
        jitter: the part of each pause, 0 to 1, by which it may be shorter: so that many that lost
            the same peer do not come back to it at once.
        seed: from which it follows how much shorter each is; the same seed gives the same pauses.
    """

    first: float = field(default=0.1, validator=gt(0))
    most: float = field(default=2.0, validator=gt(0))
    factor: float = field(default=2.0, validator=ge(1))
    jitter: float = field(default=0.0, validator=[ge(0), le(1)])
    seed: int = 0

    def pause(self, failed: int) -> float:
        """Return how long to wait after so many attempts failed in a row; 1: the first did."""
        steps = max(0, failed - 1)
        reached = steps * math.log(self.factor) >= math.log(max(1.0, self.most / self.first))
        pause = self.most if reached else min(self.most, self.first * self.factor**steps)
        if not self.jitter:
            return pause
        part = Random(f"{self.seed}/{steps}").random()  # noqa: S311 - spreads load, is no secret
        return pause * (1 - self.jitter * part)


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
