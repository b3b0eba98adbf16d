"""What the configuration offers: kept open by worker threads, as `OfferMachine` says.

The machine decides when one offer is opened, closed and tried again, without thread and clock.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from enum import Enum

from attrs import define

from uoarm._backoff import Backoff
from uoarm._control.bridges import BridgeSet
from uoarm._control.offered_function import Functions, OfferedFunction
from uoarm._control.revisions import Revisions
from uoarm._control.threads import EventDispatcher, Timer
from uoarm._dataplane import Clock
from uoarm._interrupts import Uninterrupted
from uoarm._support.workers import WorkerPool
from uoarm.bridge import Bridge, HealthEvent
from uoarm.errors import UoarmError
from uoarm.model import Health, Offer, OfferState, OfferStatus, Robot, RouteStatus, StatusEvent

__all__ = ["OfferMachine", "Offers", "Work"]

_LEAST_PAUSE, _LONGEST_PAUSE = 0.1, 30.0
_PAUSES = Backoff(first=1.0, most=_LONGEST_PAUSE)


class Work(Enum):
    """What is to be done; its end is reported to the machine before anything else is."""

    OPEN = "open"
    CLOSE = "close"


@define(eq=False)
class OfferMachine:
    """One offer. The caller holds a lock, does what `begin` returns, and reports what came of it.

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
        self._rest(_PAUSES.pause(self._failures), now)

    def closed(self, now: float) -> None:
        """Take in that what was open is closed."""
        self._work, self._is_open = None, False
        if self._finished is not None and not self._is_over:
            self._turn(OfferState.FINISHED, self._finished)
            return
        self._failures = self._failures + 1 if now - self._begun < _LONGEST_PAUSE else 0
        self._rest(_PAUSES.pause(self._failures - 1) if self._failures > 1 else 0.0, now)

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


_log = logging.getLogger("uoarm")
_CLOSE_SECONDS = 5.0
_CONNECTION_CHANGES = frozenset({"failed", "closed", "waiting", "replaced"})

Hold = Callable[[Offer, Bridge], None]


class _Keeper:
    """Keeps one offer open until it is ended.

    No thread waits for it: `drive` has a worker thread do what is due, and has the timer call it
    when something will be.

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
        start: Callable[[Callable[[], None]], object],
        timer: Timer,
        hold: Hold,
    ) -> None:
        self.offer = offer
        self.tried = threading.Event()
        self._functions = functions
        self._bridges = bridges
        self._events = events
        self._clock = clock
        self._start = start
        self._timer = timer
        self._hold = hold
        # Guards the machine, which knows no threads: bridges report while a worker opens.
        self._lock = threading.Lock()
        self._machine = OfferMachine()
        self._announced = self._machine.state, ""
        self._opened: OfferedFunction | None = None
        self._worker: threading.Thread | None = None
        self._ended = threading.Event()

    def status(self) -> OfferStatus:
        """Return what the status map shows."""
        opened = self._opened
        with self._lock:
            state, cause = self._machine.state, self._machine.cause
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
        if event.health is Health.LOST:
            self._report(lambda machine: machine.broke(event.cause))
        elif event.health is Health.FINISHED:
            self._report(lambda machine: machine.finished(event.cause))
        elif not is_whole:
            cause = event.cause if event.health is Health.DEGRADED else ""
            self._report(lambda machine: machine.degraded(cause))
            self._events.post(f"offer {self.offer.name}", event.health.value, event.cause)
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
                    self._machine.broke(cause)
        if again:
            with self._lock:
                self._machine.retry(self._clock())
        self.drive()

    def end(self) -> None:
        """Have it close what is open, and end. Returns at once; `join` waits."""
        self._report(lambda machine: machine.end())

    def join(self, timeout: float) -> None:
        """Wait until it has ended; not in the thread that is to end it."""
        if self._worker is not threading.current_thread():
            self._ended.wait(timeout)

    def drive(self) -> None:
        """Have a worker thread do what is due, if nothing is under way. Waits for nothing."""
        work = self._next()
        if work is None:
            return
        try:
            self._start(lambda: self._do(work))
        except RuntimeError as error:  # the system gives no more threads
            with self._lock:
                self._machine.failed(str(error), self._clock())
                self._timer.wake_at(self._clock() + 1)

    def _report(self, report: Callable[[OfferMachine], None]) -> None:
        with self._lock:
            report(self._machine)
        self.drive()

    def _next(self) -> Work | None:
        """Return what is to be done now, and announce what has changed."""
        with self._lock:
            machine = self._machine
            work = machine.begin(self._clock())
            now = machine.state, "" if machine.state is OfferState.OPEN else machine.cause
            if now != self._announced:  # under the lock, so that events come in order
                self._announced = now
                self._events.post(f"offer {self.offer.name}", now[0].value, now[1])
            if work is None and machine.due is not None:
                self._timer.wake_at(machine.due)
        if machine.is_tried or machine.state is OfferState.CLOSED:
            self.tried.set()
        if machine.state is OfferState.CLOSED:
            self._ended.set()
        return work

    def _do(self, first: Work) -> None:
        """Do what is to be done, and what follows from it."""
        self._worker = own = threading.current_thread()
        work: Work | None = first
        while work is not None:
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
                    self._machine.failed(str(error) or type(error).__name__, self._clock())
            work = self._next()
        if self._worker is own:
            self._worker = None

    def _open(self) -> None:
        bridge = self._bridges.get(self.offer.bridge)
        self._hold(self.offer, bridge)
        opened = OfferedFunction(self.offer, self._functions, bridge, self._clock)
        self._opened = opened  # before it opens: a channel may report at once
        opened.open()
        with self._lock:
            self._machine.opened()
        self._judge(opened)  # what ended before it could be known whose connection it was

    def _judge(self, opened: OfferedFunction) -> None:
        with self._lock:
            if opened.broken is not None:
                self._machine.broke(opened.broken)
            elif opened.finished is not None:
                self._machine.finished(opened.finished)

    def _close(self) -> None:
        opened, self._opened = self._opened, None
        if opened is not None:
            opened.close()
        with self._lock:
            self._machine.closed(self._clock())


class Offers:
    """Keeps what the configuration in force offers open, once it has begun. Thread safe.

    Args:
        revisions: of the configuration; what the one in force offers is kept open.
        functions: where functions are requested, as every application does.
        bridges: of the manager.
        events: notified of every change, and listened to for those that concern an offer.
        clock: a monotonic clock, in seconds.
        hold: raises ResolutionError where an offer may not be opened.
    """

    def __init__(
        self,
        revisions: Revisions,
        functions: Functions,
        bridges: BridgeSet,
        events: EventDispatcher,
        clock: Clock,
        hold: Hold,
    ) -> None:
        self._revisions = revisions
        self._functions = functions
        self._bridges = bridges
        self._events = events
        self._clock = clock
        self._hold = hold
        # Guards which offers are kept: a change of configuration adds some while the manager
        # closes.
        self._lock = threading.Lock()
        self._keepers: tuple[_Keeper, ...] = ()
        self._workers = WorkerPool("uoarm-offer")
        self._timer = Timer(clock, self._time_reached)
        self._has_begun = False
        self._stop_listening: Callable[[], None] | None = None
        self._closed = threading.Event()

    def begin(self, timeout: float) -> tuple[OfferStatus, ...]:
        """Open what is offered and keep it open; waits until each was tried once. Idempotent."""
        self._has_begun = True
        self.follow()
        deadline = time.monotonic() + timeout
        for keeper in self._keepers:
            keeper.tried.wait(max(0.0, deadline - time.monotonic()))
        return self.statuses()

    def follow(self) -> None:
        """Offer what the configuration in force offers, where it has begun, and nothing else."""
        with Uninterrupted():
            self._follow()

    def _follow(self) -> None:
        with self._lock:
            wanted = self._revisions.current.robot.offers
            if self._closed.is_set() or not self._has_begun or not (wanted or self._keepers):
                return
            if self._stop_listening is None:
                self._stop_listening = self._events.listen(self._note_event)
            gone = [item for item in self._keepers if item.offer not in wanted]
        for keeper in gone:
            keeper.end()
        for keeper in gone:  # its endpoints may be offered for another function next
            keeper.join(_CLOSE_SECONDS)
        with self._lock:
            if self._closed.is_set():
                return
            kept = {item.offer.name: item for item in self._keepers if item not in gone}
            self._keepers = tuple(kept.get(offer.name) or self._keeper(offer) for offer in wanted)
        for keeper in self._keepers:
            keeper.look()

    def reported(self, event: HealthEvent) -> bool:
        """Take what a bridge reports; True where it concerns an offer and nothing else."""
        reports = [keeper.reported(event) for keeper in self._keepers]
        return any(reports)

    def statuses(self) -> tuple[OfferStatus, ...]:
        """Return what the status map shows of offers."""
        return tuple(keeper.status() for keeper in self._keepers)

    def routes(self) -> tuple[RouteStatus, ...]:
        """Return the counters of what goes out to frameworks and comes in from them."""
        return tuple(route for keeper in self._keepers for route in keeper.routes())

    def connections_without(self, robot: Robot) -> frozenset[str]:
        """Return the connections behind offers that another configuration has no more."""
        gone = (keeper for keeper in self._keepers if keeper.offer not in robot.offers)
        return frozenset(
            connection for keeper in gone for connection in keeper.status().connections
        )

    def close(self) -> None:
        """Offer nothing more. Waits five seconds at most for what hangs."""
        with self._lock:
            self._closed.set()
            keepers, stop = self._keepers, self._stop_listening
        if stop is not None:
            stop()
        for keeper in keepers:
            keeper.end()
        deadline = time.monotonic() + _CLOSE_SECONDS
        for keeper in keepers:
            keeper.join(max(0.0, deadline - time.monotonic()))
        self._timer.close()
        self._workers.close(drop=False)

    def _keeper(self, offer: Offer) -> _Keeper:
        return _Keeper(
            offer,
            self._functions,
            self._bridges,
            self._events,
            self._clock,
            self._workers.submit,
            self._timer,
            self._hold,
        )

    def _time_reached(self) -> None:
        for keeper in self._keepers:
            keeper.drive()

    def _note_event(self, event: StatusEvent) -> None:
        """Have offers look again after what may concern them: an end, or something that is well."""
        kind = event.subject.partition(" ")[0]
        wanted = _CONNECTION_CHANGES if kind == "connection" else {Health.OK.value}
        if kind in {"connection", "component", "bridge"} and event.change in wanted:
            for keeper in self._keepers:
                keeper.look(again=kind != "connection")
