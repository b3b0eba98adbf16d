"""How a component is doing: the worst of what was told of its channels, itself and its bridge."""

from __future__ import annotations

from collections.abc import Hashable

from uoarm.bridge import HealthEvent
from uoarm.model import Health

__all__ = ["Condition"]

_BETTER_TO_WORSE = tuple(Health)


class Condition:
    """What was told last of each part of a component; one part that is well covers up no other.

    Attributes:
        health: the worst of all.
        cause: of that; where it was just told, the newest.
    """

    def __init__(self) -> None:
        self.health = Health.OK
        self.cause = ""
        self._told: dict[Hashable, tuple[Health, str]] = {}

    def note(self, event: HealthEvent) -> bool:
        """Take note of an event about a part; True when that is news of the whole.

        It is none when a worse one elsewhere covers it up, or when all was well before.
        """
        before, told = (self.health, self.cause), (event.health, event.cause)
        self._told[_part(event)] = told
        worst = max(self._told.values(), key=lambda one: _BETTER_TO_WORSE.index(one[0]))
        self.health, self.cause = told if told[0] is worst[0] else worst
        now = self.health, self.cause
        if before[0] is now[0] is Health.OK:
            return False
        return now == told or now != before


def _part(event: HealthEvent) -> Hashable:
    if event.channel is None:
        return "bridge" if event.component is None else "component"
    return event.channel.endpoint.role, event.channel.endpoint.port
