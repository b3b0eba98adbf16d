"""The health of flows and of a line, without any I/O: silence, heartbeat, sequence numbers, ids."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable

from attrs import define

from uoarm.bridge import ChannelHealth, ChannelMonitor
from uoarm.model import Health

_PERIODS = 5
_LEAST_SILENCE = 1.0


def flow_monitor(
    what: str, period: float | None, grace: float, report: Callable[[Health, str], None]
) -> ChannelMonitor:
    """Return what judges a flow: silent after five of its periods, lost after its grace."""
    stale_after = None if period is None else max(_PERIODS * period, _LEAST_SILENCE)
    health = ChannelHealth(what, time.monotonic(), stale_after=stale_after, grace=grace)
    return ChannelMonitor(health, report)


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
