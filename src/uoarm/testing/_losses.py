"""Losses: every message that a status map knows to have been lost, by reason."""

from __future__ import annotations

from collections import Counter

from uoarm._arguments import arguments
from uoarm.model import StatusMap

__all__ = ["copies", "losses"]


@arguments()
def losses(status: StatusMap) -> Counter[str]:
    """Return how many messages were lost, by reason; 0 for each reason that is not there.

    Counts what routes dropped, those of plans that were replaced included, what was lost with
    components that died or were let go, as `lost`, what living links lost, as `lost_on_link`, and
    what living components emitted while no consumer took it, as `undelivered`. What is still under
    way is not lost: compare when nothing moves. What several routes of an output got may be lost on
    one and received on another: see `copies`. Routes that several connections shared when they
    ended are counted once for each of them.
    """
    found: Counter[str] = Counter()
    for connection in status.connections:
        found["lost"] += connection.lost
        for route in connection.ended:
            found.update(dict(route.dropped))
    for route in status.routes:
        found.update(dict(route.dropped))
    for component in status.components:
        for channel in component.channels:
            for reason in ("lost_on_link", "undelivered"):
                lost = dict(channel.facts).get(reason, 0)
                found[reason] += lost if isinstance(lost, int) else 0
    return +found


@arguments()
def copies(status: StatusMap) -> int:
    """Return how many messages were given to one more route of the output that emitted them.

    Each of them is received or lost a second time, so what was sent and the copies are what was
    received or lost. Routes that several connections shared count as for `losses`.
    """
    ended = (route for connection in status.connections for route in connection.ended)
    return sum(route.copies for route in (*ended, *status.routes))
