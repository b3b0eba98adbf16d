"""Loss accounting: what the routes that ended had counted, and what was lost with components.

It watches what ends and knows nothing of why.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import Protocol, TypeAlias
from weakref import WeakSet

from attrs import evolve

from uoarm._control.live.component import LiveComponent
from uoarm._control.live.edge import LiveEdge
from uoarm.model import Gap, RouteStatus

__all__ = ["Counting", "LossAccount"]

Sums: TypeAlias = Mapping[tuple[str, str], RouteStatus]

_GAPS = 1000


class Counting(Protocol):
    """A route, whichever end it is at."""

    def status(self) -> RouteStatus:
        """Return its counters."""


class LossAccount:
    """The gaps of a connection, and the counters of its routes that ended.

    Routes that ended last are still asked for their counters, since a thread that was about to
    use one may do so late; earlier ones are added up. Bounded: the newest thousand gaps, and one
    row for each pair of ends, of which a configuration has only so many.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.gaps: tuple[Gap, ...] = ()
        self.lost = 0
        self._ended: tuple[Sums, tuple[Counting, ...]] = ({}, ())
        self._counted: WeakSet[LiveComponent | LiveEdge] = WeakSet()

    @property
    def ended(self) -> tuple[RouteStatus, ...]:
        """The routes that ended, those between the same ends as one."""
        return tuple(_added(*self._ended).values())

    def lost_with(self, lives: Iterable[LiveComponent]) -> int:
        """Close components that died or were let go; return what was lost with them, once each."""
        lost = 0
        for live in lives:
            live.close()
            if live not in self._counted:
                self._counted.add(live)
                lost += live.lost + live.unheard
        return lost

    def ended_edges(self, edges: Iterable[LiveEdge]) -> Iterator[Counting]:
        """Yield the routes of those of the edges that have ended, once each."""
        for joined in edges:
            if joined.route is not None and joined.route.closed and joined not in self._counted:
                self._counted.add(joined)
                yield joined.route

    def add(self, gap: Gap) -> None:
        """Take in one change of plan, whose losses are not counted yet."""
        with self._lock:
            self.gaps = (*self.gaps, gap)[-_GAPS:]

    def count(self, gap: Gap, lost: int, routes: Iterable[Counting]) -> None:
        """Take in what was lost in a change of plan, and the routes that ended with it."""
        ended = tuple(routes)
        dropped = _dropped_by_reason(route.status() for route in ended)
        counted = evolve(gap, lost=lost, dropped=dropped, counted=True)
        self.settle(lost, ended)
        with self._lock:
            self.gaps = tuple(counted if one is gap else one for one in self.gaps)

    def settle(self, lost: int, routes: Iterable[Counting]) -> None:
        """Take in what was lost with components, and routes that ended."""
        ended = tuple(routes)
        with self._lock:
            self.lost += lost
            if ended:
                self._ended = _added(*self._ended), ended


def _added(sums: Sums, routes: Iterable[Counting]) -> Sums:
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


def _sum(one: RouteStatus, two: RouteStatus) -> RouteStatus:
    dropped = Counter(dict(one.dropped)) + Counter(dict(two.dropped))
    return evolve(
        two,
        received=one.received + two.received,
        delivered=one.delivered + two.delivered,
        dropped=tuple(sorted(dropped.items())),
        invalid=one.invalid + two.invalid,
        last_error=two.last_error or one.last_error,
    )
