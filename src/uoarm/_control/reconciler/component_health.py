"""How a component is doing: the worst of what was reported of its channels, itself, its bridge."""

from __future__ import annotations

from collections.abc import Hashable, Mapping

from attrs import evolve, field, frozen

from uoarm.model import Health

__all__ = ["ComponentHealth"]

_BETTER_TO_WORSE = tuple(Health)


@frozen
class ComponentHealth:
    """What was reported last of each part; one part that is well covers up no other.

    Attributes:
        health: the worst of all.
        cause: of that; where it was just reported, the newest.
    """

    health: Health = Health.OK
    cause: str = ""
    _reported: Mapping[Hashable, tuple[Health, str]] = field(factory=dict)

    def noted(self, part: Hashable, health: Health, cause: str) -> ComponentHealth:
        """Return the health after a report about a part."""
        reported = {**self._reported, part: (health, cause)}
        worst = max(reported.values(), key=lambda item: _BETTER_TO_WORSE.index(item[0]))
        if worst[0] is health:
            worst = health, cause
        return evolve(self, health=worst[0], cause=worst[1], reported=reported)

    def is_news(self, before: ComponentHealth, health: Health, cause: str) -> bool:
        """Say whether a report that led here from `before` is news of the whole component.

        It is none when a worse one elsewhere covers it up, or when all was well before.
        """
        if before.health is self.health is Health.OK:
            return False
        now = self.health, self.cause
        return now == (health, cause) or now != (before.health, before.cause)
