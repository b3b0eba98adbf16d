"""Encoded messages that wait between an OutPort of ours and their consumer."""

from __future__ import annotations

import threading
from collections import deque

from uoarm_rtm._buffering import BufferPolicy

__all__ = ["Buffer"]


class Buffer:
    """A queue with a policy for being full and for being empty. Used from any thread.

    Attributes:
        policy: what it goes by.
        dropped: messages that gave way to newer ones, or were not taken.
    """

    def __init__(self, policy: BufferPolicy) -> None:
        self.policy = policy
        self.dropped = 0
        self._waiting: deque[bytes] = deque()
        self._last: bytes | None = None
        self._closed = False
        self._busy = False
        self._changed = threading.Condition()

    def write(self, data: bytes) -> bool:
        """Keep one message; returns whether it was taken.

        With `block` waits up to `write_seconds` for room.
        """
        with self._changed:
            if self.policy.full == "block":
                self._changed.wait_for(self._has_room, self.policy.write_seconds)
            if self._closed:
                return False
            if not self._has_room():
                self.dropped += 1
                if self.policy.full != "overwrite":
                    return False
                self._waiting.popleft()
            self._waiting.append(data)
            self._changed.notify_all()
            return True

    def read(self) -> bytes | None:
        """Return the oldest message; on empty, what the policy says; None for nothing.

        With `block` waits up to `read_seconds` for one.
        """
        with self._changed:
            if self.policy.empty == "block":
                self._changed.wait_for(self._is_ready, self.policy.read_seconds)
            if self._waiting:
                self._last = self._waiting.popleft()
                self._changed.notify_all()
                return self._last
            return self._last if self.policy.empty == "readback" else None

    def take(self, most: int | None = None) -> list[bytes]:
        """Wait until something waits, and return all of it or the oldest; [] once closed.

        A consumer that calls again is done with what it took before.
        """
        with self._changed:
            self._busy = False
            self._changed.notify_all()
            self._changed.wait_for(self._is_ready)
            if self._closed:
                return []
            count = len(self._waiting) if most is None else most
            taken = [self._waiting.popleft() for _ in range(min(count, len(self._waiting)))]
            self._busy = True
            self._changed.notify_all()
            return taken

    def drain(self, seconds: float) -> bool:
        """Wait until nothing waits and the consumer is done; returns whether that came."""
        with self._changed:
            return self._changed.wait_for(lambda: not (self._waiting or self._busy), seconds)

    def close(self) -> None:
        """End every wait; what waits is not taken any more."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _has_room(self) -> bool:
        return self._closed or len(self._waiting) < self.policy.length

    def _is_ready(self) -> bool:
        return self._closed or bool(self._waiting)
