"""What a transport between a manager and a host does, whatever carries it.

Every request gets an answer or an error, also when the answering function raises. Foreign
exceptions end here.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any

from uoarm._host.transport.codec import Frame, from_failure, pack, to_failure, unpack
from uoarm._raised import foreign
from uoarm._support.workers import WorkerPool
from uoarm.bridge import boot_seconds
from uoarm.errors import BridgeError, FailureReason, MessageError

ANSWER_SECONDS = 120.0
"""A request that nothing else limits is given up after this time."""

Reply = Callable[[Any], None]
"""Takes the value to answer with, or the exception to answer with; from any thread, once."""
_AT_ONCE = 64


class LinkLostError(BridgeError):
    """The other end is gone, or the link to it. What it answers itself is never this error."""

    def __init__(self, text: str) -> None:
        super().__init__(text, FailureReason.UNAVAILABLE)
        self.error_code = "UOA-411"


class Transport(ABC):
    """One end of a transport. All methods may be called from any thread.

    Attributes:
        ahead: by how many nanoseconds the clock at the other end is ahead of this one.
        clock: the clock by which both ends say when a message was sent, nanoseconds. One that
            which is never set where both are on one machine; else that of the calendar.
    """

    def __init__(self) -> None:
        self.ahead: Callable[[], int] = lambda: 0
        self.clock: Callable[[], int] = lambda: int(boot_seconds() * 1e9)

    @abstractmethod
    def ask(self, key: str, request: Any, *, timeout: float = ANSWER_SECONDS) -> Any:
        """Send a request and return the answer; waits `timeout` seconds at most.

        Raises:
            UoarmError: what the other end answered with.
            LinkLostError: there is no other end.
            BridgeTimeoutError: no answer in time.
        """

    @abstractmethod
    def ask_later(self, key: str, take: Callable[[Any], None], *, timeout: float) -> None:
        """Send a bare request, and have the answer handed to `take` in the transport's thread.

        An error, or no answer within `timeout` seconds, is not reported. `take` must not block.

        Raises:
            LinkLostError: the link is closed.
        """

    @abstractmethod
    def answer(self, key: str, take: Callable[[Any, Reply], None]) -> Callable[[], None]:
        """Have requests at a key handed to `take`, in the transport's thread; returns what ends it.

        `take` must not block: it answers at once, or hands the reply to another thread.
        """

    @abstractmethod
    def publish(
        self, key: str, payload: bytes, header: bytes, *, must_arrive: bool = False
    ) -> None:
        """Send one frame. When the link is full for 0.2 s, the frame is dropped.

        With `must_arrive` it waits longer, and a link that stays full for 5 s is an error.

        Raises:
            LinkLostError: the link is closed.
        """

    @abstractmethod
    def subscribe(
        self, key: str, length: int, take: Callable[[Frame, bytes], object], name: str
    ) -> Callable[[], None]:
        """Have payload and header of each frame at a key handed to `take`; returns what ends it.

        One frame after the other, in order, in a thread of the transport's, which has this name if
        it serves no other subscription. `take` may block: no other subscription waits long for
        it. At most `length` frames wait; the oldest are lost first. After the end no `take`
        begins; one under way finishes alone. It must not raise.
        """

    @abstractmethod
    def notify(self, key: str, header: bytes) -> None:
        """Send a header to who listens at a key.

        Raises:
            LinkLostError: the link is closed.
            BridgeTimeoutError: the link has been full for 5 s.
        """

    @abstractmethod
    def listen(self, key: str, take: Callable[[bytes], None]) -> Callable[[], None]:
        """Have headers that are sent to a key handed to `take`, in the transport's thread.

        `take` must not block.
        """

    @abstractmethod
    def show_alive(self, key: str) -> None:
        """Declare a token that goes when this end dies."""

    @abstractmethod
    def watch_alive(self, key: str, seen: Callable[[bool], None]) -> None:
        """Have the coming and going of a token reported; `seen` must not block."""

    @abstractmethod
    def close(self) -> None:
        """End everything of this end. Idempotent."""


def answer_to(take: Callable[[Any, Reply], None], request: Frame | None, reply: Reply) -> None:
    """Have a request answered; what taking it raises is the answer."""
    try:
        foreign(take, None if request is None else unpack(request), reply)
    except Exception as error:  # noqa: BLE001 - an unanswered request looks like a death
        reply(error)


def answer_of(value: Any) -> bytes:
    """Return the frame that answers with a value or an exception."""
    failed = isinstance(value, BaseException)
    try:
        return pack((failed, to_failure(value) if failed else value))
    except MessageError as error:
        return pack((True, to_failure(error)))


def read_answer(frame: Frame, key: str) -> Any:
    """Return what the other end answered at a key, or raise what it answered with."""
    report = unpack(frame)
    match report:
        case [bool(failed), value]:
            if not failed:
                return value
            if isinstance(value, Mapping):
                raise from_failure(value)
    text = f"asking {key}: the answer is none of this link: {str(report)[:40]}"
    raise BridgeError(text, FailureReason.CONTRACT)


class RequestWorkers:
    """Answers at most 64 requests at a time; more are refused at once."""

    def __init__(self, name: str) -> None:
        self._pool = WorkerPool(name, _AT_ONCE)

    def answer(self, reply: Reply, action: Callable[[], Any]) -> None:
        """Reply with what the action returns or raises; returns at once.

        Raises:
            BridgeError: every thread is busy, or it is closed.
        """

        def done(answer: object, error: BaseException | None) -> None:
            reply(answer if error is None else error)

        if not self._pool.submit(action, done=done, queue=False):
            if self._pool.closed:
                raise BridgeError("requests are not answered any more", FailureReason.CLOSED)
            text = f"{_AT_ONCE} requests are being answered already"
            raise BridgeError(text, FailureReason.UNAVAILABLE)

    def close(self) -> None:
        """Take no more; what is under way is answered still."""
        self._pool.close()
