"""History: what a connection's earlier plans counted, which no live route shows any more."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from weakref import WeakSet

from attrs import evolve

from uoarm.manager._live import LiveComponent
from uoarm.manager._live_edge import LiveEdge
from uoarm.manager._opening import OpenPlan
from uoarm.model import Gap, RouteStatus

__all__ = ["History", "dropped_by_reason"]

_GAPS = 1000


class History:
    """The gaps of a connection, and the counters of its routes that ended.

    Bounded: the newest thousand gaps, and one row for each pair of ends, of which a
    configuration has only so many.
    """

    def __init__(self) -> None:
        self.gaps: tuple[Gap, ...] = ()
        self.changes = 0
        self.lost = 0
        self._ended: dict[tuple[str, str], RouteStatus] = {}
        self._counted: WeakSet[LiveComponent | LiveEdge] = WeakSet()

    @property
    def ended(self) -> tuple[RouteStatus, ...]:
        """The routes that ended, those between the same ends as one."""
        return tuple(self._ended.values())

    def lost_with(self, lives: Iterable[LiveComponent]) -> int:
        """Close components that died or were let go; return what was lost with them, once each."""
        lost = 0
        for live in lives:
            live.close()
            if live not in self._counted:
                self._counted.add(live)
                lost += live.lost + live.unheard
        return lost

    def ended_edges(self, plan: OpenPlan) -> Iterator[RouteStatus]:
        """Yield the counters of the edges of a plan that have ended, once each."""
        for joined in plan.edges:
            if joined.route is not None and joined.route.closed and joined not in self._counted:
                self._counted.add(joined)
                yield joined.route.status()

    def add(self, gap: Gap, routes: Iterable[RouteStatus]) -> None:
        """Take in one change of plan and what the routes that ended with it had counted."""
        self.settle(gap.lost, routes)
        self.changes += 1
        self.gaps = (*self.gaps, gap)[-_GAPS:]

    def settle(self, lost: int, routes: Iterable[RouteStatus]) -> None:
        """Take in what was lost with components, and what routes that ended had counted."""
        self.lost += lost
        for route in routes:
            ends = route.producer, route.consumer
            settled = _settled(route)
            before = self._ended.get(ends)
            self._ended[ends] = settled if before is None else _sum(before, settled)


def dropped_by_reason(routes: Iterable[RouteStatus]) -> tuple[tuple[str, int], ...]:
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
