"""Deliveries: what keeps the contract's promises about `deliver` for bridges that need help."""

from __future__ import annotations

import threading

from uoarm.model import Deliver, Message

__all__ = ["Delivery"]

_DRAIN_SECONDS = 0.05


class Delivery:
    """Hands messages to `deliver` one at a time, and none once it has ended.

    For bridges whose framework calls back from several threads, or goes on calling after it
    was told to stop.
    """

    def __init__(self, deliver: Deliver) -> None:
        self._deliver = deliver
        self._turn = threading.RLock()
        self._ended = False

    @property
    def ended(self) -> bool:
        """Whether `end` was called."""
        return self._ended

    def give(self, message: Message) -> None:
        """Deliver a message in this thread, after those of other threads that came before."""
        with self._turn:
            if not self._ended:
                self._deliver(message)

    def end(self) -> None:
        """Let nothing more begin; for the `_close` of a channel.

        Waits for a delivery that has just begun, but not for one that lasts: that one may be
        what asked for the close.
        """
        self._ended = True
        if self._turn.acquire(timeout=_DRAIN_SECONDS):
            self._turn.release()
