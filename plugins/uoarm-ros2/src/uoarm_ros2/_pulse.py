"""What happens on one channel, turned into health events that are each told once."""

from __future__ import annotations

import time
from collections.abc import Callable

from uoarm.model import Health

__all__ = ["Pulse", "SimulatedClock"]

_CALM_SECONDS = 1.0


class SimulatedClock:
    """Seconds that `/clock` has counted: they stand while it does, and never go back."""

    def __init__(self) -> None:
        self._seconds = 0.0
        self._last: int | None = None

    def take(self, nanoseconds: int) -> None:
        """Take a time of the simulation; one that is earlier is that of another run."""
        if self._last is not None:
            self._seconds += max(0, nanoseconds - self._last) / 1e9
        self._last = nanoseconds

    def __call__(self) -> float:
        return self._seconds


class Pulse:
    """Counters and health of one channel.

    Args:
        report: takes each change of health with its cause.
        stale_after: seconds without a message that make the channel lost; None: never.
        clock: seconds that only grow.
    """

    def __init__(
        self,
        report: Callable[[Health, str], None],
        stale_after: float | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._clock = clock
        self.count = 0
        self.last = self._clock()
        self.matched = 0
        self.lost = 0
        self.incompatible = 0
        self.deadlines_missed = 0
        self.unreadable = 0
        self._report = report
        self._stale_after = stale_after
        self._told = (Health.OK, "")
        self._why = ""
        self._trouble = 0.0

    def beat(self) -> None:
        """Note a message."""
        self.count += 1
        self.last = self._clock()

    def tell(self, health: Health, cause: str, why: str = "peers") -> None:
        """Report a change; the same news twice in a row is told once."""
        if (health, cause) == self._told or (health is Health.OK and self._told[0] is health):
            return
        self._told = (health, cause)
        self._why = why
        self._report(health, cause)

    def peers(self, current: int, what: str, *, required: bool, offered: bool = False) -> None:
        """Note how many peers are matched now; what is offered is well without any."""
        before, self.matched = self.matched, current
        if current == 0 and before > 0 and offered:
            self.tell(Health.OK, f"no {what} is there, and none need be")
        elif current == 0 and before > 0:
            health = Health.LOST if required else Health.DEGRADED
            self.tell(health, f"the last {what} is gone")
        elif current > 0 and before == 0:
            self.last = self._clock()
            self.tell(Health.OK, f"a {what} is there")

    def missed(self, total: int, what: str) -> None:
        """Note messages that the middleware lost."""
        self.lost = total
        self._degrade(f"{total} messages lost by the middleware since opening, on {what}")

    def unread(self, cause: str) -> None:
        """Note a message that came and is none of its type."""
        self.unreadable += 1
        self._degrade(f"a message cannot be read {cause}")

    def deadline(self, total: int, what: str) -> None:
        """Note that a deadline passed without a message."""
        self.deadlines_missed = total
        self._degrade(f"the deadline passed {total} times without a message on {what}")

    def liveliness(self, alive: int, silent: int, what: str, *, required: bool) -> None:
        """Note how many publishers say that they are alive, and how many ceased to."""
        if silent and not alive:
            health = Health.LOST if required else Health.DEGRADED
            cause = f"the publisher of {what} no longer says that it is alive (liveliness)"
            self.tell(health, cause, "liveliness")
        elif alive and self._why == "liveliness":
            self.tell(Health.OK, f"the publisher of {what} says again that it is alive")

    def tick(self) -> None:
        """Look at the clock: go stale, or recover once messages flow again."""
        age = self._clock() - self.last
        if self._stale_after is not None and age > self._stale_after:
            if self._told[0] is not Health.LOST:
                self.tell(Health.LOST, f"no message for {self._stale_after:g} s", "stale")
        elif self._why == "stale" or (
            self._why == "trouble" and self.last > self._trouble + _CALM_SECONDS
        ):
            self.tell(Health.OK, "messages arrive as they should")

    def facts(self) -> dict[str, int]:
        """Return the counters by name."""
        return {
            "matched": self.matched,
            "messages": self.count,
            "lost_by_middleware": self.lost,
            "qos_clashes": self.incompatible,
            "deadlines_missed": self.deadlines_missed,
            "unreadable": self.unreadable,
        }

    def _degrade(self, cause: str) -> None:
        """Tell of trouble once, however often it recurs before it has passed."""
        self._trouble = self._clock()
        if self._told[0] is not Health.LOST and self._why != "trouble":
            self.tell(Health.DEGRADED, cause, "trouble")
