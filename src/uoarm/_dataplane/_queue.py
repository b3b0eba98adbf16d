"""A queue bounded in items and octets, with an overflow policy, which counts what it loses."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable
from queue import Empty
from typing import Any, Generic, TypeVar

from uoarm._interrupts import wait_until
from uoarm._raised import LimitedLog, contained, name_of, text_of
from uoarm.errors import UsageError
from uoarm.model import Deliver, Message, OverflowPolicy, QueuePolicy, message_octets

T = TypeVar("T")


class QueueClosed(Exception):  # noqa: N818 - a signal to the reader, not a fault
    """The queue is closed and everything in it was taken."""


class BoundedQueue(Generic[T]):
    """Items from any thread to any thread, in order.

    An item of any size passes when it is alone; so one is measured only when another comes while it
    waits, and a queue whose reader keeps up costs no measuring.

    Args:
        policy: length, octets and overflow policy.
        on_drop: called with the reason for each item that is lost; must not block.
        measure: returns the octets of memory that an item holds.
    """

    def __init__(
        self,
        policy: QueuePolicy,
        on_drop: Callable[[str], None],
        measure: Callable[[Any], int] = message_octets,
    ) -> None:
        self._policy = policy.policy
        self._length = 1 if policy.policy is OverflowPolicy.LATEST else policy.length
        self._most_octets = policy.octets
        self._timeout = policy.timeout
        self._on_drop = on_drop
        self._measure = measure
        self._items: deque[T] = deque()
        self._sizes: deque[int] = deque()  # of all items; of the oldest it may be missing
        self._octets = 0
        self._unfinished = 0
        self._closed = False
        # Guards every field here, from the producer's threads against the reader's and `close`. It
        # is held for a few lines only, apart from waits, which give it up, and from measuring.
        self._lock = threading.Lock()
        # One condition for all that is waited for (an item, room, the end of work): there are few
        # who wait, and each looks at its own condition again when it is woken. Made, under the
        # lock, as the first waits: most queues of a connection never see one who does.
        self._changed: threading.Condition | None = None
        # How many wait. A message that no thread waits for costs no notification; it is counted
        # under the lock, so no waiter can be missed.
        self._waiting = 0

    def __len__(self) -> int:
        return len(self._items)

    @property
    def octets(self) -> int:
        """Octets of memory that the items hold."""
        with self._lock:
            self._measure_oldest()
            return self._octets

    def put(self, item: T) -> None:
        """Add an item. Waits only under the `block` policy, up to its timeout."""
        with self._lock:
            size = self._measure(item) if self._items and self._length > 1 else 0
            if not self._has_room(size) and not self._closed:
                self._make_room(size)
            # Looked at after the wait for room, which gives the lock up: it may be closed by now.
            if self._closed:
                self._on_drop("closed")
                return
            if not self._has_room(size):
                self._on_drop("blocked-too-long")
                return
            # What is put into an empty queue has no size yet: `_sizes` is one shorter than
            # `_items`.
            if self._items:
                self._sizes.append(size)
                self._octets += size
            self._items.append(item)
            # From here, and not from `get` on: else a drain could end between the two.
            self._unfinished += 1
            if self._waiting:
                self._wake()

    def get(self, timeout: float | None = None) -> T:
        """Take the oldest item, waiting `timeout` seconds at most (None: for ever).

        Raises:
            queue.Empty: nothing came in time.
            QueueClosed: the queue is closed and empty.
        """
        with self._lock:
            if not self._items and not self._closed:
                self._wait_for(lambda: bool(self._items) or self._closed, timeout)
            if not self._items:
                raise QueueClosed if self._closed else Empty
            item = self._pop()
            if self._waiting:
                self._wake()
            return item

    def done(self) -> None:
        """Say that an item taken with `get` was dealt with; `drain` waits for that."""
        with self._lock:
            self._unfinished -= 1
            if self._waiting:
                self._wake()

    def drain(self, timeout: float) -> bool:
        """Wait until every item was dealt with or the queue closed; False when time ran out."""
        with self._lock:
            # Not until it is empty: what `get` has taken and `done` was not called for is under
            # way.
            return self._wait_for(lambda: not self._unfinished or self._closed, timeout)

    def close(self, *, discard: bool) -> None:
        """Take no more items. What is inside is lost and counted if `discard`, else readable."""
        with self._lock:
            self._closed = True
            if discard:
                for _ in range(len(self._items)):
                    self._on_drop("closed")
                self._items.clear()
                self._sizes.clear()
                self._octets = 0
            self._wake()  # always: a producer or a reader may wait, and `drain` too

    # The methods below are called with the lock held.

    def _wake(self) -> None:
        if self._changed is not None:
            self._changed.notify_all()

    def _pop(self) -> T:
        if len(self._sizes) == len(self._items):
            self._octets -= self._sizes.popleft()
        return self._items.popleft()

    def _measure_oldest(self) -> None:
        if len(self._sizes) < len(self._items):
            self._sizes.appendleft(self._measure(self._items[0]))
            self._octets += self._sizes[0]

    def _has_room(self, size: int) -> bool:
        """Say whether another item of a size may be added."""
        if not self._items:
            return True
        if len(self._items) >= self._length:
            return False
        self._measure_oldest()
        return self._octets + size <= self._most_octets

    def _make_room(self, size: int) -> None:
        if self._policy is OverflowPolicy.BLOCK:
            self._wait_for(lambda: self._has_room(size) or self._closed, self._timeout)
            return
        while not self._has_room(size):
            full = len(self._items) >= self._length
            self._pop()
            self._unfinished -= 1  # no reader will call `done` for it, and `drain` waits for none
            if self._policy is OverflowPolicy.LATEST:
                self._on_drop("replaced")
            else:
                self._on_drop("queue-full" if full else "queue-octets")

    def _wait_for(self, ready: Callable[[], bool], timeout: float | None) -> bool:
        if self._changed is None:
            self._changed = threading.Condition(self._lock)
        self._waiting += 1
        try:
            return wait_until(self._changed, ready, timeout)
        finally:
            self._waiting -= 1


_log = logging.getLogger("uoarm")


class Inbox:
    """Messages for one reader: a queue to take from, or callbacks once there is one.

    Args:
        policy: what to do when the application is slower than the messages.
        on_drop: counts each lost message by reason.
        on_raised: called with what a callback raised.
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
        # Replaced as a whole, so that `put` may look at it without the lock.
        self._callbacks: tuple[Deliver, ...] = ()
        self._wake: Callable[[], None] | None = None
        # Held while callbacks run: from the route's thread against `subscribe`, so that what waits
        # comes before what arrives, and no two messages are in a callback at a time. Re-entrant,
        # since a callback may subscribe, or cause the next message.
        self._lock = threading.RLock()
        # Guards the tuple's changes. Another lock: an end waits for no callback, or two would wait
        # for each other that end both subscriptions. Re-entrant, for an end in a finalizer.
        self._changing = threading.RLock()
        self._records = LimitedLog(_log)

    def put(self, message: Message) -> None:
        """Take one message from the route, in the route's thread."""
        if self._callbacks and self._notify(message):
            return
        self._queue.put(message)
        # The first callback may have come between the look and the queue, after it had emptied
        # that: the message would be left behind until the next one comes.
        if self._callbacks:
            self._notify_of_waiting()
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
        # One that waits here as the first callback comes is not woken: messages go to the callback,
        # and its time runs out.
        try:
            return self._queue.get(timeout)
        except Empty:
            raise TimeoutError(f"no message within {timeout:g} s") from None

    def subscribe(self, callback: Deliver) -> Callable[[], None]:
        """Give every message to a callback from now on, first what is waiting already.

        Callbacks run in the thread in which the message arrives; one that raises is logged and
        stays, and the message counts as lost. Returns a function that ends the subscription; a
        message that is under way may still come.
        """
        with self._lock:
            with self._changing:
                self._callbacks = (*self._callbacks, callback)
            self._notify_of_waiting()

        def end() -> None:
            with self._changing:
                self._callbacks = tuple(c for c in self._callbacks if c is not callback)

        return end

    def on_wake(self, wake: Callable[[], None] | None) -> None:
        """Have `wake` called after each message that was queued and when the inbox closes."""
        self._wake = wake

    def close(self, *, discard: bool = False) -> None:
        """Take no more; what waits can still be read unless `discard`."""
        # The queue first: who is woken looks into it, and must find that no more comes.
        self._queue.close(discard=discard)
        wake = self._wake
        if wake is not None:
            wake()

    def _notify_of_waiting(self) -> None:
        with self._lock:
            while self._callbacks:
                # One at a time, and only while there is a callback: the last may leave in its call,
                # and what waits is then for `get` again.
                try:
                    waiting = self._queue.get(0)
                except (Empty, QueueClosed):
                    break
                self._notify(waiting)

    def _notify(self, message: Message) -> bool:
        """Hand a message to the callbacks; False where the last one has just left."""
        failed = False
        with self._lock:
            if not self._callbacks:
                return False
            # The tuple of this moment: one that is added in a call gets the next message, and one
            # that leaves gets this one still.
            for callback in self._callbacks:
                try:
                    callback(message)
                # As `foreign`, without its call for each message.
                except BaseException as error:  # noqa: BLE001 - a callback may raise anything
                    failed = True
                    self._complain(callback, contained(error))
        if failed:  # once, however many callbacks raised: it is one message
            self._on_drop("failed")
        return True

    def _complain(self, callback: Deliver, error: Exception) -> None:
        text = f"its callback {name_of(callback)} raised {text_of(error)}"
        self._records.write(logging.ERROR, text, error)
        self._on_raised(text)
