"""What judges the health of channels here: the contract's rules, with the words of ROS 2."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from functools import partial

from uoarm.bridge import Channel, ChannelHealth, ChannelMonitor
from uoarm.model import Health

_LEAST_SECONDS = 1.0  # no silence is shorter, whatever the rate: a busy machine has pauses
_DEADLINES = 3
PROMISED = f", {_DEADLINES} times the deadline of its QoS (stale_after)"
"""What ends the words on a silence that was measured by deadlines."""
Report = Callable[[Channel, Health, str], None]


class SimulatedClock:
    """Seconds that `/clock` has counted: they stand while it does, and never go back.

    Attributes:
        begins_again: called where it goes back, in the thread that takes its times.
    """

    def __init__(self) -> None:
        self._seconds = 0.0
        self._last: int | None = None
        self.begins_again: Callable[[], object] = lambda: None

    def take(self, nanoseconds: int) -> None:
        """Take a time of the simulation; one that is earlier is that of another run."""
        last, self._last = self._last, nanoseconds
        if last is not None:
            self._seconds += max(0, nanoseconds - last) / 1e9
            if nanoseconds < last:
                self.begins_again()

    def __call__(self) -> float:
        return self._seconds


def monitored(
    what: str,
    channel: Channel,
    report: Report,
    *,
    without_peers: Health = Health.LOST,
    stale_after: float | None = None,
    learns: bool = False,
    clock: Callable[[], float] = time.monotonic,
) -> ChannelMonitor:
    """Return what judges a channel. What is lost may come back: DDS matches peers anew.

    Args:
        what: it leads to.
        channel: that is judged.
        report: takes each change.
        without_peers: how it is when its last peer has gone.
        stale_after: seconds without a message that make it lost; None: any number.
        learns: whether messages come in here, so that silence means something.
        clock: seconds that only grow.
    """
    health = ChannelHealth(
        what,
        clock(),
        stale_after=stale_after,
        without_peers=without_peers,
        recovers=True,
        learns=learns,
    )
    return ChannelMonitor(health, partial(report, channel), clock)


def promised_silence(deadlines: Iterable[float | None]) -> float | None:
    """Return after which silence a topic is lost whose publishers all promise a message sooner.

    That is three times the longest `deadline` of their QoS; None: not all promise.
    """
    stated = list(deadlines)
    known = [deadline for deadline in stated if deadline is not None]
    if not known or len(known) < len(stated):
        return None
    return max(_LEAST_SECONDS, _DEADLINES * max(known))
