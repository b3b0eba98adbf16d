"""When one offer is opened, closed and tried again: a state machine without thread and clock."""

from __future__ import annotations

from enum import Enum

from attrs import define

from uoarm.model import OfferState

__all__ = ["OfferMachine", "Work", "pause"]

_LEAST_PAUSE, _LONGEST_PAUSE = 0.1, 30.0


def pause(failures: int) -> float:
    """Return how many seconds to wait after so many failures in a row: 1, 2, 4, up to 30."""
    return float(min(_LONGEST_PAUSE, 2 ** min(failures - 1, 8)))


class Work(Enum):
    """What is to be done; its end is told to the machine before anything else is."""

    OPEN = "open"
    CLOSE = "close"


@define(eq=False)
class OfferMachine:
    """One offer. Whoever calls holds a lock, does what `begin` returns, and tells what came of it.

    What broke is opened again at once, and with pauses where it breaks again and again. What has
    finished is closed and stays so: a source that ends is no failure, and is not played again.

    Attributes:
        state: what the status shows.
        cause: why, likewise.
        is_tried: whether the first attempt is through, whatever it came to.
        due: when `begin` is to be asked again, None where no time changes anything.
    """

    state: OfferState = OfferState.OPENING
    cause: str = ""
    is_tried: bool = False
    due: float | None = 0.0
    _work: Work | None = None
    _is_open: bool = False
    _broken: str | None = None
    _finished: str | None = None
    _is_over: bool = False
    _failures: int = 0
    _begun: float = 0.0
    _earliest: float = 0.0

    def begin(self, now: float) -> Work | None:
        """Return what is to be done now; None while something is under way or nothing is due."""
        if self._work is not None:
            return None
        if self._is_open:
            if self._is_over or self._finished is not None:
                self._work = Work.CLOSE
            elif self._broken is not None:
                self._turn(OfferState.OPENING, self._broken)
                self._work = Work.CLOSE
        elif self._is_over:
            self._turn(OfferState.CLOSED, "")
            self.due = None
        elif self.due is not None and now >= self.due:
            self._work, self.due = Work.OPEN, None
            self._begun, self._broken, self._finished = now, None, None
        return self._work

    def opened(self) -> None:
        """Take in that it is open. It may have broken meanwhile."""
        self._work, self._is_open, self.is_tried = None, True, True
        self._turn(OfferState.OPEN, "")

    def failed(self, cause: str, now: float) -> None:
        """Take in that it could not be opened."""
        self._work, self.is_tried = None, True
        self._failures += 1
        self._turn(OfferState.FAILED, cause)
        self._rest(pause(self._failures), now)

    def closed(self, now: float) -> None:
        """Take in that what was open is closed."""
        self._work, self._is_open = None, False
        if self._finished is not None and not self._is_over:
            self._turn(OfferState.FINISHED, self._finished)
            return
        self._failures = self._failures + 1 if now - self._begun < _LONGEST_PAUSE else 0
        self._rest(pause(self._failures - 1) if self._failures > 1 else 0.0, now)

    def broke(self, cause: str) -> None:
        """Take in that what is open, or is being opened, does not do any more."""
        if self._broken is None and self._finished is None:
            self._broken = cause

    def finished(self, cause: str) -> None:
        """Take in that nothing more will come, in good order."""
        if self._broken is None and self._finished is None:
            self._finished = cause

    def degraded(self, cause: str) -> None:
        """Take in what the bridge says is wrong with what is open; empty: nothing any more."""
        if self.state is OfferState.OPEN:
            self.cause = cause

    def retry(self, now: float) -> None:
        """Try at once what waits to be tried again, but for the least pause."""
        if self.due is not None:
            self.due = min(self.due, max(now, self._earliest))

    def end(self) -> None:
        """Close what is open, and open nothing more."""
        self._is_over = True

    def _rest(self, seconds: float, now: float) -> None:
        self.due = now + seconds
        self._earliest = now + min(seconds, _LEAST_PAUSE)

    def _turn(self, state: OfferState, cause: str) -> None:
        self.state, self.cause = state, cause
