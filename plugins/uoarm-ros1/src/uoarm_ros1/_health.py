"""How well a master is, and what was lost: events in, reports out; no I/O."""

from __future__ import annotations

from collections.abc import Iterable

from attrs import define, field

from uoarm.model import Health

Report = tuple[Health, str]
Key = tuple[str, str, str]
"""A component, what is looked for (`publishers`, `subscribers` or `services`), and its name."""


class MasterHealth:
    """Whether the master answers. Messages need it not, so that it is never a loss."""

    def __init__(self) -> None:
        self._is_up: bool | None = None
        self._is_missed = False

    @property
    def is_up(self) -> bool:
        """Whether it answered last time."""
        return bool(self._is_up)

    def answered(self) -> Report | None:
        """It answered."""
        was_up, self._is_up = self._is_up, True
        self._is_missed = False
        return (Health.OK, "the ROS master answers again") if was_up is False else None

    def failed(self, cause: str, *, is_used: bool) -> Report | None:
        """It did not.

        Args:
            cause: why.
            is_used: whether it has taken a registration: it may have gone before the first look.
        """
        was_up, self._is_up = self._is_up, False
        # What was not relied upon yet is not broken: a step that needs it is refused.
        if self._is_missed or not (was_up or is_used):
            return None
        self._is_missed = True
        return Health.DEGRADED, cause


@define
class LostComponents:
    """Components that were lost or missed, and who stood for them at the master then.

    A node that was killed stays registered: only another address, or an answer, says that it is
    back.
    """

    _seen: dict[Key, frozenset[tuple[str, str]] | None] = field(factory=dict)
    _silent: set[Key] = field(factory=set)

    @property
    def keys(self) -> tuple[Key, ...]:
        """What is looked for."""
        return tuple(self._seen)

    def remember(self, key: Key, *, may_answer: bool = True) -> None:
        """A component is gone; the next look says who stands for it now.

        Args:
            key: component, kind and name.
            may_answer: whether an answer of who is registered still says that it is back.
        """
        self._seen.setdefault(key, None)
        if not may_answer:
            self._silent.add(key)

    def look(self, key: Key, registered: Iterable[tuple[str, str]], *, answers: bool) -> str:
        """Take note of who is registered; returns the component to report as back, or nothing.

        Args:
            key: component, kind and name.
            registered: names and addresses of nodes.
            answers: whether one of them has just answered.
        """
        if key not in self._seen:
            return ""
        before, now = self._seen[key], frozenset(registered)
        has_answered = answers and key not in self._silent
        if before is not None and now and (now - before or has_answered):
            self._forget(key)
            return key[0]
        self._seen[key] = now
        return ""

    def forget(self, component: str) -> None:
        """A component is in use again."""
        for key in [key for key in self._seen if key[0] == component]:
            self._forget(key)

    def _forget(self, key: Key) -> None:
        del self._seen[key]
        self._silent.discard(key)
