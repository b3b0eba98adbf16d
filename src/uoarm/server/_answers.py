"""Answers that a client may not have heard, for when it comes back after a drop."""

from __future__ import annotations

from collections import OrderedDict

from uoarm.server._memory import Account, Held

__all__ = ["Answers"]


class Answers:
    """The last answers of one session by id, and what is under way; all in the loop's thread.

    Args:
        most: answers that are kept.
        most_bytes: bytes that they may have together; fewer where the client's account is full.
        account: the client's.
    """

    def __init__(self, most: int, most_bytes: int, account: Account) -> None:
        self._most = most
        self._most_bytes = most_bytes
        self._account = account
        self._held = account.hold(Held.ANSWERS)
        self._under_way: set[str] = set()
        self._frames: OrderedDict[str, bytes] = OrderedDict()
        self._bytes = 0

    def begin(self, identity: str) -> None:
        """Note a message that will be answered."""
        self._under_way.add(identity)

    def add(self, identity: str, frame: bytes) -> None:
        """Keep an answer, at the cost of the oldest."""
        self._under_way.discard(identity)
        self._bytes += len(frame) - len(self._frames.pop(identity, b""))
        self._frames[identity] = frame
        self._held.resize(self._bytes)
        while self._frames and (
            len(self._frames) > self._most
            or self._bytes > self._most_bytes
            or not self._account.has_room(0)
        ):
            self._bytes -= len(self._frames.popitem(last=False)[1])
            self._held.resize(self._bytes)

    def is_under_way(self, identity: str) -> bool:
        """Say whether an answer is still to come."""
        return identity in self._under_way

    def get(self, identity: str) -> bytes | None:
        """Return an answer that is kept."""
        return self._frames.get(identity)
