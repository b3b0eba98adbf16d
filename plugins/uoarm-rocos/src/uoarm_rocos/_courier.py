"""Messages to their receivers in one thread, so that a receiver may call through the same line."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from typing import Any

__all__ = ["Courier"]

_MOST = 1024


class Courier:
    """A bounded queue and one thread; where it is full the oldest message is dropped.

    Args:
        name: for the thread's name.
        most: length of the queue.
    """

    def __init__(self, name: str, most: int = _MOST) -> None:
        self._waiting: deque[tuple[Parcel, Any]] = deque()
        self._most = most
        self._awake = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name=f"uoarm-{name}", daemon=True)
        self._thread.start()

    def put(self, parcel: Parcel, message: Any) -> None:
        """Take a message for a receiver; never blocks, any thread."""
        with self._awake:
            if len(self._waiting) >= self._most:
                self._waiting.popleft()[0].dropped += 1
            self._waiting.append((parcel, message))
            self._awake.notify()

    def close(self) -> None:
        """End; a delivery under way ends alone, no other begins."""
        with self._awake:
            self._closed = True
            self._waiting.clear()
            self._awake.notify()

    def _run(self) -> None:
        while True:
            with self._awake:
                while not self._waiting and not self._closed:
                    self._awake.wait()
                if self._closed:
                    return
                parcel, message = self._waiting.popleft()
            parcel.hand_over(message)


class Parcel:
    """One receiver; `dropped` counts what it missed because it was slower than its source."""

    def __init__(self, deliver: Callable[[Any], None]) -> None:
        self.dropped = 0
        self._deliver = deliver
        self._closed = False

    def hand_over(self, message: Any) -> None:
        """Deliver a message unless the receiver is closed."""
        if not self._closed:
            self._deliver(message)

    def close(self) -> None:
        """Begin no other delivery."""
        self._closed = True
