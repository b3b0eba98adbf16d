"""What is open for offers, as objects; the engine says when each opens, closes and is tried again.

Nothing waits for an offer but those who ask for one, and a change of the configuration.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping

from attrs import define, field

from uoarm._bridges import BridgeSet
from uoarm._control.engine import actions as act
from uoarm._control.engine import events as ev
from uoarm._control.engine.state import OfferRecord
from uoarm._control.live.listeners import EventDispatcher
from uoarm._control.live.parts import StateOwner
from uoarm._control.live.revisions import Revisions
from uoarm._dataplane import Clock
from uoarm._interrupts import Uninterrupted, wait_until
from uoarm._parts import Functions, OfferedFunction, offered_structures
from uoarm._raised import LimitedLog, sentence_of
from uoarm.bridge import HealthEvent
from uoarm.errors import UoarmError
from uoarm.model import Health, Offer, OfferState, OfferStatus, Robot, RouteStatus, StatusEvent

_log = logging.getLogger("uoarm")
_LEAVING_SECONDS = 5.0
_CHANGES = frozenset({"failed", "closed", "waiting", "replaced"})


@define(eq=False)
class Offers:
    """Keeps what the configuration in force offers open, once it has begun. Thread safe.

    Args:
        owner: decides, and has `open` and `close` called in the lane of each offer.
        revisions: of the configuration; what the one in force offers is kept open.
        events: listened to for what becomes of the connections behind offers.
    """

    _owner: StateOwner
    _revisions: Revisions
    _functions: Functions
    _bridges: BridgeSet
    _events: EventDispatcher
    _clock: Clock
    _records: LimitedLog = field(factory=lambda: LimitedLog(_log), init=False)
    # Guards what is wanted, up to its event: a change of configuration adds some while the
    # manager closes.
    _wanting: threading.Lock = field(factory=threading.Lock, init=False)
    _wanted: Mapping[str, Offer] = field(factory=dict, init=False)
    _has_begun: bool = field(default=False, init=False)
    _is_closed: bool = field(default=False, init=False)
    _stop_listening: Callable[[], None] | None = field(default=None, init=False)
    # Each entry is written in the lane of its offer, and read by any thread. With the number of
    # its opening, so that no report is taken for one of the next.
    _opened: dict[str, tuple[int, OfferedFunction]] = field(factory=dict, init=False)
    # By the id of a connection, the offer that it is behind; written in the same lane. A look
    # at every offer after each event of a connection would be quadratic.
    _behind: dict[str, str] = field(factory=dict, init=False)
    _working: set[int] = field(factory=set, init=False)  # threads
    # Guards nothing: what is waited for is in the state, which is set before `wake`.
    _changed: threading.Condition = field(factory=threading.Condition, init=False)

    def begin(self, timeout: float) -> tuple[OfferStatus, ...]:
        """Open what is offered and keep it open; waits until each was tried once. Idempotent."""
        self._has_begun = True
        self.follow()
        left = list(self._wanted)

        def are_tried() -> bool:
            # Each is looked at until it was tried, and not again after that. No generator, which
            # would swallow a Ctrl-C that comes as `all` lets go of it.
            offers = self._owner.state.offers
            while left:
                record = offers.get(left[-1])
                if record is not None and not record.is_tried:
                    return False
                left.pop()
            return True

        self._wait(are_tried, timeout)
        return self.statuses()

    def follow(self) -> None:
        """Offer what the configuration in force offers, where it has begun, and nothing else.

        Waits five seconds at most for what is offered no more.
        """
        with Uninterrupted():
            with self._wanting:
                if self._is_closed or not self._has_begun:
                    return
                self._want({offer.name: offer for offer in self._revisions.current.robot.offers})
            self._wait(self._has_left, _LEAVING_SECONDS)

    def close(self) -> None:
        """Offer nothing more. Waits five seconds at most for what hangs."""
        with self._wanting:
            self._is_closed = True
            self._want({})
        if self._stop_listening is not None:
            self._stop_listening()
        self._wait(self._has_left, _LEAVING_SECONDS)

    def wake(self) -> None:
        """Wake those who wait for offers, as something has become of one."""
        with self._changed:
            self._changed.notify_all()

    def open(self, action: act.OpenOffer) -> ev.Event | None:
        """Open an offer; called in its lane."""
        offer = self._wanted.get(action.name)
        if offer is None:  # it closes: what becomes of its opening is not looked at
            return ev.OfferOpened(action.name, action.number, "it is offered no more")
        self._working.add(threading.get_ident())
        try:
            bridge = self._bridges.get(offer.bridge)
            guard = self._revisions.current.guard
            if guard is not None:
                guard.hold_offer(offer.name, offered_structures(offer, bridge))
            opened = OfferedFunction(offer, self._functions, bridge, self._clock)
            # Before it opens: a channel may report at once.
            self._opened[action.name] = action.number, opened
            opened.open()
        except Exception as error:  # noqa: BLE001 - the status shows it whatever it is
            if not isinstance(error, UoarmError):
                self._records.write(logging.ERROR, f"offering {offer.name} failed", error)
            self._opened.pop(action.name, None)
            cause = sentence_of(error)
            return ev.OfferOpened(action.name, action.number, cause)
        finally:
            self._working.discard(threading.get_ident())
        self._behind.update(dict.fromkeys(opened.connections, action.name))
        self._owner.post(ev.OfferOpened(action.name, action.number))
        # What became of a connection before it was known whose it was.
        self._look_at(action.name)
        return None

    def close_offer(self, action: act.CloseOffer) -> ev.Event:
        """Close what is open for an offer; called in its lane."""
        self._working.add(threading.get_ident())
        try:
            found = self._opened.pop(action.name, None)
            if found is not None:
                for connection in found[1].connections:
                    self._behind.pop(connection, None)
                found[1].close()
        except Exception as error:  # noqa: BLE001 - it counts as closed, or it would never open again
            self._records.write(logging.ERROR, f"closing offer {action.name} failed", error)
        finally:
            self._working.discard(threading.get_ident())
        return ev.OfferClosed(action.name, action.number)

    def reported(self, event: HealthEvent) -> bool:
        """Queue what a bridge reports; True where it concerns an offer and nothing else."""
        channel = event.channel
        if channel is None and event.component is None:
            # Of a whole bridge, and of its components, too. A loss ends each of its offers.
            if event.health in {Health.LOST, Health.FINISHED}:
                for offer, (number, opened) in self._opened.copy().items():
                    if event.bridge == opened.offer.bridge:
                        what = offer, number, event.health, event.cause
                        self._owner.queue(ev.OfferReported(*what))
            return False
        name = (event.component or "") if channel is None else channel.endpoint.component
        found = self._opened.get(name)
        if found is None or event.bridge != found[1].offer.bridge:
            return False
        if channel is None or not channel.closed:
            self._owner.queue(ev.OfferReported(name, found[0], event.health, event.cause))
        return True

    def statuses(self) -> tuple[OfferStatus, ...]:
        """Return what the status map shows of offers."""
        if not self._has_begun:
            return ()
        records = self._owner.state.offers
        return tuple(
            self._status(offer, records.get(offer.name))
            for offer in self._revisions.current.robot.offers
        )

    def routes(self) -> tuple[RouteStatus, ...]:
        """Return the counters of what goes out to frameworks and comes in from them."""
        there = self._opened.copy().values()
        return tuple(route for _, opened in there for route in opened.routes())

    def connections_without(self, robot: Robot) -> frozenset[str]:
        """Return the connections behind offers that another configuration has no more."""
        there = self._opened.copy().values()
        kept = {offer.name: offer for offer in robot.offers}
        gone = (opened for _, opened in there if kept.get(opened.offer.name) != opened.offer)
        return frozenset(connection for opened in gone for connection in opened.connections)

    def _want(self, wanted: Mapping[str, Offer]) -> None:
        if not wanted and not self._wanted:
            return
        if self._stop_listening is None:
            self._stop_listening = self._events.listen(self._note_event)
        before, self._wanted = self._wanted, wanted
        replaced = {name for name, offer in before.items() if wanted.get(name, offer) != offer}
        self._owner.post(ev.OffersWanted(tuple(wanted), frozenset(replaced)))
        for name, (number, opened) in self._opened.copy().items():
            if not self._bridges.is_in_use(opened.bridge):
                cause = f"bridge {opened.offer.bridge!r} is another one"
                self._owner.post(ev.OfferReported(name, number, Health.LOST, cause))

    def _has_left(self) -> bool:
        return not self._owner.state.leaving

    def _wait(self, is_done: Callable[[], bool], timeout: float) -> None:
        # Code of a component may close the manager, or change the configuration, while an offer
        # opens or closes: that would wait for itself.
        if threading.get_ident() not in self._working:
            with self._changed:
                wait_until(self._changed, is_done, timeout)

    def _status(self, offer: Offer, record: OfferRecord | None) -> OfferStatus:
        _, opened = self._opened.get(offer.name, (0, None))
        state = OfferState.CLOSED if self._is_closed else OfferState.OPENING
        return OfferStatus(
            name=offer.name,
            function=offer.function,
            bridge=offer.bridge,
            state=state if record is None else record.state,
            endpoints=offer.addresses,
            connections=() if opened is None else opened.connections,
            calls=0 if opened is None else opened.calls,
            failed=0 if opened is None else opened.failed,
            cause="" if record is None else record.cause,
        )

    def _note_event(self, event: StatusEvent) -> None:
        """Look at the offer that a connection is behind, of which something may have become."""
        kind, _, identity = event.subject.partition(" ")
        if kind == "connection" and event.change in _CHANGES:
            self._look_at(self._behind.get(identity, ""))

    def _look_at(self, name: str) -> None:
        found = self._opened.get(name)
        if found is None:  # it closes
            return
        number, opened = found
        opened.provider_changed()
        if opened.broken is not None:
            self._owner.post(ev.OfferReported(name, number, Health.LOST, opened.broken))
        elif opened.finished is not None:
            self._owner.post(ev.OfferReported(name, number, Health.FINISHED, opened.finished))
