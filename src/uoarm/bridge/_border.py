"""The border to a bridge: what it raises becomes ours, what it delivers comes one at a time."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any, Protocol, runtime_checkable

from uoarm._raised import ContainedError, contained, from_own_frames, text_of
from uoarm._support.deadlines import BoundedStep
from uoarm.errors import BridgeError, FailureReason, UoarmError
from uoarm.model import Deliver, Endpoint, Message

UNSAID = "it cannot be read"
"""Why a message cannot be read of which a bridge does not say why."""
_TURN_SECONDS = 0.05
_WHY_LENGTH = 1000


class translated:  # noqa: N801 - read as a block's beginning, as those of contextlib are
    """Turns whatever a bridge raises into a BridgeError with the step's name, cause kept.

    Errors of uoarm pass as they are, and what interrupts the main thread for the user. A class,
    since each opening enters one, and a generator takes twice as long.
    """

    __slots__ = ("_step",)

    def __init__(self, step: str | BoundedStep) -> None:
        self._step = step

    def __enter__(self) -> None:
        pass

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: object
    ) -> None:
        if error is None:
            return
        raised = contained(error)
        if isinstance(raised, ContainedError) or not isinstance(raised, UoarmError):
            text = f"{self._step} failed: {text_of(raised)}"
            raise BridgeError(text, FailureReason.RAISED) from from_own_frames(error)


@contextmanager
def reading_endpoint(endpoint: Endpoint) -> Iterator[None]:
    """Read an endpoint's address or options: a ValueError becomes a BridgeError that names it.

    Raises:
        BridgeError: with BAD_ENDPOINT, the endpoint, and the sentence of the ValueError.
    """
    try:
        yield
    except ValueError as error:
        text = f"bridge {endpoint.bridge!r}: {endpoint}: {error}"
        raise BridgeError(text, FailureReason.BAD_ENDPOINT) from None


@runtime_checkable
class Delivery(Protocol):
    """What the messages of an open source go to, and what it says of them.

    May be called with the message alone. What came and is no message is said with `unreadable`:
    it is counted, and the component is degraded, and lost when nothing else comes.

    A source that is latched keeps the last messages of each writer for those who join later; a
    writer is who published a message, or the topic of one among several, by a name that no other
    has.
    """

    def __call__(self, message: Message, writer: str = "") -> None:
        """Take one message; never raises, and may take its time."""

    def let_go(self, writer: str = "") -> None:
        """Let nothing of a writer stand any more: it has gone, or its value was cleared."""

    def unreadable(self, why: str | Exception) -> None:
        """Take in that a message came which cannot be read, and why; never raises."""

    def readable(self) -> None:
        """Take in that something could be read of which no message comes; never raises.

        Only for a source that makes messages of some of what it reads: else each message says so.
        """


@lru_cache(maxsize=64)  # there are few, and to ask a protocol costs ten times as much as to open
def _is_delivery(kind: type) -> bool:
    return issubclass(kind, Delivery)


class Gate:
    """Hands messages to `deliver` one at a time, and none once it is shut.

    One stands before the `deliver` of every open source, since frameworks call back from several
    threads, and go on calling after they were asked to stop.

    Attributes:
        refused: messages that came after it was shut.
        unread: messages that could not be read.
        refusal: why the last one could not be read; empty where one was read since.
        on_refused: called for each of them, in its thread.
    """

    __slots__ = (
        "_deliver",
        "_delivery",
        "_is_shut",
        "_turn",
        "on_refused",
        "refusal",
        "refused",
        "unread",
    )

    def __init__(self, deliver: Deliver | Delivery) -> None:
        self._deliver = deliver
        kind: type = type(deliver)
        self._delivery: Any = deliver if _is_delivery(kind) else None
        self._turn = threading.RLock()
        self._is_shut = False
        self.refused = 0
        self.unread = 0
        self.refusal = ""
        self.on_refused: Callable[[], object] | None = None

    def __call__(self, message: Message, writer: str = "") -> None:
        """Deliver a message in this thread, after those of other threads that came before."""
        with self._turn:
            if not self._is_shut:
                if self.refusal:
                    self.refusal = ""
                if writer and self._delivery is not None:
                    self._delivery(message, writer)
                else:
                    self._deliver(message)
            else:
                self.refused += 1
                if self.on_refused is not None:
                    self.on_refused()

    def let_go(self, writer: str = "") -> None:
        """Let nothing of a writer stand any more, after what was delivered before."""
        with self._turn:
            if not self._is_shut and self._delivery is not None:
                self._delivery.let_go(writer)

    def unreadable(self, why: str | Exception) -> None:
        """Say that a message cannot be read, after what was delivered before."""
        said = why if isinstance(why, str) else text_of(why)
        with self._turn:
            if not self._is_shut:
                self.unread += 1
                self.refusal = said[:_WHY_LENGTH] or UNSAID
                if self._delivery is not None:
                    self._delivery.unreadable(self.refusal)

    def readable(self) -> None:
        """Say that something could be read; before the first that could not, nothing follows."""
        if self.unread:
            with self._turn:
                self.refusal = ""
                if not self._is_shut and self._delivery is not None:
                    self._delivery.readable()

    def shut(self) -> None:
        """Let nothing more begin.

        Waits for a delivery that has just begun, so that none begins after this has returned, but
        not for one that lasts: that one may be what asked for the close.
        """
        self._is_shut = True
        if self._turn.acquire(timeout=_TURN_SECONDS):
            self._turn.release()
