"""What the configuration offers: wants of the manager's own, whose functions it requests.

An offer is opened, closed and tried again in its lane, as `OfferWant` says, with the threads and
the timer of the driver.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from enum import Enum
from functools import partial

from attrs import define

from uoarm._backoff import Backoff
from uoarm._control.live.bridges import BridgeSet
from uoarm._control.live.driver import Driver
from uoarm._control.live.revisions import Revisions
from uoarm._control.live.threads import EventDispatcher
from uoarm._control.offered_function import Functions, OfferedFunction
from uoarm._dataplane import Clock
from uoarm._interrupts import Uninterrupted
from uoarm.bridge import Bridge, HealthEvent
from uoarm.errors import UoarmError
from uoarm.model import Health, Offer, OfferState, OfferStatus, Robot, RouteStatus, StatusEvent

__all__ = ["OfferWant", "Offers", "Work"]

_LEAST_PAUSE, _LONGEST_PAUSE = 0.1, 30.0
_PAUSES = Backoff(first=1.0, most=_LONGEST_PAUSE)


class Work(Enum):
    """What is to be done; its end is reported to the want before it is asked again."""

    OPEN = "open"
    CLOSE = "close"


@define(eq=False)
class OfferWant:
    """That one offer is open: what is to be done for it now, without thread and clock.

    The caller holds a lock, does what `next_work` returns, and reports what came of it. What broke
    is opened again at once, and with pauses where it breaks again and again. What has finished is
    closed and stays so: a source that ends is no failure, and is not played again.

    Attributes:
        state: what the status shows.
        cause: why, likewise.
        due: when it is to be opened, None where no time changes anything.
    """

    state: OfferState = OfferState.OPENING
    cause: str = ""
    due: float | None = 0.0
    _is_open: bool = False
    # What open or opening is over for: OPENING where it broke, FINISHED. The first report counts.
    _ended: tuple[OfferState, str] | None = None
    _is_over: bool = False
    _failures: int = 0
    _begun: float = 0.0
    _earliest: float = 0.0

    def next_work(self, now: float) -> Work | None:
        """Return what is to be done now; None while all is as it should be, or nothing is due."""
        if self._is_open:
            if self._ended is not None and self._ended[0] is OfferState.OPENING:
                self.state, self.cause = self._ended
            return Work.CLOSE if self._is_over or self._ended is not None else None
        if self._is_over:
            self.state, self.cause, self.due = OfferState.CLOSED, "", None
        elif self.due is not None and now >= self.due:
            self._begun, self._ended, self.due = now, None, None
            return Work.OPEN
        return None

    def opened(self) -> None:
        """Take in that it is open. It may have broken meanwhile."""
        self._is_open = True
        self.state, self.cause = OfferState.OPEN, ""

    def failed(self, cause: str, now: float) -> None:
        """Take in that it could not be opened."""
        self._failures += 1
        self.state, self.cause = OfferState.FAILED, cause
        self._rest(_PAUSES.pause(self._failures), now)

    def closed(self, now: float) -> None:
        """Take in that what was open is closed."""
        self._is_open = False
        if self._ended is not None and self._ended[0] is OfferState.FINISHED and not self._is_over:
            self.state, self.cause = self._ended
            return
        self._failures = self._failures + 1 if now - self._begun < _LONGEST_PAUSE else 0
        self._rest(_PAUSES.pause(self._failures - 1) if self._failures > 1 else 0.0, now)

    def ended(self, state: OfferState, cause: str) -> None:
        """Take in that what is open, or is being opened, does not do any more, or has finished.

        Args:
            state: OPENING where it broke, as it is opened again, or FINISHED.
            cause: why.
        """
        self._ended = self._ended or (state, cause)

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


_log = logging.getLogger("uoarm")
_CLOSE_SECONDS = 5.0
_CONNECTION_CHANGES = frozenset({"failed", "closed", "waiting", "replaced"})

Hold = Callable[[Offer, Bridge], None]


class _KeptOffer:
    """One offer, and what is open for it, until it is ended.

    All that opens and closes is done in its lane, by one thread at a time; none waits for it.

    Attributes:
        tried: set once the first attempt is through, whatever it came to.
    """

    def __init__(
        self,
        offer: Offer,
        functions: Functions,
        bridges: BridgeSet,
        events: EventDispatcher,
        clock: Clock,
        driver: Driver,
        hold: Hold,
    ) -> None:
        self.offer = offer
        self.tried = threading.Event()
        self._functions = functions
        self._bridges = bridges
        self._events = events
        self._clock = clock
        self._driver = driver
        self._hold = hold
        # Guards the want, which knows no threads: bridges report while its lane opens.
        self._lock = threading.Lock()
        self._want = OfferWant()
        self._announced = self._want.state, ""
        self._opened: OfferedFunction | None = None
        self._worker: threading.Thread | None = None
        self._ended = threading.Event()

    def status(self) -> OfferStatus:
        """Return what the status map shows."""
        opened = self._opened
        with self._lock:
            state, cause = self._want.state, self._want.cause
        return OfferStatus(
            name=self.offer.name,
            function=self.offer.function,
            bridge=self.offer.bridge,
            state=state,
            endpoints=tuple(endpoint.address for endpoint in self.offer.endpoints),
            connections=() if opened is None else opened.connections,
            calls=0 if opened is None else opened.calls,
            failed=0 if opened is None else opened.failed,
            cause=cause,
        )

    def routes(self) -> tuple[RouteStatus, ...]:
        """Return the counters of what goes out and comes in."""
        opened = self._opened
        return () if opened is None else opened.routes()

    def reported(self, event: HealthEvent) -> bool:
        """Take what a bridge reports of a channel of this offer; False where it is of another."""
        opened = self._opened
        if event.bridge != self.offer.bridge or opened is None:
            return False
        channel, is_whole = event.channel, event.channel is None and event.component is None
        is_own = event.component == self.offer.name
        if not (is_whole or is_own or (channel is not None and opened.owns(channel))):
            return False
        if channel is not None and channel.closed:
            return True
        with self._lock:
            if event.health is Health.LOST:
                self._want.ended(OfferState.OPENING, event.cause)
            elif event.health is Health.FINISHED:
                self._want.ended(OfferState.FINISHED, event.cause)
            elif not is_whole:
                self._want.degraded(event.cause if event.health is Health.DEGRADED else "")
                self._events.post(f"offer {self.offer.name}", event.health.value, event.cause)
        self.settle()
        return not is_whole

    def look(self, *, again: bool = True) -> None:
        """See whether it still is as it should; where it failed, try at once if asked `again`."""
        opened = self._opened
        if opened is not None:
            opened.provider_changed()
            self._judge(opened)
            if not self._bridges.is_in_use(opened.bridge):
                cause = f"bridge {self.offer.bridge!r} is another one"
                with self._lock:
                    self._want.ended(OfferState.OPENING, cause)
        if again:
            with self._lock:
                self._want.retry(self._clock())
        self.settle()

    def end(self) -> None:
        """Have it close what is open, and end. Returns at once; `join` waits."""
        with self._lock:
            self._want.end()
        self.settle()

    def join(self, timeout: float) -> None:
        """Wait until it has ended; not in the thread that is to end it."""
        if self._worker is not threading.current_thread():
            self._ended.wait(timeout)

    def reach_time(self) -> None:
        """Have it tried again when it is time; until then, ask for that time anew."""
        # The timer is shared with all that waits, and mostly reaches a time of something else.
        with self._lock:
            due = self._want.due
        if due is not None and due > self._clock():
            self._driver.timer.wake_at(due)
        elif due is not None:
            self.settle()

    def settle(self) -> None:
        """Have what is open made what it should be, in its lane. Waits for nothing."""
        try:
            self._driver.put(f"offer {self.offer.name}", self._settle)
        except RuntimeError:  # the system gives no more threads
            self._driver.timer.wake_at(self._clock() + _PAUSES.first)

    def _settle(self) -> None:
        self._worker = threading.current_thread()
        while (work := self._next_work()) is not None:
            try:
                if work is Work.OPEN:
                    self._open()
                else:
                    self._close()
            except Exception as error:  # noqa: BLE001 - the status shows it whatever it is
                if not isinstance(error, UoarmError):
                    _log.exception("offering %s failed", self.offer.name)
                self._opened = None
                with self._lock:
                    self._want.failed(str(error) or type(error).__name__, self._clock())
            self.tried.set()
        self._worker = None

    def _next_work(self) -> Work | None:
        """Return what is to be done now, and announce what has changed."""
        with self._lock:
            want = self._want
            work = want.next_work(self._clock())
            now = want.state, "" if want.state is OfferState.OPEN else want.cause
            if now != self._announced:  # under the lock, so that events come in order
                self._announced = now
                self._events.post(f"offer {self.offer.name}", now[0].value, now[1])
            if work is None and want.due is not None:
                self._driver.timer.wake_at(want.due)
        if want.state is OfferState.CLOSED:
            self._ended.set()
            self.tried.set()
        return work

    def _open(self) -> None:
        bridge = self._bridges.get(self.offer.bridge)
        self._hold(self.offer, bridge)
        opened = OfferedFunction(self.offer, self._functions, bridge, self._clock)
        self._opened = opened  # before it opens: a channel may report at once
        opened.open()
        with self._lock:
            self._want.opened()
        self._judge(opened)  # what ended before it could be known whose connection it was

    def _judge(self, opened: OfferedFunction) -> None:
        with self._lock:
            if opened.broken is not None:
                self._want.ended(OfferState.OPENING, opened.broken)
            elif opened.finished is not None:
                self._want.ended(OfferState.FINISHED, opened.finished)

    def _close(self) -> None:
        opened, self._opened = self._opened, None
        if opened is not None:
            opened.close()
        with self._lock:
            self._want.closed(self._clock())


class Offers:
    """Keeps what the configuration in force offers open, once it has begun. Thread safe.

    Args:
        revisions: of the configuration; what the one in force offers is kept open.
        functions: where functions are requested, as every application does.
        bridges: of the manager.
        events: notified of every change, and listened to for those that concern an offer.
        clock: a monotonic clock, in seconds.
        driver: in whose lanes offers open and close, and whose timer says when to try again.
        hold: raises ResolutionError where an offer may not be opened.
    """

    def __init__(
        self,
        revisions: Revisions,
        functions: Functions,
        bridges: BridgeSet,
        events: EventDispatcher,
        clock: Clock,
        driver: Driver,
        hold: Hold,
    ) -> None:
        self._revisions = revisions
        self._events = events
        self._driver = driver
        self._keep = partial(
            _KeptOffer,
            functions=functions,
            bridges=bridges,
            events=events,
            clock=clock,
            driver=driver,
            hold=hold,
        )
        # Guards which offers are kept: a change of configuration adds some while the manager
        # closes.
        self._lock = threading.Lock()
        self._kept: tuple[_KeptOffer, ...] = ()
        self._has_begun = False
        self._stop_listening: Callable[[], None] | None = None
        self._closed = threading.Event()

    def begin(self, timeout: float) -> tuple[OfferStatus, ...]:
        """Open what is offered and keep it open; waits until each was tried once. Idempotent."""
        self._has_begun = True
        self.follow()
        deadline = time.monotonic() + timeout
        for kept in self._kept:
            kept.tried.wait(max(0.0, deadline - time.monotonic()))
        return self.statuses()

    def follow(self) -> None:
        """Offer what the configuration in force offers, where it has begun, and nothing else."""
        with Uninterrupted():
            self._follow()

    def _follow(self) -> None:
        with self._lock:
            wanted = self._revisions.current.robot.offers
            if self._closed.is_set() or not self._has_begun or not (wanted or self._kept):
                return
            if self._stop_listening is None:
                self._stop_listening = self._events.listen(self._note_event)
                self._driver.timer.share(self._time_reached)
            gone = [kept for kept in self._kept if kept.offer not in wanted]
        for kept in gone:
            kept.end()
        for kept in gone:  # its endpoints may be offered for another function next
            kept.join(_CLOSE_SECONDS)
        with self._lock:
            if self._closed.is_set():
                return
            by_name = {kept.offer.name: kept for kept in self._kept if kept not in gone}
            self._kept = tuple(by_name.get(offer.name) or self._keep(offer) for offer in wanted)
        for kept in self._kept:
            kept.look()

    def reported(self, event: HealthEvent) -> bool:
        """Take what a bridge reports; True where it concerns an offer and nothing else."""
        reports = [kept.reported(event) for kept in self._kept]
        return any(reports)

    def statuses(self) -> tuple[OfferStatus, ...]:
        """Return what the status map shows of offers."""
        return tuple(kept.status() for kept in self._kept)

    def routes(self) -> tuple[RouteStatus, ...]:
        """Return the counters of what goes out to frameworks and comes in from them."""
        return tuple(route for kept in self._kept for route in kept.routes())

    def connections_without(self, robot: Robot) -> frozenset[str]:
        """Return the connections behind offers that another configuration has no more."""
        gone = (kept for kept in self._kept if kept.offer not in robot.offers)
        return frozenset(connection for kept in gone for connection in kept.status().connections)

    def close(self) -> None:
        """Offer nothing more. Waits five seconds at most for what hangs."""
        with self._lock:
            self._closed.set()
            kept_offers, stop = self._kept, self._stop_listening
        if stop is not None:
            stop()
        for kept in kept_offers:
            kept.end()
        deadline = time.monotonic() + _CLOSE_SECONDS
        for kept in kept_offers:
            kept.join(max(0.0, deadline - time.monotonic()))

    def _time_reached(self) -> None:
        for kept in self._kept:
            kept.reach_time()

    def _note_event(self, event: StatusEvent) -> None:
        """Have offers look again after what may concern them: an end, or something that is well."""
        kind = event.subject.partition(" ")[0]
        wanted = _CONNECTION_CHANGES if kind == "connection" else {Health.OK.value}
        if kind in {"connection", "component", "bridge"} and event.change in wanted:
            for kept in self._kept:
                kept.look(again=kind != "connection")
