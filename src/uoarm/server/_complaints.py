"""What a client hears of messages that could not be written to it: each reason once."""

from __future__ import annotations

from collections.abc import Callable

from uoarm.errors import MessageError
from uoarm.server._outbox import Lane

__all__ = ["Complaints"]


class Complaints:
    """Counts lost messages of one stream; tells a reason again only after another one.

    Args:
        tell: hears the error.
    """

    def __init__(self, tell: Callable[[MessageError], None]) -> None:
        self._tell = tell
        self._told = ""

    def add(self, lane: Lane, error: MessageError) -> None:
        """Count one message that has no form."""
        lane.dropped += 1
        if str(error) != self._told:
            self._told = str(error)
            self._tell(error)
