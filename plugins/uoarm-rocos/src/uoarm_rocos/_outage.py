"""How long a line has been away: degraded at first, lost when its grace is over."""

from __future__ import annotations

from uoarm.model import Health

__all__ = ["Outage"]


class Outage:
    """Says each thing once for each time that the line is away. Used by one thread.

    Args:
        grace: seconds for a fault to pass.
    """

    def __init__(self, grace: float) -> None:
        self._grace = grace
        self._since: float | None = None
        self._said: Health | None = None

    def end(self) -> None:
        """Take note that the line is back."""
        self._since = self._said = None

    def news(self, now: float) -> Health | None:
        """Take note that the line is away; return what that is if it was not said before."""
        if self._since is None:
            self._since = now
        health = Health.LOST if now - self._since >= self._grace else Health.DEGRADED
        if health is self._said:
            return None
        self._said = health
        return health
