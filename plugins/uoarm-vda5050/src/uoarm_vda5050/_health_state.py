"""What is to be reported of a vehicle's health: no clock, no socket."""

from __future__ import annotations

from collections.abc import Sequence

from attrs import define, field

from uoarm.model import Health

__all__ = ["VehicleHealth"]


@define
class VehicleHealth:
    """What ails a vehicle that is connected: fatal errors, silence, states that cannot be read.

    Attributes:
        timeout: seconds of silence after which it is reported.
    """

    timeout: float
    _last_state: float | None = (
        None  # the last state, or since when one is awaited; None: not awaited
    )
    _problems: dict[str, str] = field(factory=dict)
    _reported: str = ""

    def connected(self, now: float) -> None:
        """The vehicle has come: states are awaited, and nothing is known of it."""
        self._last_state, self._reported = now, ""
        self._problems.clear()

    def gone(self) -> None:
        """The vehicle has gone, which is reported in another way."""
        self._last_state, self._reported = None, ""
        self._problems.clear()

    def state(self, fatal: Sequence[str], now: float) -> tuple[Health, str] | None:
        """Take a state with its fatal errors; return what to report, None for nothing."""
        self._last_state = now
        self._problems.clear()
        if fatal:
            self._problems["fatal"] = f"fatal: {'; '.join(fatal)[:500]}"
        return self._news()

    def unreadable(self, why: str) -> tuple[Health, str] | None:
        """Take the news that a state cannot be read; return what to report."""
        self._problems["unreadable"] = f"its state cannot be read: {why}"[:500]
        return self._news()

    def tick(self, now: float) -> tuple[Health, str] | None:
        """Let time pass; return what to report."""
        due = self.wake_at()
        if due is not None and now >= due:
            what = "no state that can be read" if "unreadable" in self._problems else "no state"
            self._problems["silent"] = f"{what} within {self.timeout:g} s"
        return self._news()

    def wake_at(self) -> float | None:
        """Return when `tick` is due, None for never."""
        if self._last_state is None or "silent" in self._problems:
            return None
        return self._last_state + self.timeout

    def _news(self) -> tuple[Health, str] | None:
        text = "; ".join(self._problems.values())
        if text == self._reported:
            return None
        self._reported = text
        return (Health.DEGRADED, text) if text else (Health.OK, "nothing ails it any more")
