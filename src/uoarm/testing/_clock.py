"""A clock that stands still until a test moves it."""

from __future__ import annotations

from uoarm._arguments import arguments

__all__ = ["ManualClock"]


class ManualClock:
    """Seconds that only a test moves; callable, so that it fits wherever a clock is injected."""

    @arguments()
    def __init__(self, start: float = 0.0) -> None:
        self._now = start

    def __call__(self) -> float:
        """Return the seconds that it shows."""
        return self._now

    def now(self) -> float:
        """Return the seconds that it shows."""
        return self._now

    def advance(self, seconds: float) -> float:
        """Move it forward and return what it shows then.

        Raises:
            ValueError: the step is negative; time only grows.
        """
        if not seconds >= 0:
            raise ValueError(f"a clock cannot be advanced by {seconds} s")
        self._now += seconds
        return self._now
