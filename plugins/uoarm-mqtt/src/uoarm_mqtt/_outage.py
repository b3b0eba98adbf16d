"""What is to be told when the link breaks, stays broken, and is mended: no clock, no socket."""

from __future__ import annotations

from uoarm.model import Health

__all__ = ["Outage"]


class Outage:
    """The states of a link: not up yet, up, down, given up. Times are in seconds of one clock."""

    def __init__(self, grace: float) -> None:
        self._grace = grace
        self._since: float | None = None  # down since then; None where nothing was told
        self._was_up = False
        self._told: Health | None = None

    @property
    def is_over(self) -> bool:
        """Whether the link was given up."""
        return self._told is Health.LOST

    def up(self) -> Health | None:
        """The link carries messages; returns what to tell, None for nothing."""
        self._was_up, self._since = True, None
        return self._tell(Health.OK if self._told is not None else None)

    def down(self, now: float, *, final: bool) -> Health | None:
        """The link broke, or an attempt to mend it failed; `final`: no attempt will do better."""
        if not self._was_up:
            # What nobody has relied upon yet is not lost: whoever asks for it is refused. When
            # it comes up later, that is news.
            self._told = self._told or Health.DEGRADED
            return None
        self._since = now if self._since is None else self._since
        if final or now - self._since >= self._grace:
            return self._tell(Health.LOST)
        return self._tell(Health.DEGRADED)

    def _tell(self, health: Health | None) -> Health | None:
        if health is self._told or (self.is_over and health is Health.DEGRADED):
            return None
        self._told = None if health is Health.OK else health
        return health
