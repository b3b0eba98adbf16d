"""How the end of a connection is judged: degraded at first, lost when its grace is over."""

from __future__ import annotations

from uoarm.model import Health

__all__ = ["Disconnection"]


class Disconnection:
    """What to report of a connection that breaks: each thing once, a loss when it lasts.

    Not up yet, up, down, given up. It has no clock and no thread: times are in seconds of one clock
    of the caller, who also guards it.

    Args:
        grace: seconds that a break may last before it is a loss.
    """

    def __init__(self, grace: float) -> None:
        self._grace = grace
        self._since: float | None = None  # down since then; None where nothing was reported
        self._was_up = False
        self._reported: Health | None = None

    @property
    def is_over(self) -> bool:
        """Whether the link was given up."""
        return self._reported is Health.LOST

    def up(self) -> Health | None:
        """The link carries messages; returns what to report, None for nothing."""
        self._was_up, self._since = True, None
        return self._report(Health.OK if self._reported is not None else None)

    def down(self, now: float, *, final: bool) -> Health | None:
        """The link broke, or an attempt to mend it failed; `final`: no attempt will do better."""
        if not self._was_up:
            # What no client has relied upon yet is not lost: a client that asks for it is refused.
            # When it comes up later, that is news.
            self._reported = self._reported or Health.DEGRADED
            return None
        self._since = now if self._since is None else self._since
        if final or now - self._since >= self._grace:
            return self._report(Health.LOST)
        return self._report(Health.DEGRADED)

    def left(self, now: float) -> float | None:
        """Return the seconds until a break is a loss; None: there is none, or it is lost."""
        if self._since is None or self.is_over:
            return None
        return max(0.0, self._since + self._grace - now)

    def _report(self, health: Health | None) -> Health | None:
        if health is self._reported or (self.is_over and health is Health.DEGRADED):
            return None
        self._reported = None if health is Health.OK else health
        return health
