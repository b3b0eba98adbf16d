"""One key's frames on their way to whoever takes them, in order and one at a time.

A frame is taken in the thread that read it, since to wake another thread costs as much as most
consumers need. Whoever takes its time gets a thread of its own.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue

from uoarm._host.transport.codec import Frame
from uoarm._raised import foreign

__all__ = ["FlowSubscription", "Take"]

Take = Callable[[Frame, bytes], object]
"""Takes the payload and the header of one frame."""

_QUICK_SECONDS = 0.001
_SHORT_OCTETS = 2**16  # as much more takes long to decode
_CREDIT = 150
_COST = 50  # of one that was not quick: three in a row, or more than two in a hundred, are too many
_RETURN = 100
_log = logging.getLogger("uoarm")


class FlowSubscription:
    """Frames of one key, each handed to `take` after the one before.

    `begin` and `run_here` are for the thread that reads, and `hand_over` for who takes its place.

    Args:
        take: may block; what it raises is logged.
        length: how many frames may wait; the oldest are lost first.
        name: for its thread.
    """

    def __init__(self, take: Take, length: int, name: str) -> None:
        self._consume = take
        self._length = length
        self._name = name
        self._waiting: SimpleQueue[tuple[Frame, bytes] | None] = SimpleQueue()
        self._lock = threading.Lock()
        self._has_thread = False
        self._ended = False
        self._credit = _CREDIT

    def begin(self, payload: Frame, header: bytes) -> bool:
        """Say whether the thread that read a frame is to take it; else it waits for another."""
        with self._lock:
            if self._ended:
                return False
            if not self._has_thread:
                if self._credit > 0 and len(payload) <= _SHORT_OCTETS:
                    return True
                try:
                    threading.Thread(target=self.run_here, name=self._name, daemon=True).start()
                except RuntimeError:  # there are too many
                    return True
                self._has_thread = True
            if self._waiting.qsize() >= self._length:
                with suppress(Empty):
                    self._waiting.get_nowait()
            self._waiting.put((payload, header))
        return False

    def take(self, payload: Frame, header: bytes) -> None:
        """Have one frame taken, by the thread whose turn it is, and learn how long that takes."""
        begun = time.monotonic()
        try:
            foreign(self._consume, payload, header)
        except Exception:  # noqa: BLE001 - the thread must go on
            _log.exception("what came over the link could not be taken")
        if len(payload) <= _SHORT_OCTETS and time.monotonic() - begun < _QUICK_SECONDS:
            self._credit = min(_CREDIT, self._credit + 1)
        else:
            self._credit = max(0, self._credit - _COST)

    def hand_over(self) -> None:
        """Have all that comes from now on wait for the thread that takes a frame now."""
        with self._lock:
            self._has_thread = True
            self._credit = 0

    def run_here(self) -> None:
        """Take what waits, in this thread, until the end, or until all is taken quickly again."""
        while (frame := self._waiting.get()) is not None and not self._ended:
            self.take(*frame)
            if self._credit >= _RETURN and self._return():
                return

    def end(self) -> None:
        """Begin no other `take`; one under way finishes alone. Idempotent."""
        with self._lock:
            self._ended = True
            self._waiting.put(None)

    def _return(self) -> bool:
        """Give the taking back to the thread that reads, unless more waits."""
        with self._lock:
            if not self._waiting.empty():
                return False
            self._has_thread = False
            return True
