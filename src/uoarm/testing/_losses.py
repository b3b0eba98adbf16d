"""Losses: every message that a status map knows to have been lost, by reason."""

from __future__ import annotations

from collections import Counter

from uoarm.model import StatusMap

__all__ = ["losses"]


def losses(status: StatusMap) -> Counter[str]:
    """Return how many messages were lost, by reason; 0 for each reason that is not there.

    Counts what routes dropped, those of plans that were replaced included, what was lost with
    components that died, as `lost`, and what living links lost, as `lost_on_link`. What is still
    under way is not lost: compare when nothing moves. Routes that several connections shared
    when they ended are counted once for each of them.
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
            lost = dict(channel.facts).get("lost_on_link", 0)
            found["lost_on_link"] += lost if isinstance(lost, int) else 0
    return +found
