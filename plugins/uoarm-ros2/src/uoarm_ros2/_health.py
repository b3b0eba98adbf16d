"""What happens on one channel, turned into changes of health that are each reported once."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable

from uoarm.bridge import HealthReason
from uoarm.model import Health

__all__ = ["SimulatedClock", "TopicHealth"]

_CALM_SECONDS = 1.0
_LEAST_SECONDS = 1.0  # no silence is shorter, whatever the rate: a busy machine has pauses
_LONGEST_GAPS = 10
_STEADY_MESSAGES, _STEADY_SECONDS, _STEADY_GAPS = 20, 5.0, 3.0
_DEADLINES = 3


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


class TopicHealth:
    """Counters and health of one channel, in the reasons of the contract.

    Unlike the contract's `ChannelHealth` what is lost here may come back: DDS matches peers anew.

    It has no lock: everything happens in the runner's thread, in which messages, events and ticks
    come one after another. `count` of a sink is the exception, which the sink guards; `facts` reads
    from any thread, and may see one counter newer than another.

    Args:
        report: takes each change of health with its cause.
        stale_after: seconds without a message that make the channel lost; None: never.
        clock: seconds that only grow.
        receives: whether messages come in here, so that silence means something.
    """

    def __init__(
        self,
        report: Callable[[Health, str], None],
        stale_after: float | None = None,
        clock: Callable[[], float] = time.monotonic,
        *,
        receives: bool = False,
    ) -> None:
        self._clock = clock
        self.count = 0
        self.last = self._clock()
        self.matched = 0
        self.lost = 0
        self.incompatible = 0
        self.deadlines_missed = 0
        self._notify = report
        self._stale_after = stale_after
        self._promised: float | None = None
        self._receives = receives
        self._since: float | None = None
        self._since_count = 0
        self._longest = 0.0
        self._reported = (Health.OK, "")
        self._reason: HealthReason | None = None
        self._trouble_at = 0.0

    def note_message(self) -> None:
        """Note a message."""
        self.count += 1
        now = self._clock()
        if self._since is None:
            self._since, self._since_count, self._longest = now, self.count, 0.0
        elif now - self.last > self._longest:
            self._longest = now - self.last
        self.last = now

    def report(
        self, health: Health, cause: str, reason: HealthReason = HealthReason.REFUSED
    ) -> None:
        """Report a change, with the reason in front where it is not well.

        A report that repeats the last one is dropped.
        """
        text = cause if health is Health.OK else f"{reason.value}: {cause}"
        if (health, text) == self._reported or (
            health is Health.OK and self._reported[0] is health
        ):
            return
        self._reported = (health, text)
        self._reason = None if health is Health.OK else reason
        self._notify(health, text)

    def note_peers(self, current: int, what: str, *, required: bool, offered: bool = False) -> None:
        """Note how many peers are matched now; what is offered is well without any."""
        before, self.matched = self.matched, current
        if current == 0 and before > 0 and offered:
            self.report(Health.OK, f"no {what} is there, and none need be")
        elif current == 0 and before > 0:
            health = Health.LOST if required else Health.DEGRADED
            cause = f"the last {what} is gone{self._sooner()}"
            self.report(health, cause, HealthReason.DISCONNECTED)
        elif current > 0 and before == 0:
            self.last = self._clock()
            self._since = None
            self.report(Health.OK, f"a {what} is there")

    def note_deadlines(self, deadlines: Iterable[float | None]) -> None:
        """Note within how many seconds the publishers promise a message each: `deadline` of QoS.

        Where all do, three deadlines without a message are a silence, unless a time is stated.
        """
        stated = list(deadlines)
        known = [deadline for deadline in stated if deadline is not None]
        every = bool(known) and len(known) == len(stated)
        self._promised = max(_LEAST_SECONDS, _DEADLINES * max(known)) if every else None

    def note_lost(self, total: int, what: str) -> None:
        """Note messages that the middleware lost."""
        self.lost = total
        self._degrade(f"{total} messages lost by the middleware since opening, on {what}")

    def note_missed_deadline(self, total: int, what: str) -> None:
        """Note that a deadline passed without a message."""
        self.deadlines_missed = total
        self._degrade(f"the deadline passed {total} times without a message on {what}")

    def note_liveliness(self, alive: int, silent: int, what: str, *, required: bool) -> None:
        """Note how many publishers say that they are alive, and how many ceased to."""
        if silent and not alive:
            health = Health.LOST if required else Health.DEGRADED
            cause = f"the publisher of {what} no longer says that it is alive (liveliness)"
            self.report(health, cause, HealthReason.PEER)
        elif alive and self._reason is HealthReason.PEER:
            self.report(Health.OK, f"the publisher of {what} says again that it is alive")

    def tick(self) -> None:
        """Look at the clock: go stale, or recover once messages flow again."""
        age = self._clock() - self.last
        limit = self._limit()
        if age > limit:
            if self._reported[0] is not Health.LOST:
                promised = f", {_DEADLINES} times the deadline of its QoS (stale_after)"
                why = f"no message for {limit:g} s{'' if self._stale_after else promised}"
                self.report(Health.LOST, why, HealthReason.SILENT)
        elif limit == math.inf and self._is_steady(age):
            if self._reported[0] is Health.OK:
                self.report(Health.DEGRADED, self._silence(age), HealthReason.SILENT)
        elif self._reason is HealthReason.SILENT or (
            self._reason is HealthReason.SLOW and self.last > self._trouble_at + _CALM_SECONDS
        ):
            self.report(Health.OK, "messages arrive as they should")

    def facts(self) -> dict[str, object]:
        """Return the counters by name, and after which silence the channel is lost."""
        limit = self._limit()
        stale = {"stale_after": "never" if limit == math.inf else limit} if self._receives else {}
        return {
            **stale,
            "matched": self.matched,
            "messages": self.count,
            "lost_by_middleware": self.lost,
            "qos_clashes": self.incompatible,
            "deadlines_missed": self.deadlines_missed,
        }

    def _limit(self) -> float:
        """Return the silence after which the channel is lost."""
        stated = self._promised if self._stale_after is None else self._stale_after
        return math.inf if stated is None else stated

    def _is_steady(self, age: float) -> bool:
        """Say whether messages that always came steadily have ceased to."""
        if not self._receives or self._since is None or self.matched == 0:
            return False
        count, lasted = self.count - self._since_count, self.last - self._since
        steady = count >= _STEADY_MESSAGES and lasted >= _STEADY_SECONDS
        usual = steady and self._longest <= _STEADY_GAPS * lasted / count
        return usual and age > self._enough()

    def _enough(self) -> float:
        """Return a `stale_after` that the messages so far would never have reached."""
        seconds = _LONGEST_GAPS * self._longest
        return max(_LEAST_SECONDS, math.ceil(seconds))

    def _silence(self, age: float) -> str:
        return (
            f"no message for {age:.1f} s, and before one came every {self._longest:.2g} s or "
            f"sooner: with stale_after: {self._enough():g} in the options of the output it is lost"
        )

    def _sooner(self) -> str:
        """Name the option that would have reported the loss sooner; empty: none would."""
        age = self._clock() - self.last
        if not self._receives or self._since is None or age <= 2 * self._enough():
            return ""
        return (
            f", {age:.1f} s after its last message: stale_after: {self._enough():g} in the options "
            f"of the output reports it sooner"
        )

    def _degrade(self, cause: str) -> None:
        """Report trouble once, however often it recurs before it has passed."""
        self._trouble_at = self._clock()
        if self._reported[0] is not Health.LOST and self._reason is not HealthReason.SLOW:
            self.report(Health.DEGRADED, cause, HealthReason.SLOW)
