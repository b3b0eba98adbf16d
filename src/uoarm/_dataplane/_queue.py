"""A queue bounded in items and octets, with an overflow policy, which counts what it loses."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from queue import Empty
from typing import Any, Generic, TypeVar

from uoarm.model import OverflowPolicy, QueuePolicy, message_octets

__all__ = ["BoundedQueue", "QueueClosed"]

T = TypeVar("T")


class QueueClosed(Exception):  # noqa: N818 - a signal to the reader, not a fault
    """The queue is closed and everything in it was taken."""


class BoundedQueue(Generic[T]):
    """Items from any thread to any thread, in order.

    An item of any size passes when it is alone; so one is measured only when another comes while it
    waits, and a queue whose reader keeps up costs no measuring.

    Args:
        policy: length, octets and overflow policy.
        on_drop: called with the reason for each item that is lost; must not block.
        measure: returns the octets of memory that an item holds.
    """

    def __init__(
        self,
        policy: QueuePolicy,
        on_drop: Callable[[str], None],
        measure: Callable[[Any], int] = message_octets,
    ) -> None:
        self._policy = policy.policy
        self._length = 1 if policy.policy is OverflowPolicy.LATEST else policy.length
        self._most_octets = policy.octets
        self._timeout = policy.timeout
        self._on_drop = on_drop
        self._measure = measure
        self._items: deque[T] = deque()
        self._sizes: deque[int] = deque()  # of all items; of the oldest it may be missing
        self._octets = 0
        self._unfinished = 0
        self._closed = False
        self._lock = threading.Lock()
        self._changed = threading.Condition(self._lock)
        self._waiting = 0

    def __len__(self) -> int:
        return len(self._items)

    @property
    def octets(self) -> int:
        """Octets of memory that the items hold."""
        with self._lock:
            self._measure_oldest()
            return self._octets

    def put(self, item: T) -> None:
        """Add an item. Waits only under the `block` policy, up to its timeout."""
        with self._lock:
            size = self._measure(item) if self._items and self._length > 1 else 0
            if not self._has_room(size) and not self._closed:
                self._make_room(size)
            if self._closed:
                self._on_drop("closed")
                return
            if not self._has_room(size):
                self._on_drop("blocked-too-long")
                return
            if self._items:
                self._sizes.append(size)
                self._octets += size
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
            item = self._pop()
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
                self._sizes.clear()
                self._octets = 0
            self._changed.notify_all()

    def _pop(self) -> T:
        if len(self._sizes) == len(self._items):
            self._octets -= self._sizes.popleft()
        return self._items.popleft()

    def _measure_oldest(self) -> None:
        if len(self._sizes) < len(self._items):
            self._sizes.appendleft(self._measure(self._items[0]))
            self._octets += self._sizes[0]

    def _has_room(self, size: int) -> bool:
        """Say whether another item of a size may be added."""
        if not self._items:
            return True
        if len(self._items) >= self._length:
            return False
        self._measure_oldest()
        return self._octets + size <= self._most_octets

    def _make_room(self, size: int) -> None:
        if self._policy is OverflowPolicy.BLOCK:
            self._wait_for(lambda: self._has_room(size) or self._closed, self._timeout)
            return
        while not self._has_room(size):
            full = len(self._items) >= self._length
            self._pop()
            self._unfinished -= 1
            if self._policy is OverflowPolicy.LATEST:
                self._on_drop("replaced")
            else:
                self._on_drop("queue-full" if full else "queue-octets")

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
