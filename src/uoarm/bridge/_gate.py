"""Gates: what keeps the contract's promises about `deliver`, whatever a bridge does."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Protocol, runtime_checkable

from uoarm.model import Deliver, Message

__all__ = ["Delivery", "Gate"]

_TURN_SECONDS = 0.05


@runtime_checkable
class Delivery(Protocol):
    """What the messages of an open source go to; of a latched one, with whose they are.

    May be called with the message alone. A source that is latched keeps the last messages of each
    writer for those who join later; a writer is who published a message, or the topic of one among
    several, by a name that no other has.
    """

    def __call__(self, message: Message, writer: str = "") -> None:
        """Take one message; never raises, and may take its time."""

    def let_go(self, writer: str = "") -> None:
        """Let nothing of a writer stand any more: it has gone, or its value was cleared."""


class Gate:
    """Hands messages to `deliver` one at a time, and none once it is shut.

    One stands before the `deliver` of every open source, since frameworks call back from several
    threads, and go on calling after they were told to stop.

    Attributes:
        refused: messages that came after it was shut.
        on_refused: told of each of them, in its thread.
    """

    __slots__ = ("_deliver", "_is_shut", "_keeping", "_turn", "on_refused", "refused")

    def __init__(self, deliver: Deliver | Delivery) -> None:
        self._deliver = deliver
        self._keeping = deliver if isinstance(deliver, Delivery) else None
        self._turn = threading.RLock()
        self._is_shut = False
        self.refused = 0
        self.on_refused: Callable[[], object] | None = None

    def __call__(self, message: Message, writer: str = "") -> None:
        """Deliver a message in this thread, after those of other threads that came before."""
        with self._turn:
            if not self._is_shut:
                if writer and self._keeping is not None:
                    self._keeping(message, writer)
                else:
                    self._deliver(message)
            else:
                self.refused += 1
                if self.on_refused is not None:
                    self.on_refused()

    def let_go(self, writer: str = "") -> None:
        """Let nothing of a writer stand any more, after what was delivered before."""
        with self._turn:
            if not self._is_shut and self._keeping is not None:
                self._keeping.let_go(writer)

    def shut(self) -> None:
        """Let nothing more begin.

        Waits for a delivery that has just begun, so that none begins after this has returned, but
        not for one that lasts: that one may be what asked for the close.
        """
        self._is_shut = True
        if self._turn.acquire(timeout=_TURN_SECONDS):
            self._turn.release()
