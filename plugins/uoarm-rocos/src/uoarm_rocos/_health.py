"""The health of a line, without any I/O: its grace, heartbeat, sequence numbers and ids."""

from __future__ import annotations

import itertools

from attrs import define

from uoarm.model import Health

__all__ = ["ConversationIds", "HeartbeatWatch", "LineDisconnection", "SequenceCheck"]


class LineDisconnection:
    """Reports each state once while the line is away: degraded, then lost. Used by one thread.

    Args:
        grace: seconds for a fault to pass.
    """

    def __init__(self, grace: float) -> None:
        self._grace = grace
        self._since: float | None = None
        self._said: Health | None = None

    def restored(self) -> None:
        """Take note that the line is back."""
        self._since = self._said = None

    def lost(self, now: float) -> Health | None:
        """Take note that the line is away; return its health if that is new."""
        if self._since is None:
            self._since = now
        health = Health.LOST if now - self._since >= self._grace else Health.DEGRADED
        if health is self._said:
            return None
        self._said = health
        return health


_WRAP = 2**32
_DEAD_AFTER = 3.5


@define
class SequenceCheck:
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


class ConversationIds:
    """Ids of conversations: 1 to 4294967295, none used again soon. Any thread."""

    def __init__(self) -> None:
        self._count = itertools.count()

    def next(self) -> int:
        """Return the next id."""
        return next(self._count) % (_WRAP - 1) + 1


@define
class HeartbeatWatch:
    """When each side last sent something; times in seconds of one monotonic clock.

    Attributes:
        period: the heartbeat.
        sent: when this side last said something.
        received_at: when the other side last did.
    """

    period: float
    sent: float
    received_at: float

    def is_heartbeat_due(self, now: float) -> bool:
        """Say whether a heartbeat is due."""
        return now - self.sent >= self.period

    def dead(self, now: float) -> float:
        """Return for how long the other side has been silent if that is too long, else 0."""
        silent = now - self.received_at
        return silent if silent > _DEAD_AFTER * self.period else 0.0
