"""What the manager holds of one connection beside its record: its inbox, its ports, its losses."""

from __future__ import annotations

import logging
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, TypeAlias
from weakref import WeakSet

from attrs import evolve

from uoarm._control.engine.actions import HandOver
from uoarm._control.engine.state import ConnectionRecord
from uoarm._dataplane import Route
from uoarm._interrupts import wait_for
from uoarm._parts import ApplicationPorts, LiveComponent, LiveEdge, OutputReceiver
from uoarm._raised import LimitedLog
from uoarm._spans import past_span
from uoarm.model import Gap, QueuePolicy, RouteStatus

Sums: TypeAlias = Mapping[tuple[str, str], RouteStatus]
Gone: TypeAlias = tuple[LiveComponent, ...]

_GAPS = 1000
_GAP_OCTETS = 64 * 1024
_RECENT = 8
_WARNINGS = 16
_log = logging.getLogger("uoarm")


class LossAccount:
    """The gaps of a connection, and the counters of its routes that ended.

    What ended last, components and routes, is still asked for its counters, since a thread that
    was about to use one may do so late; what ended earlier is added up. Bounded: the newest gaps,
    as many as find room, the last few ends, and one row for each pair of ends, of which a
    configuration has only so many.
    """

    def __init__(self) -> None:
        # Guards sums and gaps: lanes that close add to them while a status reads them. A reader
        # takes sums and what ended last at once, or it would count some twice or not at all.
        self._lock = threading.Lock()
        self.gaps: tuple[Gap, ...] = ()
        self._lost = 0
        self._sums: Sums = {}
        self._recent: deque[tuple[Gone, tuple[Route, ...]]] = deque()
        # Two plans may share what ends: the first that ends with it counts it, no other once more.
        self._counted: WeakSet[LiveComponent | LiveEdge] = WeakSet()

    @property
    def ended(self) -> tuple[RouteStatus, ...]:
        """The routes that ended, those between the same ends as one."""
        with self._lock:
            sums, recent = self._sums, tuple(self._recent)
        return tuple(_added(sums, (route for _, routes in recent for route in routes)).values())

    @property
    def lost(self) -> int:
        """How many messages were lost with components, as known now."""
        with self._lock:
            lost, recent = self._lost, tuple(self._recent)
        return lost + sum(_lost_with(gone) for gone, _ in recent)

    def close(self, lives: Iterable[LiveComponent]) -> Gone:
        """Close components that died or were let go; return those not counted yet."""
        gone = []
        for live in lives:
            live.close()
            if live not in self._counted:
                self._counted.add(live)
                gone.append(live)
        return tuple(gone)

    def ended_edges(self, edges: Iterable[LiveEdge]) -> Iterator[Route]:
        """Yield the routes of those of the edges that have ended, once each."""
        for joined in edges:
            if joined.route is not None and joined.route.closed and joined not in self._counted:
                self._counted.add(joined)
                yield joined.route

    def add(self, gap: Gap) -> None:
        """Take in one change of plan, whose losses are not counted yet."""
        with self._lock:
            self.gaps = _newest((*self.gaps[1 - _GAPS :], gap))

    def count(self, gap: Gap, gone: Gone, routes: Iterable[Route]) -> None:
        """Take in a change of plan, with components that are gone and routes that ended."""
        ended = tuple(routes)
        dropped = _dropped_by_reason(route.status() for route in ended)
        counted = evolve(gap, lost=_lost_with(gone), dropped=dropped, counted=True)
        self.settle(gone, ended)
        # In its place, by identity: another gap may be equal, and it may have been forgotten.
        with self._lock:
            self.gaps = tuple(counted if item is gap else item for item in self.gaps)

    def settle(self, gone: Gone, routes: Iterable[Route]) -> None:
        """Take in components that are gone, and routes that ended."""
        ended = tuple(routes)
        if not gone and not ended:
            return
        with self._lock:
            self._recent.append((gone, ended))
            if len(self._recent) > _RECENT:
                gone, ended = self._recent.popleft()
                self._lost += _lost_with(gone)
                self._sums = _added(self._sums, ended)


def _newest(gaps: tuple[Gap, ...]) -> tuple[Gap, ...]:
    """Return the newest gaps, as many as find room, and the last one in any case."""
    octets = 0
    for count, gap in enumerate(reversed(gaps)):
        octets += 300 + len(gap.cause) + sum(len(name) for name in (*gap.before, *gap.after))
        if count and octets > _GAP_OCTETS:
            return gaps[-count:]
    return gaps


def _lost_with(gone: Gone) -> int:
    return sum(live.lost for live in gone)


def _added(sums: Sums, routes: Iterable[Route]) -> Sums:
    added = dict(sums)
    for route in routes:
        status = _settled(route.status())
        ends = status.producer, status.consumer
        before = added.get(ends)
        added[ends] = status if before is None else _sum(before, status)
    return added


def _dropped_by_reason(routes: Iterable[RouteStatus]) -> tuple[tuple[str, int], ...]:
    """Return how many messages routes that ended have dropped, by reason."""
    total: Counter[str] = Counter()
    for route in routes:
        total.update(dict(_settled(route).dropped))
    return tuple(sorted(total.items()))


def _settled(route: RouteStatus) -> RouteStatus:
    """Count as dropped what a consumer still has in hand after its route has ended."""
    dropped = Counter(dict(route.dropped))
    rest = route.received - route.delivered - dropped.total()
    if rest > 0:
        dropped["in-hand"] += rest
    return evolve(route, dropped=tuple(sorted(dropped.items())), rate=None, age=None)


def _sum(earlier: RouteStatus, later: RouteStatus) -> RouteStatus:
    dropped = Counter(dict(earlier.dropped)) + Counter(dict(later.dropped))
    return evolve(
        later,
        received=earlier.received + later.received,
        delivered=earlier.delivered + later.delivered,
        dropped=tuple(sorted(dropped.items())),
        invalid=earlier.invalid + later.invalid,
        last_error=later.last_error or earlier.last_error,
        copies=earlier.copies + later.copies,
    )


class ConnectionRuntime:
    """One connection, as the threads see it that move messages and those that read its handle.

    Args:
        on_raised: called with what a callback of the application raised first.

    Attributes:
        record: the connection as it was published last; None while its request is being resolved.
        receiver: what the application reads.
        ports: where the application touches the plan that runs.
        losses: what is accounted for.
        handle: the `Connection` that the application holds; None before it has it, and at its end.
        context: of its request, to which spans of other threads belong.
    """

    def __init__(self, identity: str, queue: QueuePolicy, on_raised: Callable[[str], None]) -> None:
        self.id = identity
        self.record: ConnectionRecord | None = None
        self.receiver = OutputReceiver(queue, on_raised)
        self.losses = LossAccount()
        self.ports: ApplicationPorts | None = None
        self.handle: Any = None
        self.context: Any = None
        # By the plan that ended: put as the next one takes over, taken by the close that knows what
        # was lost, which may be half a minute later.
        self._uncounted: dict[str, Gap] = {}
        self._warned: set[str] = set()

    def warn(self, text: str) -> None:
        """Write a warning; the same once more, until another plan runs, is for debugging.

        In a lane: a handler of the log is foreign, and may end the connection.

        What waits searches every five seconds at the least, and may fail for days.
        """
        level = logging.DEBUG if text in self._warned else logging.WARNING
        if len(self._warned) >= _WARNINGS:
            self._warned.clear()
        self._warned.add(text)
        LimitedLog(_log).write(level, f"connection {self.id}: {text}")

    def publish(self, record: ConnectionRecord) -> None:
        """Show the connection as it is now; at its end, its inbox closes."""
        # The record first: who is woken by the closed inbox reads in it how the connection ended.
        self.record = record
        if record.state.is_over:
            self.receiver.inbox.close(discard=record.is_killed)
            self.handle = None  # which refers to this

    def routes(self) -> tuple[RouteStatus, ...]:
        """Return the counters of the routes that belong to this connection alone."""
        ports = self.ports
        return () if ports is None else tuple(route.status() for route in ports.routes())

    def hand_over(self, action: HandOver, ports: ApplicationPorts) -> None:
        """Receive from the next plan only, and note the gap, whose losses are not counted yet.

        Who sees the gap sees the plan behind it.

        Args:
            action: which plan takes over from which, when and why.
            ports: where the application touches the next one.
        """
        before, after = action.before, action.after
        self._warned.clear()
        # Ports before the receiver: who sends on the first message of the next plan sends into it.
        self.ports = ports
        self.receiver.deliver_from(ports.route, ports.outlet)
        stays = before.ports == after.ports
        gap = Gap(
            time=action.time,
            position=self.receiver.arrived if stays else self.receiver.began,
            seconds=action.time - action.since,
            lost=0,
            before=before.plan.names,
            after=after.plan.names,
            cause=action.cause,
            counted=False,
        )
        self._uncounted[before.user] = gap
        if action.is_receiving:  # else it was published before
            self.record = action.record
        self.losses.add(gap)

    def take_gap(self, before: str) -> Gap | None:
        """Return the gap in which the plan of this user ended, once; None: it never ran."""
        return self._uncounted.pop(before, None)


class StartDelivery:
    """A job: have an application receive from a plan that is open, its retained message first."""

    def __init__(
        self, action: HandOver, runtime: ConnectionRuntime, ports: ApplicationPorts
    ) -> None:
        self._action = action
        self._runtime = runtime
        self._ports = ports
        self._thread = 0
        self._over = threading.Event()

    @property
    def is_over(self) -> bool:
        """Whether it was done."""
        return self._over.is_set()

    def wait(self, timeout: float) -> bool:
        """Wait until it was done, but not in the thread that does it; False: it was not."""
        return self._thread == threading.get_ident() or wait_for(self._over, timeout)

    def __call__(self) -> None:
        self._thread = threading.get_ident()
        try:
            with self._ports.letting_through():
                self._runtime.hand_over(self._action, self._ports)
        finally:
            self._over.set()


def record_takeover(action: HandOver, runtime: ConnectionRuntime) -> None:
    """Record a takeover, from when it was needed to when it was done."""
    past_span(
        "takeover",
        action.time - action.since,
        runtime.context,
        connection=action.connection,
        function=action.after.plan.function,
        cause=action.cause,
        before=" -> ".join(action.before.plan.names),
        after=" -> ".join(action.after.plan.names),
    )
