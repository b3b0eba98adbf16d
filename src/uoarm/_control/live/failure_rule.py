"""When a component that raises is degraded, lost, and well again: a rule, without I/O."""

from __future__ import annotations

from attrs import define, field

from uoarm.model import FailureLimits, Health

__all__ = ["FailureRule"]


@define
class FailureRule:
    """Judges a component by what becomes of its messages.

    It is degraded from its first failure on. A window begins there, and ends as soon as less than
    `share` of its messages have failed; the next failure begins another. When a window has lasted
    for `messages` messages and `seconds` seconds, the component is lost. When as many messages and
    seconds have passed without a failure, it is well.
    """

    limits: FailureLimits
    health: Health = Health.OK
    _began: float | None = field(default=None, init=False)
    _all: int = field(default=0, init=False)
    _failed: int = field(default=0, init=False)
    _well_since: float | None = field(default=None, init=False)
    _well: int = field(default=0, init=False)

    def note(self, taken: int, failed: int, now: float) -> bool:
        """Take in what became of some messages; say whether `health` has changed.

        Args:
            taken: how many were taken; where some failed too, these came after them.
            failed: how many the component raised on.
            now: seconds of a monotonic clock.
        """
        before = self.health
        if before is Health.LOST or (before is Health.OK and not failed):
            return False
        self._count_well(taken, failed, now)
        self._count_window(taken, failed, now)
        return self.health is not before

    def _count_well(self, taken: int, failed: int, now: float) -> None:
        if failed:
            self.health, self._well_since, self._well = Health.DEGRADED, None, 0
        if not taken:
            return
        if self._well_since is None:
            self._well_since = now
        self._well += taken
        if self._is_enough(self._well, now - self._well_since):
            self.health, self._began = Health.OK, None

    def _count_window(self, taken: int, failed: int, now: float) -> None:
        if failed and self._began is None:
            self._began, self._all, self._failed = now, 0, 0
        if self._began is None:
            return
        self._all += taken + failed
        self._failed += failed
        if self._failed < self.limits.share * self._all:
            self._began = None
        elif self._is_enough(self._all, now - self._began):
            self.health = Health.LOST

    def _is_enough(self, messages: int, seconds: float) -> bool:
        return messages >= self.limits.messages and seconds >= self.limits.seconds
