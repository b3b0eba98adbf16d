"""A thread that takes one thing after the other, and wakes when it is time."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

__all__ = ["Inbox"]

T = TypeVar("T")


class Inbox(Generic[T]):
    """Hands what is put into it to `take`, in a thread of its own; putting returns at once.

    When it is full, the oldest is dropped and counted. The thread ends when it is closed, or with
    the `take` under way.

    Args:
        name: of the thread.
        take: takes one thing.
        most: how many may wait.
        wake: is called after each thing, and when the time has come that it returned; returns
            when it is to be called again, in seconds of `time.monotonic`, or None for never.
    """

    def __init__(
        self,
        name: str,
        take: Callable[[T], object],
        most: int,
        wake: Callable[[], float | None] = lambda: None,
    ) -> None:
        self._take, self._most, self._wake = take, most, wake
        self._waiting: deque[T] = deque()
        self._changed = threading.Condition()
        self._closed = self._poked = False
        self.dropped = 0
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, thing: T) -> None:
        """Append a thing; returns at once."""
        with self._changed:
            if self._closed:
                return
            self._waiting.append(thing)
            if len(self._waiting) > self._most:
                self._waiting.popleft()
                self.dropped += 1
            self._changed.notify()

    def poke(self) -> None:
        """Have `wake` called: what it returned does not hold any more."""
        with self._changed:
            self._poked = True
            self._changed.notify()

    def close(self) -> None:
        """Take nothing more; does not wait for what is being taken."""
        with self._changed:
            self._closed = True
            self._waiting.clear()
            self._changed.notify()

    def _run(self) -> None:
        while not self._closed:
            due = self._wake()
            with self._changed:
                left = None if due is None else max(0.0, due - time.monotonic())
                self._changed.wait_for(lambda: self._closed or self._waiting or self._poked, left)
                self._poked = False
                things = [self._waiting.popleft()] if self._waiting else []
            for thing in things:
                self._take(thing)
