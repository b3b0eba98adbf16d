"""Inboxes: where an application receives the messages of its connection."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from queue import Empty

from uoarm._dataplane._queue import BoundedQueue, QueueClosed
from uoarm._raised import LimitedLog, foreign, text_of
from uoarm.errors import UsageError
from uoarm.model import Deliver, Message, QueuePolicy

__all__ = ["Inbox"]

_log = logging.getLogger("uoarm")


class Inbox:
    """Messages for one reader: a queue to take from, or callbacks once there is one.

    Args:
        policy: what to do when the application is slower than the messages.
        on_drop: counts each lost message by reason.
        on_raised: told what a callback raised.
    """

    def __init__(
        self,
        policy: QueuePolicy,
        on_drop: Callable[[str], None],
        on_raised: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._queue: BoundedQueue[Message] = BoundedQueue(policy, on_drop)
        self._on_drop = on_drop
        self._on_raised = on_raised
        self._callbacks: tuple[Deliver, ...] = ()
        self._wake: Callable[[], None] | None = None
        self._lock = threading.RLock()
        self._records = LimitedLog(_log)

    def put(self, message: Message) -> None:
        """Take one message from the route, in the route's thread."""
        if self._callbacks and self._tell(message):
            return
        self._queue.put(message)
        if self._callbacks:  # the first one came meanwhile, and may have missed this
            self._tell_waiting()
        wake = self._wake
        if wake is not None:
            wake()

    def get(self, timeout: float | None = None) -> Message:
        """Take the oldest message.

        Raises:
            TimeoutError: nothing came within `timeout` seconds.
            QueueClosed: there will be no more.
            UsageError: callbacks receive the messages.
        """
        if self._callbacks:
            raise UsageError("callbacks receive the messages of this connection")
        try:
            return self._queue.get(timeout)
        except Empty:
            raise TimeoutError(f"no message within {timeout:g} s") from None

    def subscribe(self, callback: Deliver) -> Callable[[], None]:
        """Give every message to a callback from now on, first what is waiting already.

        Callbacks run in the thread in which the message arrives; one that raises is logged and
        stays, and the message counts as lost. Returns a function that ends the subscription.
        """
        with self._lock:
            self._callbacks = (*self._callbacks, callback)
            self._tell_waiting()

        def end() -> None:
            with self._lock:
                self._callbacks = tuple(c for c in self._callbacks if c is not callback)

        return end

    def on_wake(self, wake: Callable[[], None] | None) -> None:
        """Have `wake` called after each message that was queued and when the inbox closes."""
        self._wake = wake

    def close(self, *, discard: bool = False) -> None:
        """Take no more; what waits can still be read unless `discard`."""
        self._queue.close(discard=discard)
        wake = self._wake
        if wake is not None:
            wake()

    def _tell_waiting(self) -> None:
        with self._lock:
            while self._callbacks:
                try:
                    waiting = self._queue.get(0)
                except (Empty, QueueClosed):
                    break
                self._tell(waiting)

    def _tell(self, message: Message) -> bool:
        """Hand a message to the callbacks; False where the last one has just left."""
        failed = False
        with self._lock:
            if not self._callbacks:
                return False
            for callback in self._callbacks:
                try:
                    foreign(callback, message)
                except Exception as error:  # noqa: BLE001 - a callback may raise anything
                    failed = True
                    self._complain(callback, error)
        if failed:
            self._on_drop("failed")
        return True

    def _complain(self, callback: Deliver, error: Exception) -> None:
        text = f"its callback {_name(callback)} raised {text_of(error)}"
        self._records.write(logging.ERROR, text, error)
        self._on_raised(text)


def _name(callback: Deliver) -> str:
    return getattr(callback, "__qualname__", None) or type(callback).__qualname__
