"""When messages that wait for a busy loop are let go of, so that what is handed out is new."""

from __future__ import annotations

import math

__all__ = ["Backlog"]

_FRESH = 16
_LATE_SECONDS = 0.1
_PATIENCE_SECONDS = 1.0


class Backlog:
    """Tells a backlog that stands from one that is being worked off.

    A loop that can just keep up never works off what came in its one longest delay, and everything
    after it is as late. So where what is looked at has been late, more than 0.1 s old, for as long
    as makes a second in all, it is to be let go of: then, and until nothing waits any more, all
    that is late, save the newest 16. A delay that ends within the second costs nothing.

    It knows no clock: times are seconds of one clock, and do not go back.
    """

    def __init__(self) -> None:
        self._late_since = math.inf
        self._stands = False

    def lets_go(self, waiting: int, came: float, now: float) -> bool:
        """Say whether to let go of the oldest message; to be asked about each before it is handed.

        Args:
            waiting: messages, with the oldest.
            came: when the oldest did.
            now: the time.
        """
        if waiting <= _FRESH:
            return False
        if now - came <= _LATE_SECONDS:
            self._late_since = math.inf
            return False
        self._late_since = min(self._late_since, came + _LATE_SECONDS)
        self._stands |= now - self._late_since >= _PATIENCE_SECONDS - _LATE_SECONDS
        return self._stands

    def worked_off(self) -> None:
        """Note that nothing waits."""
        self._late_since = math.inf
        self._stands = False
