"""What a framework's thread brought and a thread of the channel takes: bounded, and counted."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

__all__ = ["ReceiveQueue"]

T = TypeVar("T")


class ReceiveQueue(Generic[T]):
    """What came and was not taken yet, and the one thread that takes it.

    The thread of the framework only appends, so that a receiver that is stuck holds up no other
    one. When it is full, the oldest are dropped and counted. The thread ends when it is closed, or
    with the `take` under way.

    Args:
        name: of the thread.
        take: takes one thing; raises nothing.
        most: how many may wait.
        most_size: sum of the sizes of what waits; None: any. The newest is always kept.
        size: of a thing.
        dropped: is called with each that is dropped, in the thread that puts; returns at once.
        wake: is called after each thing, and when the time has come that it returned; returns when
            it is to be called again, in seconds of `time.monotonic`, or None for never.

    Attributes:
        dropped: how many were.
    """

    def __init__(
        self,
        name: str,
        take: Callable[[T], object],
        most: int,
        *,
        most_size: int | None = None,
        size: Callable[[T], int] = lambda _: 0,
        dropped: Callable[[T], object] = lambda _: None,
        wake: Callable[[], float | None] = lambda: None,
    ) -> None:
        self._take, self._wake, self._when_dropped = take, wake, dropped
        self._most, self._most_size, self._size = most, most_size, size
        self._waiting: deque[T] = deque()
        self._waiting_size = 0
        # Guards what waits, its size and the two marks: the framework's thread appends, the queue's
        # own takes, and any thread may close. It is not held during `take` and `wake`.
        self._changed = threading.Condition()
        self._is_closed = self._poked = False
        self.dropped = 0
        threading.Thread(target=self._run, name=name, daemon=True).start()

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def closed(self) -> bool:
        """Whether nothing more is taken."""
        return self._is_closed

    def put(self, thing: T) -> None:
        """Append a thing; returns at once."""
        with self._changed:
            if self._is_closed:
                return
            self._waiting.append(thing)
            self._waiting_size += self._size(thing)
            while len(self._waiting) > 1 and self._is_full():
                oldest = self._waiting.popleft()
                self._waiting_size -= self._size(oldest)
                self.dropped += 1
                self._when_dropped(oldest)
            self._changed.notify()

    def poke(self) -> None:
        """Have `wake` called: what it returned does not hold any more."""
        with self._changed:
            self._poked = True
            self._changed.notify()

    def close(self) -> None:
        """Take nothing more; does not wait for what is being taken."""
        with self._changed:
            self._is_closed = True
            self._waiting.clear()
            self._changed.notify()

    def _is_full(self) -> bool:
        is_large = self._most_size is not None and self._waiting_size > self._most_size
        return len(self._waiting) > self._most or is_large

    def _run(self) -> None:
        while not self.closed:
            due = self._wake()
            with self._changed:
                left = None if due is None else max(0.0, due - time.monotonic())
                self._changed.wait_for(
                    lambda: self._is_closed or self._waiting or self._poked, left
                )
                self._poked = False
                if self._is_closed or not self._waiting:
                    continue
                thing = self._waiting.popleft()
                self._waiting_size -= self._size(thing)
            self._take(thing)
