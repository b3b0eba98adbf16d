"""A bounded queue with a declared overflow policy, which counts what it loses."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from queue import Empty
from typing import Generic, TypeVar

from uoarm.model import OverflowPolicy, QueuePolicy

__all__ = ["BoundedQueue", "QueueClosed"]

T = TypeVar("T")


class QueueClosed(Exception):  # noqa: N818 - a signal to the reader, not a fault
    """The queue is closed and everything in it was taken."""


class BoundedQueue(Generic[T]):
    """Items from any thread to any thread, in order.

    Args:
        policy: length and overflow policy.
        on_drop: called with the reason for each item that is lost; must not block.
    """

    def __init__(self, policy: QueuePolicy, on_drop: Callable[[str], None]) -> None:
        self._policy = policy.policy
        self._length = 1 if policy.policy is OverflowPolicy.LATEST else policy.length
        self._timeout = policy.timeout
        self._on_drop = on_drop
        self._items: deque[T] = deque()
        self._unfinished = 0
        self._closed = False
        self._lock = threading.Lock()
        self._changed = threading.Condition(self._lock)
        self._waiting = 0

    def __len__(self) -> int:
        return len(self._items)

    def put(self, item: T) -> None:
        """Add an item. Waits only under the `block` policy, up to its timeout."""
        with self._lock:
            if len(self._items) >= self._length and not self._closed:
                self._make_room()
            if self._closed:
                self._on_drop("closed")
                return
            if len(self._items) >= self._length:
                self._on_drop("blocked-too-long")
                return
            self._items.append(item)
            self._unfinished += 1
            if self._waiting:
                self._changed.notify_all()

    def get(self, timeout: float | None = None) -> T:
        """Take the oldest item, waiting `timeout` seconds at most (None: for ever).

        Raises:
            queue.Empty: nothing came in time.
            QueueClosed: the queue is closed and empty.
        """
        with self._lock:
            if not self._items and not self._closed:
                self._wait_for(lambda: bool(self._items) or self._closed, timeout)
            if not self._items:
                raise QueueClosed if self._closed else Empty
            item = self._items.popleft()
            if self._waiting:
                self._changed.notify_all()
            return item

    def done(self) -> None:
        """Say that an item taken with `get` was dealt with; `drain` waits for that."""
        with self._lock:
            self._unfinished -= 1
            if self._waiting:
                self._changed.notify_all()

    def drain(self, timeout: float) -> bool:
        """Wait until every item was dealt with or the queue closed; False when time ran out."""
        with self._lock:
            return self._wait_for(lambda: not self._unfinished or self._closed, timeout)

    def close(self, *, discard: bool) -> None:
        """Take no more items. What is inside is lost and counted if `discard`, else readable."""
        with self._lock:
            self._closed = True
            if discard:
                for _ in range(len(self._items)):
                    self._on_drop("closed")
                self._items.clear()
            self._changed.notify_all()

    def _make_room(self) -> None:
        if self._policy is OverflowPolicy.BLOCK:
            self._wait_for(lambda: len(self._items) < self._length or self._closed, self._timeout)
            return
        self._items.popleft()
        self._unfinished -= 1
        self._on_drop("replaced" if self._policy is OverflowPolicy.LATEST else "queue-full")

    def _wait_for(self, ready: Callable[[], bool], timeout: float | None) -> bool:
        deadline = None if timeout is None else time.monotonic() + timeout
        self._waiting += 1
        try:
            while not ready():
                left = None if deadline is None else deadline - time.monotonic()
                if left is not None and left <= 0:
                    return False
                self._changed.wait(left)
            return True
        finally:
            self._waiting -= 1
