"""How far the clock of another machine is from ours, as NTP finds it: by half a round trip."""

from __future__ import annotations

__all__ = ["ClockOffset"]

_SET_NANOSECONDS = 50_000_000
_KEPT = 16


class ClockOffset:
    """Keeps the last answers to "what time is it", and trusts the one that was quickest.

    The true offset is within half of that answer's round trip. Clocks drift, so old answers go.
    """

    def __init__(self) -> None:
        self._answers: tuple[tuple[int, int], ...] = ()

    def add(self, asked: int, theirs: int, answered: int, took: int | None = None) -> None:
        """Take one answer: our times of question and answer and theirs between, nanoseconds.

        With `took`, the same time by a clock that cannot be set, an answer during which our clock
        was set is thrown away, and so are those before it, which knew the clock as it was.
        """
        if took is not None and abs(answered - asked - took) > _SET_NANOSECONDS:
            self.clear()
            return
        answer = max(0, answered - asked), theirs - (asked + answered) // 2
        self._answers = (*self._answers[1 - _KEPT :], answer)

    def clear(self) -> None:
        """Forget everything: the machine may come back with another clock."""
        self._answers = ()

    @property
    def known(self) -> bool:
        """Whether there was an answer."""
        return bool(self._answers)

    @property
    def nanoseconds(self) -> int:
        """By how much their clock is ahead of ours; 0 while nothing is known."""
        return min(self._answers, default=(0, 0))[1]

    @property
    def round_trip(self) -> int:
        """The quickest round trip, nanoseconds; the offset is right to half of it."""
        return min(self._answers, default=(0, 0))[0]
