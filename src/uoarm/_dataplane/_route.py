"""Routes: one flow of messages each, planned when it is opened, a direct call when it runs."""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Callable

from uoarm._dataplane._failures import Clock, InputWatch, OutputWatch
from uoarm._dataplane._queue import BoundedQueue, QueueClosed
from uoarm._raised import LimitedLog, contained, is_raised, text_of
from uoarm.bridge import message_check
from uoarm.errors import BridgeError, CommandRefusedError, MessageError, UoarmError
from uoarm.model import (
    Deliver,
    Message,
    MessageStructure,
    QueuePolicy,
    RouteStatus,
    ValidationMode,
)

Judge = Callable[[Message, bool], None]
"""Raises MessageError for a message that is not what it should be, as it came or adapted."""

SAMPLE_EVERY = 128
_WINDOW_SECONDS = 1.0
_LATE_INTERVALS = 3  # after which a source that was regular is said to stand still
_WORKER_SECONDS = 1.0
_LOSSES = frozenset({"queue-full", "queue-octets", "blocked-too-long"})

_log = logging.getLogger("uoarm")


class MessageCheck:
    """Looks whether messages match their structure: at all of them, or at samples.

    Where one does not match, the 128 that come after it are looked at. Not thread safe: an output
    has one thread at a time.

    Args:
        test: raises MessageError for a message that does not match.
        rest: how many messages pass unseen between two samples.
        watch: called with what was found; None: not watched.
        is_suspected: whether one that did not match came before: the first 128 are looked at.

    Attributes:
        rest: how many messages pass before the next that is looked at; who calls this counts them.
    """

    __slots__ = ("_between", "_suspected", "_test", "_watch", "rest")

    def __init__(
        self,
        test: Callable[[Message], None],
        rest: int = 0,
        watch: OutputWatch | None = None,
        *,
        is_suspected: bool = False,
    ) -> None:
        self._test = test
        self._watch = watch
        self._between = rest
        self._suspected = SAMPLE_EVERY if is_suspected else 0
        self.rest = 0

    def __call__(self, message: Message) -> None:
        """Look at a message; raises MessageError where it does not match."""
        watch = self._watch
        try:
            self._test(message)
        except MessageError as error:
            self._suspected = SAMPLE_EVERY
            if watch is not None:
                watch.mismatched(error)
            raise
        # Only while something may be amiss: a report for each message would be a cost of each.
        if watch is not None and watch.component.is_alert:
            watch.took()
        if self._suspected:
            self._suspected -= 1
        if not self._suspected:
            self.rest = self._between


class Route:
    """Takes messages from one output and hands them to one consumer.

    Args:
        producer: name of the output, for the status map.
        consumer: name of the input or connection, for the status map.
        hand: the consumer; what it raises is counted here.
        clock: seconds.
        transfer: compiled adapter, None when messages pass unchanged.
        check: looks at messages before they are handed over; None: not checked. May be replaced at
            any time, as `check`.
        queue: None to call the consumer in the producer's thread; else a bounded queue with
            one worker stands between.
        watch: called with what became of messages, and what the adapter raised; None: not watched.

    Attributes:
        copies: the messages received that count for another route of the output; the output counts.
        failures: messages for which something raised while it was open.
        refusal: why the last message was not taken; empty where one was taken since.
        judge: asked about a message on which the adapter or the consumer failed: where its
            producer gave something wrong, that is the failure; the second argument says whether
            it was adapted before. None: it is never the producer's.
    """

    __slots__ = (
        "_clock",
        "_closed",
        "_dropped",
        "_dropping",
        "_hand",
        "_handed",
        "_loss",
        "_losses",
        "_put",
        "_queue",
        "_queue_policy",
        "_records",
        "_taken_back",
        "_transfer",
        "_watch",
        "_window_count",
        "_window_rate",
        "_window_start",
        "_worker",
        "check",
        "consumer",
        "copies",
        "failures",
        "invalid",
        "judge",
        "last_error",
        "last_time",
        "producer",
        "received",
        "refusal",
    )

    def __init__(
        self,
        producer: str,
        consumer: str,
        hand: Deliver,
        *,
        clock: Clock,
        transfer: Callable[[Message], Message] | None = None,
        check: MessageCheck | None = None,
        queue: QueuePolicy | None = None,
        watch: InputWatch | None = None,
    ) -> None:
        self.producer = producer
        self.consumer = consumer
        self.received = 0
        self._handed = 0
        self._taken_back = 0
        self.copies = 0
        self.invalid = 0
        self.failures = 0
        self.last_error = self.refusal = ""
        self.last_time: float | None = None
        # `received`, `invalid`, `failures` and the window are written by the thread that brings the
        # messages, of which an output has one at a time; `_handed` by that which calls the
        # consumer. So they need no lock, and `status` reads what may be a message behind.
        self._dropped: dict[str, int] = {}
        # Guards `_dropped`, `_loss` and `_taken_back`, which any thread counts up (the source's,
        # the worker's, a queue's `close`), and the making of the queue against `stop`. Taken within
        # a queue's lock, so no queue is called while it is held.
        self._dropping = threading.Lock()
        self._hand: Deliver | None = hand
        self._transfer = transfer
        self.check = check
        self._watch = watch
        self.judge: Judge | None = None
        self._records = LimitedLog(_log)
        self._losses = LimitedLog(_log)
        self._loss = ""
        self._clock = clock
        self._closed = False
        self._window_start = clock()
        self._window_count = 0
        self._window_rate: float | None = None
        self._queue_policy = queue
        self._queue: BoundedQueue[Message] | None = None  # from the first message on
        self._worker: threading.Thread | None = None
        self._put: Deliver | None = None  # that of the queue

    def deliver(self, message: Message) -> Exception | None:
        """Take one message, in the thread in which it arrived. Never raises.

        Returns:
            What it came to here, which is counted already; None where it was taken, or waits.
        """
        failure: Exception | None = None
        now = self._clock()
        # Counted first, whatever becomes of it: all that was received was delivered, was dropped,
        # or is in a queue or in hand. `connection_runtime` relies on it for what is lost with a
        # component.
        self.received += 1
        self.last_time = now
        self._window_count += 1
        if now - self._window_start >= _WINDOW_SECONDS:
            self._turn_window(now)
        # How far it came says whose failure it is: a check blames what gave the message by itself.
        is_checked = is_adapted = False
        try:
            check = self.check  # read once: it may be replaced at any time
            if check is not None:
                if check.rest:  # counted here, without a call
                    check.rest -= 1
                else:
                    check(message)
            is_checked = True
            if self._transfer is not None:
                message = self._transfer(message)
                is_adapted = True
            put = self._put  # likewise: `close` takes it away
            if put is not None:
                put(message)
            elif self._queue_policy is None:
                self._hand_over(message)
            else:
                self._queue_first(message)
        except BaseException as error:  # noqa: BLE001 - whatever a consumer raises is counted
            failure = contained(error)
            if is_checked:
                failure = self._judged(failure, message, is_adapted=is_adapted)
            # What fails as the route is closed is the closing's doing, and no one's failure.
            if not self._fail(failure):
                failure = None
        if self._loss:
            # Here, since `drop` is called with a queue's lock held, and handlers of logs may block.
            # Without the lock: of two that are noted just now one may miss the log, but never the
            # counts.
            reason, self._loss = self._loss, ""
            text = f"{self.producer} -> {self.consumer}: a message was dropped: {reason}"
            self._losses.write(logging.WARNING, text)
        return failure

    def unreadable(self, why: str) -> None:
        """Count a message that came and could not be read. Never raises."""
        # In the thread that brings messages, as `deliver` is: each counter has one writer.
        self.received += 1
        self.invalid += 1
        self.failures += 1
        self.last_time = self._clock()
        self.last_error = self.refusal = why
        self.drop("unreadable")
        self._records.write(logging.WARNING, f"{self.producer} -> {self.consumer}: {why}")

    def drop(self, reason: str) -> None:
        """Count one lost message, from any thread."""
        with self._dropping:
            self._count(reason)

    def take_back(self, reason: str) -> None:
        """Count a message as lost that had been counted as delivered."""
        with self._dropping:
            self._taken_back += 1
            self._count(reason)

    def drain(self, timeout: float) -> bool:
        """Wait until what is queued was handed over; False when time ran out."""
        # Read once, as `close` takes it away. One that is closed has nothing left to wait for.
        queue = self._queue
        return queue is None or queue.drain(timeout)

    @property
    def closed(self) -> bool:
        """Whether it hands over nothing more."""
        return self._closed

    def stop(self) -> None:
        """Hand over nothing more; what is queued is lost and counted. Waits for nothing."""
        with self._dropping:
            # With the lock: `_queue_first` makes no queue after this, whose worker would stay.
            self._closed = True
            queue = self._queue
        # Without it: the queue counts what it discards with `drop`, which takes the lock.
        if queue is not None:
            queue.close(discard=True)

    def close(self) -> None:
        """Stop, and wait a second at most for a message that the worker has in hand."""
        self.stop()
        # A consumer may close its own route, in the worker: that would wait for itself.
        # After `stop`, from when `_queue_first` starts no other worker.
        if self._worker is not None and self._worker is not threading.current_thread():
            self._worker.join(_WORKER_SECONDS)
        # They refer back to the route, which is to be gone with its last user.
        self._hand = self._put = self._queue = self.judge = None

    def status(self) -> RouteStatus:
        """Return the counters as they are now."""
        now = self._clock()
        age = None if self.last_time is None else now - self.last_time
        return RouteStatus(
            producer=self.producer,
            consumer=self.consumer,
            received=self.received,
            delivered=self._handed - self._taken_back,
            # Copied in one step, which no other thread can come between.
            dropped=tuple(sorted(self._dropped.copy().items())),
            invalid=self.invalid,
            rate=self._rate(now),
            age=age,
            last_error=self.last_error,
            refusal=self.refusal,
            copies=self.copies,
        )

    def _queue_first(self, message: Message) -> None:
        """Make the queue and start its worker with the first message: opening should be quick."""
        assert self._queue_policy is not None, "only a route with a queue comes here"
        with self._dropping:
            if self._queue is None and not self._closed:
                made = BoundedQueue[Message](self._queue_policy, self.drop)
                name = f"uoarm-to-{self.consumer}"
                worker = threading.Thread(target=self._work, args=(made,), name=name, daemon=True)
                worker.start()
                # After it began: where the system gives no thread, the next message tries again.
                self._queue, self._worker = made, worker
            queue = self._queue
        if queue is None:  # it was closed before its first message
            self.drop("closed")
            return
        # From now on `deliver` calls the queue itself. One that is closed meanwhile counts what
        # comes.
        self._put = queue.put
        queue.put(message)

    def _hand_over(self, message: Message) -> None:
        # In the worker, or in the thread that brings messages where there is no queue: never in
        # both.
        hand = self._hand  # read first: it is there until the route is closed
        if self._closed or hand is None:
            self.drop("closed")
            return
        hand(message)
        self._handed += 1  # after the call: what raised, or hangs still, is not delivered
        if self.refusal:
            self.refusal = ""
        watch = self._watch
        if watch is not None and watch.component.is_alert:
            watch.took()

    def _work(self, queue: BoundedQueue[Message]) -> None:
        while True:
            try:
                message = queue.get()
            except QueueClosed:
                return
            try:
                self._hand_over(message)
            except BaseException as error:  # noqa: BLE001 - as in `deliver`
                is_adapted = self._transfer is not None
                self._fail(self._judged(contained(error), message, is_adapted=is_adapted))
            finally:
                queue.done()  # also of one that failed, or `drain` would wait for it for ever

    def _count(self, reason: str) -> None:
        self._dropped[reason] = self._dropped.get(reason, 0) + 1
        if reason in _LOSSES:
            self._loss = reason

    def _judged(self, error: Exception, message: Message, *, is_adapted: bool) -> Exception:
        """Return what went wrong with a message: not its consumer, where it was wrong itself.

        Most messages are not checked, or few of them.
        """
        if self.judge is None or not (is_raised(error) or isinstance(error, MessageError)):
            return error
        try:
            self.judge(message, is_adapted)
        except MessageError as wrong:
            return wrong
        return error

    def _fail(self, error: Exception) -> bool:
        """Count a failure; False where it is of a route that was closed meanwhile."""
        if self._closed:
            self.drop("closed")
            return False
        self.failures += 1
        if isinstance(error, MessageError):
            self.invalid += 1
            self.drop("invalid")
        else:
            self.drop(error.reason if isinstance(error, CommandRefusedError) else "failed")
        text = self.last_error = text_of(error)
        self.refusal = str(error) if isinstance(error, UoarmError) else text
        if self._watch is None or not self._watch.raised(error):
            place = f"{self.producer} -> {self.consumer}"
            # Where a command is refused, the way is not there, or a message does not match and
            # nothing else caused that, the text says all: nothing went wrong in a program whose
            # lines one would look for.
            is_plain = isinstance(error, BridgeError) or error.__cause__ is None
            trace = None if is_plain and not is_raised(error) else error
            self._records.write(logging.WARNING, f"{place}: {text}", trace)
        return True

    def _turn_window(self, now: float) -> None:
        self._window_rate = self._window_count / (now - self._window_start)
        self._window_start = now
        self._window_count = 0

    def _rate(self, now: float) -> float | None:
        """Return messages a second, 0 once several are late: that of a slow source stands."""
        # Any thread, while that which brings messages turns the window: where the two halves are of
        # different windows the rate is wrong for this look, and right at the next.
        rate, elapsed = self._window_rate, now - self._window_start
        if rate is None and self.received > 1 and elapsed > 0:
            rate = self._window_count / elapsed
        if rate and self.last_time is not None:
            is_silent = now - self.last_time > max(_WINDOW_SECONDS, _LATE_INTERVALS / rate)
            return 0.0 if is_silent else rate
        return rate


def make_check(
    structure: MessageStructure,
    mode: ValidationMode,
    place: str,
    watch: OutputWatch | None = None,
    *,
    is_suspected: bool = False,
) -> MessageCheck | None:
    """Return what raises MessageError for a message of another structure.

    Args:
        structure: what the messages must match.
        mode: OFF gives None; SAMPLED checks the first and then every 128th message, and all of the
            128 that come after one that does not match.
        place: the port, for the error's text.
        watch: called with what was found; None: not watched.
        is_suspected: whether one that did not match came before: the first 128 are checked.
    """
    if mode is ValidationMode.OFF and not is_suspected:
        return None
    check = message_check(structure, place)
    if mode is ValidationMode.ALWAYS:
        return MessageCheck(check, watch=watch)
    # OFF that is suspected looks at 128 messages and then never again: there is no next sample.
    rest = SAMPLE_EVERY - 1 if mode is ValidationMode.SAMPLED else sys.maxsize
    return MessageCheck(check, rest, watch, is_suspected=is_suspected)
