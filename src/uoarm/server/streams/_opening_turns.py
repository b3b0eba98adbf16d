"""How many functions are opened side by side: many that wait, few that compute."""

from __future__ import annotations

__all__ = ["OpeningTurns"]

_AT_ONCE = 2
_YOUNG_SECONDS = 0.02
_LATE_SECONDS = 0.005


class OpeningTurns:
    """Says when the next opening may begin. A plain state for the loop's thread, without a clock.

    An opening that waits for a component or for a middleware takes no processor, so that many go
    side by side. Those that compute are no sooner done for it: their threads take the interpreter's
    lock from one another and from the loop, and the more there are, the more of the processor goes
    into that. Which of both it is shows in time: one that has been under way for 20 ms waits,
    provided that the loop itself came to look in time. Where it did not, nobody got the
    processor, and the ages say nothing.

    Args:
        limit: openings under way, at most.
    """

    look_seconds = _YOUNG_SECONDS
    """When to look again where some could not begin."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._young: dict[object, float] = {}
        self._waiting: set[object] = set()

    @property
    def may_begin(self) -> bool:
        """Whether one more may begin now."""
        young = len(self._young)
        return young < _AT_ONCE and young + len(self._waiting) < self._limit

    def begin(self, opening: object, now: float) -> None:
        """Note that one has begun; its age counts from now on."""
        self._young[opening] = now

    def end(self, opening: object) -> None:
        """Note that one is over."""
        self._young.pop(opening, None)
        self._waiting.discard(opening)

    def look(self, due: float, now: float) -> None:
        """Tell those that wait from those that compute; `due` is when this was to be called."""
        if now - due > _LATE_SECONDS:
            return
        old = [name for name, begun in self._young.items() if now - begun >= _YOUNG_SECONDS]
        for item in old:
            del self._young[item]
        self._waiting.update(old)
