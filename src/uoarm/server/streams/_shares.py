"""What all clients of a server share, divided among those who take of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable
from contextvars import ContextVar
from typing import final

__all__ = ["Shares", "acting"]

acting: ContextVar[Hashable] = ContextVar("acting", default=None)
"""For which client the loop works: its account. Tasks that are made then go on for the same one."""


@final
class Shares:
    """Counts what is taken, by owner; a plain state without a lock, for the loop's thread.

    No owner who has less than an equal share is refused because of others, as with `Memory`: so at
    most twice `most` is taken.

    Args:
        most: of all owners together.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._taken: Counter[Hashable] = Counter()

    @property
    def total(self) -> int:
        """What is taken in all."""
        return self._taken.total()

    def of(self, owner: Hashable) -> int:
        """Return what an owner has."""
        return self._taken[owner]

    def admits(self, owner: Hashable, count: int = 1) -> bool:
        """Say whether an owner may take so much more."""
        if self.total + count <= self._most:
            return True
        owners = len(self._taken) + (owner not in self._taken)
        return self._taken[owner] + count <= self._most // owners

    def take(self, owner: Hashable, count: int = 1) -> None:
        """Count what an owner takes; see `admits`. A negative count gives back."""
        self._taken[owner] += count
        if not self._taken[owner]:
            del self._taken[owner]
