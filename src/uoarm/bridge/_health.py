"""How a connection and a channel are judged: events and times in, what to report out; no I/O.

`Disconnection` and `ChannelHealth` have no clock, thread or lock: times are in seconds of one clock
of the caller, who also guards what several threads use. `ChannelMonitor` is that caller, for
channels of which several threads learn something.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from enum import Enum
from typing import Concatenate

from attrs import frozen
from typing_extensions import ParamSpec

from uoarm.model import Health

P = ParamSpec("P")
_ENOUGH = 0.5  # of the rate that is expected
_FEWEST = 4  # messages that are expected in the time over which a rate is judged
_SHORTEST_SECONDS = 1.0  # no silence and no rate is judged sooner: a busy machine has pauses
_CALM_SECONDS = 1.0
_STEADY_GAPS, _STEADY_SECONDS = 20, 5.0  # from which on messages may be called steady
_STEADY = 3.0  # mean gaps that the longest one has at most
_LONGEST_GAPS = 10  # longest gaps after which what was steady has ceased


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
    HealthReason.SLOW: "fewer than half of the messages that are expected pass, or some were lost "
    "or late: `degraded`",
    HealthReason.REFUSED: "the peer refused the channel, `lost`, or a message, `degraded`",
    HealthReason.PEER: "the peer says so of itself, with the health that it says",
}
_BADNESS = (Health.OK, Health.DEGRADED, Health.FINISHED, Health.LOST)
_REASONS = tuple(HealthReason)
_EXPLAINED_BY: Mapping[HealthReason, set[HealthReason]] = {
    HealthReason.SILENT: {HealthReason.DISCONNECTED},
    HealthReason.SLOW: {HealthReason.DISCONNECTED, HealthReason.SILENT},
}
_DISCONNECTED, _SILENT = (HealthReason.DISCONNECTED, ""), (HealthReason.SILENT, "")
_SLOW = (HealthReason.SLOW, "")
_CHANNEL, _MESSAGE = (HealthReason.REFUSED, ""), (HealthReason.REFUSED, "a message")


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
    """One end of a flow: what is reported of it, each change once.

    Each method takes what happened, and returns what to report, None for nothing. Several things
    may be wrong at once: the status is the worst, with all that is equally bad and that nothing
    before it in `HealthReason` explains.

    Args:
        what: the channel leads to, such as `publisher of /image`.
        now: the time.
        stale_after: seconds without a message after which it is lost; None: never.
        rate: messages a second that are expected; None: any number.
        without_peers: how a channel is whose last peer has gone.
        grace: seconds that it may be without one, or longer silent than `stale_after`, before it
            is lost.
        recovers: whether a loss is over with what caused it, as where a framework matches peers
            anew by itself; else what is lost or finished stays so, and nothing more is reported.
        learns: whether messages that always came steadily, and cease to, are reported where no
            `stale_after` is known.

    Attributes:
        stale_after: as `expect` has it, where peers promise how often they send.
        status: how it is now.
        peers: that are connected.
        messages: that passed.
    """

    def __init__(
        self,
        what: str,
        now: float,
        *,
        stale_after: float | None = None,
        rate: float | None = None,
        without_peers: Health = Health.LOST,
        grace: float = 0.0,
        recovers: bool = False,
        learns: bool = False,
    ) -> None:
        self.stale_after = stale_after
        self._what, self._rate = what, rate
        self._without_peers, self._grace, self._recovers = without_peers, grace, recovers
        self._rhythm = _IntervalEstimate() if learns else None
        self._window = 0.0 if rate is None else max(_SHORTEST_SECONDS, _FEWEST / rate)
        # By reason, and what it is about where several things may be wrong for one reason.
        self._faults: dict[tuple[HealthReason, str], ChannelReport] = {}
        self.peers = self.messages = self._counted = 0
        self._last = self._awaited_since = self._counted_since = now
        self._missed_at: float | None = None
        self._why_gone = ""
        self.status = ChannelReport(Health.OK, "", now)

    @property
    def is_over(self) -> bool:
        """Whether it is lost or finished for good: nothing more is reported."""
        return not self._recovers and self.status.health in {Health.LOST, Health.FINISHED}

    @property
    def is_silent(self) -> bool:
        """Whether it is not well because nothing came."""
        return self.status.reason is HealthReason.SILENT

    def passed(self, now: float) -> ChannelReport | None:
        """A message passed: it came and could be read, or the peer took it."""
        self.messages += 1
        self._last = self._awaited_since = now
        if self._rhythm is not None:
            self._rhythm.passed(now)
        if not self._faults:
            return None
        return self._mended(now, "a message passed", _MESSAGE, _SILENT)

    def connected(self, now: float, peers: int = 1, cause: str = "") -> ChannelReport | None:
        """So many peers are connected now; `cause`: why the others have gone, or none comes."""
        before, self.peers = self.peers, peers
        self._why_gone = cause or self._why_gone
        if before and not peers:
            if self._without_peers is Health.OK:
                # With the last peer goes what was wrong with it.
                return self._mended(now, "no peer is connected, and none need be", *self._of_peers)
            health = Health.DEGRADED if self._grace else self._without_peers
            if self._rhythm is not None:
                cause += self._rhythm.sooner(now - self._awaited_since)
            return self._fault(now, health, _DISCONNECTED, cause)
        if peers <= before:
            return None
        if before:
            return self._mended(now, "a peer is connected", _MESSAGE, _CHANNEL)
        # What was wrong before the first peer is over, and what none could send is not missed.
        self._awaited_since = self._counted_since = now
        self._counted, self._missed_at = self.messages, None
        if self._rhythm is not None:
            self._rhythm = _IntervalEstimate()
        return self._mended(now, "a peer is connected", *self._of_peers)

    def refused(self, now: float, cause: str, *, final: bool = False) -> ChannelReport | None:
        """The peer refused a message, or for good the channel itself."""
        if final:
            return self._fault(now, Health.LOST, _CHANNEL, cause)
        if _MESSAGE in self._faults or _CHANNEL in self._faults:
            return None
        return self._fault(now, Health.DEGRADED, _MESSAGE, cause)

    def missed(self, now: float, cause: str) -> ChannelReport | None:
        """Messages were lost on their way, or late: reported once, until they come as they should.

        That is when one passes that is more than a second younger than what was missed last.
        """
        self._missed_at = now
        if _SLOW in self._faults:
            return None
        return self._fault(now, Health.DEGRADED, _SLOW, cause)

    def peer_reported(
        self, now: float, health: Health, cause: str, about: str = ""
    ) -> ChannelReport | None:
        """The peer has said how it is, of each of several things where `about` names them."""
        return self.judged(now, HealthReason.PEER, health, cause, about)

    def judged(
        self, now: float, reason: HealthReason, health: Health, cause: str, about: str
    ) -> ChannelReport | None:
        """Something that lasts was judged, and stays so until it is judged well.

        Where `about` does not name it, the end of its last peer, or the first new one, ends it.

        Args:
            now: the time.
            reason: why it is not well.
            health: OK where it is.
            cause: what was found.
            about: what was judged, of all that is for this reason.
        """
        if health is Health.OK:
            return self._mended(now, cause, (reason, about))
        return self._fault(now, health, (reason, about), cause)

    def expect(self, now: float, stale_after: float | None) -> ChannelReport | None:
        """Messages are waited for so long from now on; None: for ever. A silence is judged anew."""
        if stale_after == self.stale_after:
            return None
        self.stale_after = stale_after
        self._faults.pop(_SILENT, None)
        silence = self._silence(now, "")
        if silence is not None:
            return self._fault(now, silence.health, _SILENT, silence.cause)
        return self._changed(now, f"{self._what}: it may be silent for longer")

    def tick(self, now: float, note: str = "") -> ChannelReport | None:
        """Time has passed; what follows from it alone is reported. `note` ends the words on it."""
        # Simulated time goes back where it begins anew.
        self._last, self._counted_since = min(self._last, now), min(self._counted_since, now)
        self._awaited_since = min(self._awaited_since, now)
        silence = self._silence(now, note)
        if silence is not None:
            return self._fault(now, silence.health, _SILENT, silence.cause)
        broken = self._faults.get(_DISCONNECTED)
        is_graced = broken is not None and broken.health is not self._without_peers
        if broken is not None and is_graced and now - broken.since >= self._grace:
            why = f": {self._why_gone}" if self._why_gone else ""
            text = f"no peer for {self._grace:g} s{why}{note}"
            return self._fault(now, self._without_peers, _DISCONNECTED, text)
        is_calm = self._missed_at is None or self._last > self._missed_at + _CALM_SECONDS
        if self._rate is None:
            if self._missed_at is None or not is_calm:
                return None
            self._missed_at = None
            return self._mended(now, "messages come as they should", _SLOW)
        lasted = now - self._counted_since
        if lasted < self._window:
            return None
        passed = (self.messages - self._counted) / lasted
        self._counted, self._counted_since = self.messages, now
        if passed >= _ENOUGH * self._rate:
            if not is_calm:
                return None
            return self._mended(now, f"{passed:.3g} messages a second", _SLOW)
        if _SLOW in self._faults:
            return None
        text = f"{passed:.3g} messages a second, {self._rate:g} are expected"
        return self._fault(now, Health.DEGRADED, _SLOW, text)

    def wake_at(self) -> float | None:
        """Return the time until which no `tick` has news of a silence or a grace; None: never."""
        times = []
        silent, broken = self._faults.get(_SILENT), self._faults.get(_DISCONNECTED)
        if self.stale_after is not None and (silent is None or silent.health is not Health.LOST):
            grace = 0.0 if silent is None else self._grace
            times.append(self._awaited_since + self.stale_after + grace)
        if broken is not None and broken.health is not self._without_peers:
            times.append(broken.since + self._grace)
        due = min(times, default=math.inf)
        return due if due < math.inf and not self.is_over else None

    def facts(self, now: float) -> Mapping[str, object]:
        """Return what the status shows of it beside the health."""
        since = round(max(0.0, now - self._last), 3) if self.messages else None
        return {
            "seconds_since_message": since,
            "stale_after": "never" if self.stale_after is None else self.stale_after,
        }

    @property
    def _of_peers(self) -> list[tuple[HealthReason, str]]:
        """What was wrong with the peers so far. Of what has a name its judge says the end."""
        return [key for key in self._faults if not key[1] or key == _MESSAGE]

    def _silence(self, now: float, note: str) -> ChannelReport | None:
        """Return what a silence is now, None where it is none, or reported so already."""
        age, known = now - self._awaited_since, self._faults.get(_SILENT)
        if self.stale_after is None:
            rhythm = self._rhythm
            if known is not None or rhythm is None or not self.peers:
                return None
            text = rhythm.silence(age)
            return ChannelReport(Health.DEGRADED, text, now) if text else None
        if age <= self.stale_after:
            return None
        lasted, health = self.stale_after, Health.DEGRADED
        if age > self.stale_after + self._grace:
            lasted, health = self.stale_after + self._grace, Health.LOST
        if known is not None and known.health is health:
            return None
        return ChannelReport(health, f"no message for {lasted:g} s{note}", now)

    def _fault(
        self, now: float, health: Health, key: tuple[HealthReason, str], cause: str
    ) -> ChannelReport | None:
        known = self._faults.get(key)
        since = now if known is None else known.since
        self._faults[key] = ChannelReport(health, cause, since, key[0])
        return self._changed(now, "")

    def _mended(
        self, now: float, why: str, *keys: tuple[HealthReason, str]
    ) -> ChannelReport | None:
        for key in keys:
            self._faults.pop(key, None)
        return self._changed(now, f"{self._what}: {why}")

    def _changed(self, now: float, why: str) -> ChannelReport | None:
        """Take the worst that is wrong as the status; returns it where it is another."""
        if self.is_over:
            return None
        status = self._worst() if self._faults else ChannelReport(Health.OK, why, now)
        before = self.status
        if (status.health, status.reason) == (before.health, before.reason) and (
            status.reason is None or status.cause == before.cause
        ):
            return None
        self.status = status
        return status

    def _worst(self) -> ChannelReport:
        health = max((fault.health for fault in self._faults.values()), key=_BADNESS.index)
        found: dict[HealthReason, list[ChannelReport]] = {}
        for reason in _REASONS:
            faults = [
                fault
                for (why, _), fault in self._faults.items()
                if why is reason and fault.health is health
            ]
            if faults and not _EXPLAINED_BY.get(reason, set()) & found.keys():
                found[reason] = faults
        text = "; ".join(
            f"{reason.value}: {self._what}: {'; '.join(fault.cause for fault in faults)}"
            for reason, faults in found.items()
        )
        first = next(iter(found))
        since = min(fault.since for faults in found.values() for fault in faults)
        return ChannelReport(health, text, since, first)


class _IntervalEstimate:
    """How steadily messages come, so that their end is known where no time for it is stated."""

    def __init__(self) -> None:
        self._since: float | None = None
        self._last = self._longest = 0.0
        self._gaps = 0

    def passed(self, now: float) -> None:
        if self._since is None:
            self._since = now
        else:
            self._gaps += 1
            self._longest = max(self._longest, now - self._last)
        self._last = now

    def silence(self, age: float) -> str:
        """Say what is conspicuous of a silence; empty: nothing."""
        if not self._is_steady() or age <= self._never_reached():
            return ""
        return (
            f"no message for {age:.1f} s, and before one came every {self._longest:.2g} s or "
            f"sooner: with stale_after: {self._never_reached():g} in the options it is lost"
        )

    def sooner(self, age: float) -> str:
        """Name the option by which a loss after a silence would have been known before."""
        if not self._is_steady() or age <= 2 * self._never_reached():
            return ""
        return (
            f", {age:.1f} s after its last message: stale_after: {self._never_reached():g} in the "
            "options reports it sooner"
        )

    def _is_steady(self) -> bool:
        """Whether so many came so evenly that a longer silence says something."""
        if self._since is None or self._gaps < _STEADY_GAPS:
            return False
        lasted = self._last - self._since
        return lasted >= _STEADY_SECONDS and self._longest <= _STEADY * lasted / self._gaps

    def _never_reached(self) -> float:
        """Return a `stale_after` that no silence so far would have reached."""
        return max(_SHORTEST_SECONDS, math.ceil(_LONGEST_GAPS * self._longest))


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
        """Whether the channel is not well because nothing came."""
        return self._health.is_silent

    @property
    def peers(self) -> int:
        """How many are connected."""
        return self._health.peers

    @property
    def messages(self) -> int:
        """How many passed."""
        return self._health.messages

    def expect(self, stale_after: float | None) -> None:
        """Have it lost after so many seconds without a message from now on; None: never."""
        self._judge(self._health.expect, stale_after)

    def wake_at(self) -> float | None:
        """Return the time until which no `tick` has news; see `ChannelHealth.wake_at`."""
        with self._lock:
            return self._health.wake_at()

    def facts(self) -> Mapping[str, object]:
        """Return what the status shows of it beside the health."""
        with self._lock:
            return self._health.facts(self._clock())

    def close(self) -> None:
        """Report nothing more: the channel is closed."""
        self._is_closed = True

    def passed(self) -> None:
        """A message passed."""
        with self._lock:  # as `_judge`, spelled out: this is done with each message
            report = self._health.passed(self._clock())
            if report is None:
                return
            self._waiting.append(report)
        self._say()

    def connected(self, peers: int = 1, cause: str = "") -> None:
        """So many peers are connected now; `cause`: why the others have gone."""
        self._judge(self._health.connected, peers, cause)

    def refused(self, cause: str, *, final: bool = False) -> None:
        """The peer refused a message, or for good the channel itself."""
        self._judge(self._health.refused, cause, final=final)

    def missed(self, cause: str) -> None:
        """Messages were lost on their way, or late."""
        self._judge(self._health.missed, cause)

    def peer_reported(self, health: Health, cause: str, about: str = "") -> None:
        """The peer has said how it is, of each of several things where `about` names them."""
        self._judge(self._health.peer_reported, health, cause, about)

    def judged(self, reason: HealthReason, health: Health, cause: str, about: str) -> None:
        """Something that lasts was judged; see `ChannelHealth.judged`."""
        self._judge(self._health.judged, reason, health, cause, about)

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
