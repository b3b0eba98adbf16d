"""History: what a connection's earlier plans counted, which no live route shows any more."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from attrs import evolve

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

    @property
    def ended(self) -> tuple[RouteStatus, ...]:
        """The routes that ended, those between the same ends as one."""
        return tuple(self._ended.values())

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
