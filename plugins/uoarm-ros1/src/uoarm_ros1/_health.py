"""How well a channel, a master and what was lost are: events and times in, reports out; no I/O."""

from __future__ import annotations

from collections.abc import Iterable

from attrs import define, field

from uoarm.model import Health

__all__ = ["ChannelHealth", "Lost", "MasterHealth"]

Report = tuple[Health, str]
Key = tuple[str, str, str]
"""A component, what is looked for (`publishers`, `subscribers` or `services`), and its name."""


class ChannelHealth:
    """One end of a topic. What is lost stays lost: the manager opens it anew.

    Args:
        what: the peers are, such as `publisher of /image`.
        required: whether a channel without a peer is lost.
        stale_after: seconds without a message after which it is lost; None: never.
        now: seconds of the clock by which messages are waited for.
    """

    def __init__(
        self, what: str, *, required: bool, stale_after: float | None = None, now: float = 0.0
    ) -> None:
        self._what, self._required, self._stale_after = what, required, stale_after
        self._peers = 0
        self._last = now
        self._trouble = ""
        self.is_lost = self.is_silent = False

    def connected(self, peers: int, cause: str) -> Report | None:
        """So many peers are connected now; `cause`: why it has changed."""
        before, self._peers = self._peers, peers
        if before and not peers and self._required:
            return self._lose(f"{self._what}: {cause}")
        return self._over("one is connected") if peers > before else None

    def refused(self, cause: str) -> Report | None:
        """A peer could not be connected, or refused what it was sent."""
        if self.is_lost or self._trouble:
            return None
        self._trouble = cause
        return Health.DEGRADED, cause

    @property
    def is_waiting(self) -> bool:
        """Whether a message that comes changes anything: it ends a trouble, or a silence."""
        return bool(self._trouble) or self._stale_after is not None

    def took(self, now: float) -> Report | None:
        """A message came that could be read."""
        self._last = now
        return self._over("a message came") if self._trouble else None

    def tick(self, now: float) -> Report | None:
        """Time has passed."""
        self._last = min(self._last, now)  # simulated time goes back where it begins anew
        if self._stale_after is None or now - self._last <= self._stale_after:
            return None
        self.is_silent = True
        return self._lose(f"{self._what}: no message for {self._stale_after:g} s")

    def _over(self, why: str) -> Report | None:
        if not self._trouble or self.is_lost:
            return None
        self._trouble = ""
        return Health.OK, why

    def _lose(self, cause: str) -> Report | None:
        if self.is_lost:
            return None
        self.is_lost = True
        return Health.LOST, cause


class MasterHealth:
    """Whether the master answers. Messages need it not, so that it is never a loss."""

    def __init__(self) -> None:
        self._is_up: bool | None = None

    @property
    def is_up(self) -> bool:
        """Whether it answered last time."""
        return bool(self._is_up)

    def answered(self) -> Report | None:
        """It answered."""
        was_up, self._is_up = self._is_up, True
        return (Health.OK, "the ROS master answers again") if was_up is False else None

    def failed(self, cause: str) -> Report | None:
        """It did not."""
        was_up, self._is_up = self._is_up, False
        # What was not relied upon yet is not broken: a step that needs it is refused.
        return (Health.DEGRADED, cause) if was_up else None


@define
class Lost:
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
