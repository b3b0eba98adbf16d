"""Gates: what keeps the contract's promises about `deliver`, whatever a bridge does."""

from __future__ import annotations

import threading
from collections.abc import Callable

from uoarm.model import Deliver, Message

__all__ = ["Gate"]

_TURN_SECONDS = 0.05


class Gate:
    """Hands messages to `deliver` one at a time, and none once it is shut.

    One stands before the `deliver` of every open source, since frameworks call back from several
    threads, and go on calling after they were told to stop.

    Attributes:
        refused: messages that came after it was shut.
        on_refused: told of each of them, in its thread.
    """

    __slots__ = ("_deliver", "_is_shut", "_turn", "on_refused", "refused")

    def __init__(self, deliver: Deliver) -> None:
        self._deliver = deliver
        self._turn = threading.RLock()
        self._is_shut = False
        self.refused = 0
        self.on_refused: Callable[[], object] | None = None

    def give(self, message: Message) -> None:
        """Deliver a message in this thread, after those of other threads that came before."""
        with self._turn:
            if not self._is_shut:
                self._deliver(message)
            else:
                self.refused += 1
                if self.on_refused is not None:
                    self.on_refused()

    def shut(self) -> None:
        """Let nothing more begin.

        Waits for a delivery that has just begun, so that none begins after this has returned, but
        not for one that lasts: that one may be what asked for the close.
        """
        self._is_shut = True
        if self._turn.acquire(timeout=_TURN_SECONDS):
            self._turn.release()
