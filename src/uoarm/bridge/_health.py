"""How a connection and a channel are judged: events and times in, what to report out; no I/O.

`Disconnection` and `ChannelHealth` have no clock, thread or lock: times are in seconds of one clock
of the caller, who also guards what several threads use. `ChannelMonitor` is that caller, for
channels of which several threads learn something.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from enum import Enum
from typing import Concatenate

from attrs import frozen
from typing_extensions import ParamSpec

from uoarm.model import Health

__all__ = ["ChannelHealth", "ChannelMonitor", "ChannelReport", "Disconnection", "HealthReason"]

P = ParamSpec("P")
_ENOUGH = 0.5  # of the rate that is expected
_FEWEST = 4  # messages that are expected in the time over which a rate is judged
_SHORTEST_SECONDS = 1.0


class Disconnection:
    """What to report of a connection that breaks: each thing once, a loss when it lasts.

    Not up yet, up, down, given up.

    Args:
        grace: seconds that a break may last before it is a loss.
    """

    def __init__(self, grace: float) -> None:
        self._grace = grace
        self._since: float | None = None  # down since then; None where nothing was reported
        self._was_up = False
        self._reported: Health | None = None

    @property
    def is_over(self) -> bool:
        """Whether the link was given up."""
        return self._reported is Health.LOST

    def up(self) -> Health | None:
        """The link carries messages; returns what to report, None for nothing."""
        self._was_up, self._since = True, None
        return self._report(Health.OK if self._reported is not None else None)

    def down(self, now: float, *, final: bool) -> Health | None:
        """The link broke, or an attempt to mend it failed; `final`: no attempt will do better."""
        if not self._was_up:
            # What no client has relied upon yet is not lost: a client that asks for it is refused.
            # When it comes up later, that is news.
            self._reported = self._reported or Health.DEGRADED
            return None
        self._since = now if self._since is None else self._since
        if final or now - self._since >= self._grace:
            return self._report(Health.LOST)
        return self._report(Health.DEGRADED)

    def left(self, now: float) -> float | None:
        """Return the seconds until a break is a loss; None: there is none, or it is lost."""
        if self._since is None or self.is_over:
            return None
        return max(0.0, self._since + self._grace - now)

    def _report(self, health: Health | None) -> Health | None:
        if health is self._reported or (self.is_over and health is Health.DEGRADED):
            return None
        self._reported = None if health is Health.OK else health
        return health


class HealthReason(Enum):
    """Why a channel is not well: the first word of the cause, in events, status and dashboard."""

    DISCONNECTED = "disconnected"
    SILENT = "silent"
    SLOW = "slow"
    REFUSED = "refused"
    PEER = "peer"

    @property
    def meaning(self) -> str:
        """What it says, and of what health the channel is then."""
        return _MEANINGS[self]


_MEANINGS: Mapping[HealthReason, str] = {
    HealthReason.DISCONNECTED: "no peer is connected: `lost`, or `degraded` in its grace",
    HealthReason.SILENT: "no message passed for `stale_after` seconds: `lost`, or `degraded` in "
    "its grace",
    HealthReason.SLOW: "fewer than half of the messages that are expected pass: `degraded`",
    HealthReason.REFUSED: "the peer refused the channel, `lost`, or a message, `degraded`",
    HealthReason.PEER: "the peer says so of itself, with the health that it says",
}
_BADNESS = (Health.OK, Health.DEGRADED, Health.FINISHED, Health.LOST)
_REASONS = tuple(HealthReason)


@frozen
class ChannelReport:
    """How a channel is.

    Attributes:
        health: of it.
        cause: begins with the reason, and names what it is about.
        since: the time at which that began.
        reason: why it is not well; None where it is.
    """

    health: Health
    cause: str
    since: float
    reason: HealthReason | None = None


class ChannelHealth:
    """One end of a flow: what is reported of it, each change once. What is lost stays lost.

    Each method takes what happened, and returns what to report, None for nothing.

    Args:
        what: the channel leads to, such as `publisher of /image`.
        now: the time.
        stale_after: seconds without a message after which it is lost; None: never.
        rate: messages a second that are expected; None: any number.
        peer_required: whether a channel whose last peer has gone is not well.
        grace: seconds that it may be without one, or longer silent than `stale_after`, before it
            is lost.
    """

    def __init__(
        self,
        what: str,
        now: float,
        *,
        stale_after: float | None = None,
        rate: float | None = None,
        peer_required: bool = True,
        grace: float = 0.0,
    ) -> None:
        self._what, self._stale_after, self._rate = what, stale_after, rate
        self._peer_required, self._grace = peer_required, grace
        self._window = 0.0 if rate is None else max(_SHORTEST_SECONDS, _FEWEST / rate)
        self._faults: dict[HealthReason, ChannelReport] = {}
        self._peers = self._count = self._counted = 0
        self._last = self._awaited_since = self._counted_since = now
        self._why_gone = ""
        self.status = ChannelReport(Health.OK, "", now)

    @property
    def is_over(self) -> bool:
        """Whether it is lost or finished: nothing more is reported."""
        return self.status.health in {Health.LOST, Health.FINISHED}

    @property
    def is_silent(self) -> bool:
        """Whether it is lost because nothing came."""
        return self.status.reason is HealthReason.SILENT

    def passed(self, now: float) -> ChannelReport | None:
        """A message passed: it came and could be read, or the peer took it."""
        self._last = self._awaited_since = now
        self._count += 1
        if not self._faults:
            return None
        return self._mended(now, "a message passed", HealthReason.REFUSED, HealthReason.SILENT)

    def connected(self, now: float, peers: int = 1, cause: str = "") -> ChannelReport | None:
        """So many peers are connected now; `cause`: why the others have gone, or none comes."""
        before, self._peers = self._peers, peers
        self._why_gone = cause or self._why_gone
        if before and not peers and self._peer_required:
            health = Health.DEGRADED if self._grace else Health.LOST
            return self._fault(now, health, HealthReason.DISCONNECTED, cause)
        if peers <= before:
            return None
        reasons = [HealthReason.DISCONNECTED, HealthReason.REFUSED]
        if HealthReason.DISCONNECTED in self._faults:
            # What no peer could send is not missed: silence is counted anew.
            self._awaited_since = now
            reasons.append(HealthReason.SILENT)
        return self._mended(now, "a peer is connected", *reasons)

    def refused(self, now: float, cause: str, *, final: bool = False) -> ChannelReport | None:
        """The peer refused a message, or for good the channel itself."""
        if HealthReason.REFUSED in self._faults and not final:
            return None
        health = Health.LOST if final else Health.DEGRADED
        return self._fault(now, health, HealthReason.REFUSED, cause)

    def peer_reported(self, now: float, health: Health, cause: str) -> ChannelReport | None:
        """The peer has said how it is."""
        if health is Health.OK:
            return self._mended(now, cause, HealthReason.PEER)
        return self._fault(now, health, HealthReason.PEER, cause)

    def tick(self, now: float, note: str = "") -> ChannelReport | None:
        """Time has passed; what follows from it alone is reported. `note` ends the words on it."""
        # Simulated time goes back where it begins anew.
        self._last, self._counted_since = min(self._last, now), min(self._counted_since, now)
        self._awaited_since = min(self._awaited_since, now)
        if self._stale_after is not None and now - self._awaited_since > self._stale_after:
            is_lost = now - self._awaited_since > self._stale_after + self._grace
            health = Health.LOST if is_lost else Health.DEGRADED
            known = self._faults.get(HealthReason.SILENT)
            if known is None or known.health is not health:
                lasted = self._stale_after + self._grace * is_lost
                text = f"no message for {lasted:g} s{note}"
                return self._fault(now, health, HealthReason.SILENT, text)
        broken = self._faults.get(HealthReason.DISCONNECTED)
        if broken is not None and now - broken.since >= self._grace:
            why = f": {self._why_gone}" if self._why_gone else ""
            text = f"no peer for {self._grace:g} s{why}{note}"
            return self._fault(now, Health.LOST, HealthReason.DISCONNECTED, text)
        lasted = now - self._counted_since
        if self._rate is None or lasted < self._window:
            return None
        passed = (self._count - self._counted) / lasted
        self._counted, self._counted_since = self._count, now
        if passed >= _ENOUGH * self._rate:
            return self._mended(now, f"{passed:.3g} messages a second", HealthReason.SLOW)
        if HealthReason.SLOW in self._faults:
            return None
        text = f"{passed:.3g} messages a second, {self._rate:g} are expected"
        return self._fault(now, Health.DEGRADED, HealthReason.SLOW, text)

    def facts(self, now: float) -> Mapping[str, object]:
        """Return what the status shows of it beside the health."""
        return {
            "seconds_since_message": round(max(0.0, now - self._last), 3) if self._count else None,
            "stale_after": "never" if self._stale_after is None else self._stale_after,
        }

    def _fault(
        self, now: float, health: Health, reason: HealthReason, cause: str
    ) -> ChannelReport | None:
        text = f"{reason.value}: {self._what}: {cause}"
        known = self._faults.get(reason)
        since = now if known is None else known.since
        self._faults[reason] = ChannelReport(health, text, since, reason)
        return self._changed(now, "")

    def _mended(self, now: float, why: str, *reasons: HealthReason) -> ChannelReport | None:
        for reason in reasons:
            self._faults.pop(reason, None)
        return self._changed(now, f"{self._what}: {why}")

    def _changed(self, now: float, why: str) -> ChannelReport | None:
        """Take the worst that is wrong as the status; returns it where it is another.

        Of what is equally bad, the reason that is listed first explains the others.
        """
        if self.is_over:
            return None
        well = ChannelReport(Health.OK, why, now)
        worst = max(
            (self._faults[reason] for reason in _REASONS if reason in self._faults),
            key=lambda fault: _BADNESS.index(fault.health),
            default=well,
        )
        before = self.status
        if (worst.health, worst.reason) == (before.health, before.reason) and (
            worst is well or worst.cause == before.cause
        ):
            return None
        self.status = worst
        return worst


class ChannelMonitor:
    """The health of a channel for any thread: with a clock, a lock, and a place to report to.

    Args:
        health: judges; nothing else may use it.
        report: takes each change, in their order.
        clock: by which the health was made.
    """

    def __init__(
        self,
        health: ChannelHealth,
        report: Callable[[Health, str], object],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._health, self._report, self._clock = health, report, clock
        # Guards the health and what waits to be reported, between all threads that learn of the
        # channel. Nothing is reported under it, since that may ask the framework; one thread at a
        # time reports, so that a loss is not overtaken by what was true before it.
        self._lock = threading.Lock()
        self._waiting: deque[ChannelReport] = deque()
        self._is_reporting = self._is_closed = False

    @property
    def is_silent(self) -> bool:
        """Whether the channel is lost because nothing came."""
        return self._health.is_silent

    def facts(self) -> Mapping[str, object]:
        """Return what the status shows of it beside the health."""
        with self._lock:
            return self._health.facts(self._clock())

    def close(self) -> None:
        """Report nothing more: the channel is closed."""
        self._is_closed = True

    def passed(self) -> None:
        """A message passed."""
        self._judge(self._health.passed)

    def connected(self, peers: int = 1, cause: str = "") -> None:
        """So many peers are connected now; `cause`: why the others have gone."""
        self._judge(self._health.connected, peers, cause)

    def refused(self, cause: str, *, final: bool = False) -> None:
        """The peer refused a message, or for good the channel itself."""
        self._judge(self._health.refused, cause, final=final)

    def peer_reported(self, health: Health, cause: str) -> None:
        """The peer has said how it is."""
        self._judge(self._health.peer_reported, health, cause)

    def tick(self, note: str = "") -> None:
        """Time has passed; `note` ends the words on what follows from it alone."""
        self._judge(self._health.tick, note)

    def _judge(
        self,
        judge: Callable[Concatenate[float, P], ChannelReport | None],
        *given: P.args,
        **named: P.kwargs,
    ) -> None:
        with self._lock:
            report = judge(self._clock(), *given, **named)
            if report is not None:
                self._waiting.append(report)
        self._say()

    def _say(self) -> None:
        while self._waiting:
            with self._lock:
                if self._is_reporting or not self._waiting:
                    return  # the thread that reports takes what came meanwhile
                self._is_reporting = True
                report = self._waiting.popleft()
            try:
                if not self._is_closed:
                    self._report(report.health, report.cause)
            finally:
                with self._lock:
                    self._is_reporting = False
