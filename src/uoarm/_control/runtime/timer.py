"""One thread that tells when a time is reached."""

from __future__ import annotations

import threading
from collections.abc import Callable

from uoarm._dataplane import Clock

__all__ = ["Timer"]

_LEAST_SECONDS = 0.02


class Timer:
    """Calls back at the earliest of the times asked for, then waits to be asked again.

    It may call early where the clock is not the machine's own: whoever is called looks at the
    clock. Times that lie close together are one call, since each has everything looked at that
    waits. The thread begins with the first time asked for.

    Args:
        clock: seconds.
        reached: called in the timer's thread.
    """

    def __init__(self, clock: Clock, reached: Callable[[], None]) -> None:
        self._clock = clock
        self._reached = reached
        self._changed = threading.Condition(threading.Lock())
        self._due: float | None = None
        self._is_closed = False
        self._thread: threading.Thread | None = None

    def wake_at(self, time: float) -> None:
        """Call back at this time, or at an earlier one asked for. Any thread."""
        with self._changed:
            if self._is_closed or (self._due is not None and self._due <= time):
                return
            self._due = time
            self._changed.notify()
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="uoarm-control", daemon=True)
                self._thread.start()

    def close(self) -> None:
        """Call back no more. Idempotent."""
        with self._changed:
            self._is_closed = True
            self._changed.notify()

    def _run(self) -> None:
        while self._wait():
            self._reached()

    def _wait(self) -> bool:
        """Wait until the earliest time; False when there will be none."""
        with self._changed:
            while not self._is_closed:
                if self._due is None:
                    self._changed.wait()
                    continue
                seconds = max(_LEAST_SECONDS, self._due - self._clock())
                if not self._changed.wait(seconds):
                    self._due = None
                    return True
            return False
