"""What is to be told of a vehicle's health: no clock, no socket."""

from __future__ import annotations

from collections.abc import Sequence

from attrs import define, field

from uoarm.model import Health

__all__ = ["VehicleHealth"]


@define
class VehicleHealth:
    """What ails a vehicle that is connected: fatal errors, silence, states that cannot be read.

    Attributes:
        timeout: seconds of silence after which it is told.
    """

    timeout: float
    _heard: float | None = None  # the last state, or since when one is awaited; None: not awaited
    _ails: dict[str, str] = field(factory=dict)
    _told: str = ""

    def connected(self, now: float) -> None:
        """The vehicle has come: states are awaited, and nothing is known of it."""
        self._heard, self._told = now, ""
        self._ails.clear()

    def gone(self) -> None:
        """The vehicle has gone, which is told in another way."""
        self._heard, self._told = None, ""
        self._ails.clear()

    def state(self, fatal: Sequence[str], now: float) -> tuple[Health, str] | None:
        """Take a state with its fatal errors; return what to tell, None for nothing."""
        self._heard = now
        self._ails.clear()
        if fatal:
            self._ails["fatal"] = f"fatal: {'; '.join(fatal)[:500]}"
        return self._news()

    def unreadable(self, why: str) -> tuple[Health, str] | None:
        """Take the news that a state cannot be read; return what to tell."""
        self._ails["unreadable"] = f"its state cannot be read: {why}"[:500]
        return self._news()

    def tick(self, now: float) -> tuple[Health, str] | None:
        """Let time pass; return what to tell."""
        due = self.wake_at()
        if due is not None and now >= due:
            what = "no state that can be read" if "unreadable" in self._ails else "no state"
            self._ails["silent"] = f"{what} within {self.timeout:g} s"
        return self._news()

    def wake_at(self) -> float | None:
        """Return when `tick` is due, None for never."""
        if self._heard is None or "silent" in self._ails:
            return None
        return self._heard + self.timeout

    def _news(self) -> tuple[Health, str] | None:
        text = "; ".join(self._ails.values())
        if text == self._told:
            return None
        self._told = text
        return (Health.DEGRADED, text) if text else (Health.OK, "nothing ails it any more")
