"""When a bridge that died may be started again: at once, later and later, at last never."""

from __future__ import annotations

import threading

from attrs import define

from uoarm._dataplane import Clock
from uoarm.errors import BridgeError, FailureReason

__all__ = ["Restarts"]

_FIRST_DELAY_SECONDS = 0.25
_LAST_DELAY_SECONDS = 30.0
_HEALTHY_SECONDS = 60.0


@define
class _Record:
    """What is known of one bridge: its deaths in a row, and when it began and ended last."""

    deaths: int = 0
    began: float = 0.0
    ended: float = 0.0
    cause: str = ""


class Restarts:
    """Keeps a bridge that dies again and again from being started again and again.

    The first restart is free. Each later one waits twice as long as the one before, from 0.25 s
    to 30 s. A bridge that has lived for a minute starts with a clean record.

    Args:
        clock: a monotonic clock, in seconds.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._records: dict[str, _Record] = {}

    def began(self, name: str) -> None:
        """Note that a bridge is being started."""
        with self._lock:
            self._records.setdefault(name, _Record()).began = self._clock()

    def died(self, name: str, cause: str) -> None:
        """Note that a bridge died, or did not come to life."""
        with self._lock:
            record = self._records.setdefault(name, _Record())
            now = self._clock()
            lived = now - record.began
            record.deaths = 1 if lived >= _HEALTHY_SECONDS else record.deaths + 1
            record.ended, record.cause = now, cause

    def check(self, name: str, limit: int) -> None:
        """Let a bridge be started now, or say why not.

        Args:
            name: of the bridge.
            limit: deaths in a row after which it is given up.

        Raises:
            BridgeError: it must wait, or is given up; the text has the last cause of death.
        """
        with self._lock:
            record = self._records.get(name)
            if record is None or record.deaths == 0:
                return
            deaths, cause = record.deaths, record.cause
            due = record.ended + _delay(deaths)
        if deaths >= limit:
            text = f"bridge {name!r} is given up: it died {deaths} times in a row, at last: {cause}"
            raise BridgeError(text, FailureReason.UNAVAILABLE)
        wait = due - self._clock()
        if wait > 0:
            text = (
                f"bridge {name!r} died {deaths} times in a row and is started again in "
                f"{wait:.2g} s at the earliest; it died because {cause}"
            )
            raise BridgeError(text, FailureReason.UNAVAILABLE)


def _delay(deaths: int) -> float:
    if deaths <= 1:
        return 0.0
    doubled: float = _FIRST_DELAY_SECONDS * 2.0 ** min(deaths - 2, 30)
    return min(_LAST_DELAY_SECONDS, doubled)
