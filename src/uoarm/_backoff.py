"""The one schedule of attempts that are made again: pauses that grow, as data, without a clock."""

from __future__ import annotations

import math
from random import Random

from attrs import field, frozen
from attrs.validators import ge, gt, le

__all__ = ["Backoff"]


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
