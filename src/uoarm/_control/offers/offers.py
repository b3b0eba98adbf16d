"""What the configuration offers: kept open, each offer by a thread of its own."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from uoarm._control.bridges.bridge_set import BridgeSet
from uoarm._control.offers.offered_function import Functions, OfferedFunction
from uoarm._control.runtime.event_dispatcher import EventDispatcher
from uoarm._dataplane import Clock
from uoarm.bridge import HealthEvent
from uoarm.errors import UoarmError
from uoarm.model import Health, Offer, OfferState, OfferStatus, Robot, RouteStatus, StatusEvent

__all__ = ["Offers", "pause"]

_log = logging.getLogger("uoarm")
_LEAST_PAUSE, _LONGEST_PAUSE = 0.1, 30.0
_CLOSE_SECONDS = 5.0
_CONNECTION_CHANGES = frozenset({"failed", "closed", "waiting", "replaced"})


def pause(failures: int) -> float:
    """Return how many seconds to wait after so many failures in a row: 1, 2, 4, up to 30."""
    return float(min(_LONGEST_PAUSE, 2 ** min(failures - 1, 8)))


class _Keeper:
    """Keeps one offer open until it is told to end: opens it, and again when something broke.

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
    ) -> None:
        self.offer = offer
        self.tried = threading.Event()
        self._functions = functions
        self._bridges = bridges
        self._events = events
        self._clock = clock
        self._changed = threading.Condition()
        self._state, self._cause = OfferState.OPENING, ""
        self._opened: OfferedFunction | None = None
        self._broken: str | None = None
        self._is_over = self._is_asked = False
        name = f"uoarm-offer-{offer.name}"
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def status(self) -> OfferStatus:
        """Return what the status map shows."""
        opened = self._opened
        return OfferStatus(
            name=self.offer.name,
            function=self.offer.function,
            bridge=self.offer.bridge,
            state=self._state,
            endpoints=tuple(one.address for one in self.offer.endpoints),
            connections=() if opened is None else opened.connections,
            calls=0 if opened is None else opened.calls,
            failed=0 if opened is None else opened.failed,
            cause=self._cause,
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
        if event.health in {Health.LOST, Health.FINISHED}:
            self._break(event.cause)
        elif not is_whole:
            self._cause = event.cause if event.health is Health.DEGRADED else ""
            self._events.post(f"offer {self.offer.name}", event.health.value, event.cause)
        return not is_whole

    def look(self, *, again: bool = True) -> None:
        """See whether it still is as it should; where it failed, try at once if asked `again`."""
        opened = self._opened
        if opened is not None:
            opened.provider_changed()
            ended = opened.ended
            if ended is not None:
                self._break(ended)
            elif not self._bridges.is_in_use(opened.bridge):
                self._break(f"bridge {self.offer.bridge!r} is another one")
        with self._changed:
            self._is_asked = self._is_asked or again
            self._changed.notify_all()

    def end(self) -> None:
        """Have it close what is open, and end. Returns at once; `join` waits."""
        with self._changed:
            self._is_over = True
            self._changed.notify_all()

    def join(self, timeout: float) -> None:
        """Wait until it has ended."""
        if self._thread is not threading.current_thread():
            self._thread.join(timeout)

    def _break(self, cause: str) -> None:
        with self._changed:
            if self._broken is None:
                self._broken = cause
                self._changed.notify_all()

    def _run(self) -> None:
        failures = 0
        while not self._is_over:
            begun = self._clock()
            with self._changed:
                self._broken, self._is_asked = None, False
            try:
                self._open()
            except Exception as error:  # noqa: BLE001 - the status shows it whatever it is
                if not isinstance(error, UoarmError):
                    _log.exception("offering %s failed", self.offer.name)
                self._fail(str(error) or type(error).__name__)
                failures += 1
                self.tried.set()
                self._rest(pause(failures))
                continue
            self.tried.set()
            self._wait_for_the_end()
            self._close()
            # What broke is opened at once; what breaks again and again, as a source that has
            # nothing more to say, is not opened as often as the processor can.
            failures = failures + 1 if self._clock() - begun < _LONGEST_PAUSE else 0
            if failures > 1:
                self._rest(pause(failures - 1))
        self._turn(OfferState.CLOSED, "")
        self.tried.set()

    def _open(self) -> None:
        bridge = self._bridges.get(self.offer.bridge)
        opened = OfferedFunction(self.offer, self._functions, bridge, self._clock)
        self._opened = opened  # before it opens: a channel may report at once
        opened.open()
        ended = opened.ended
        if ended is not None:  # before anybody could know whose connection it was
            self._break(ended)
        self._turn(OfferState.OPEN, "")

    def _fail(self, cause: str) -> None:
        self._opened = None
        if self._state is not OfferState.FAILED or cause != self._cause:
            self._turn(OfferState.FAILED, cause)

    def _wait_for_the_end(self) -> None:
        with self._changed:
            self._changed.wait_for(lambda: self._is_over or self._broken is not None)
            cause = self._broken
        if cause is not None and not self._is_over:
            self._turn(OfferState.OPENING, cause)

    def _rest(self, seconds: float) -> None:
        """Wait until the time is up, or something is well again, but a tenth of a second."""
        with self._changed:
            self._changed.wait_for(lambda: self._is_over, _LEAST_PAUSE)
            self._changed.wait_for(lambda: self._is_over or self._is_asked, seconds)

    def _close(self) -> None:
        opened, self._opened = self._opened, None
        if opened is not None:
            opened.close()

    def _turn(self, state: OfferState, cause: str) -> None:
        self._state, self._cause = state, cause
        self._events.post(f"offer {self.offer.name}", state.value, cause)


class Offers:
    """Keeps what the configuration in force offers open, once it has begun. Thread safe.

    Args:
        robot: gives the configuration in force.
        functions: where functions are requested, as every application does.
        bridges: of the manager.
        events: told of every change, and listened to for those that concern an offer.
        clock: a monotonic clock, in seconds.
    """

    def __init__(
        self,
        robot: Callable[[], Robot],
        functions: Functions,
        bridges: BridgeSet,
        events: EventDispatcher,
        clock: Clock,
    ) -> None:
        self._robot = robot
        self._functions = functions
        self._bridges = bridges
        self._events = events
        self._clock = clock
        self._lock = threading.Lock()
        self._keepers: tuple[_Keeper, ...] = ()
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
        with self._lock:
            wanted = self._robot().offers
            if self._closed.is_set() or not self._has_begun or not (wanted or self._keepers):
                return
            if self._stop_listening is None:
                self._stop_listening = self._events.listen(self._heard)
            gone = [one for one in self._keepers if one.offer not in wanted]
        for keeper in gone:
            keeper.end()
        for keeper in gone:  # its endpoints may be offered for another function next
            keeper.join(_CLOSE_SECONDS)
        with self._lock:
            if self._closed.is_set():
                return
            kept = {one.offer.name: one for one in self._keepers if one not in gone}
            self._keepers = tuple(kept.get(one.name) or self._keeper(one) for one in wanted)
        for keeper in kept.values():
            keeper.look()

    def reported(self, event: HealthEvent) -> bool:
        """Take what a bridge reports; True where it concerns an offer and nothing else."""
        told = [keeper.reported(event) for keeper in self._keepers]
        return any(told)

    def statuses(self) -> tuple[OfferStatus, ...]:
        """Return what the status map shows of offers."""
        return tuple(one.status() for one in self._keepers)

    def routes(self) -> tuple[RouteStatus, ...]:
        """Return the counters of what goes out to frameworks and comes in from them."""
        return tuple(route for one in self._keepers for route in one.routes())

    def connections_without(self, robot: Robot) -> frozenset[str]:
        """Return the connections behind offers that another configuration has no more."""
        gone = (one for one in self._keepers if one.offer not in robot.offers)
        return frozenset(each for one in gone for each in one.status().connections)

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

    def _keeper(self, offer: Offer) -> _Keeper:
        return _Keeper(offer, self._functions, self._bridges, self._events, self._clock)

    def _heard(self, event: StatusEvent) -> None:
        """Have offers look again after what may concern them: an end, or something that is well."""
        kind = event.subject.partition(" ")[0]
        wanted = _CONNECTION_CHANGES if kind == "connection" else {Health.OK.value}
        if kind in {"connection", "component", "bridge"} and event.change in wanted:
            for keeper in self._keepers:
                keeper.look(again=kind != "connection")
