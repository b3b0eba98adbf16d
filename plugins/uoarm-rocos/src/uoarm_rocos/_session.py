"""What one line's conversation keeps count of, without any I/O: numbers, times, ids."""

from __future__ import annotations

import itertools

from attrs import define

__all__ = ["Ids", "Incoming", "Watch"]

_WRAP = 2**32
_DEAD_AFTER = 3.5


@define
class Incoming:
    """Sequence numbers of the other side.

    Attributes:
        lost: messages that never came.
    """

    lost: int = 0
    _expected: int | None = None

    def take(self, seq: int) -> bool:
        """Count a message; return whether the other side has begun anew."""
        again = seq == 0 and self._expected not in {None, 0}
        if self._expected is not None and not again:
            self.lost += (seq - self._expected) % _WRAP
        self._expected = (seq + 1) % _WRAP
        return again


class Ids:
    """Ids of conversations: 1 to 4294967295, none used again soon. Any thread."""

    def __init__(self) -> None:
        self._count = itertools.count()

    def next(self) -> int:
        """Return the next id."""
        return next(self._count) % (_WRAP - 1) + 1


@define
class Watch:
    """Who has said something when; times in seconds of one monotonic clock.

    Attributes:
        period: the heartbeat.
        sent: when this side last said something.
        heard: when the other side last did.
    """

    period: float
    sent: float
    heard: float

    def must_speak(self, now: float) -> bool:
        """Say whether a heartbeat is due."""
        return now - self.sent >= self.period

    def dead(self, now: float) -> float:
        """Return for how long the other side has been silent if that is too long, else 0."""
        silent = now - self.heard
        return silent if silent > _DEAD_AFTER * self.period else 0.0
