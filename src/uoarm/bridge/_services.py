"""Services both ways: calls under way, and requests for a function that is offered."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Generic, TypeVar

from attrs import define

from uoarm._raised import Log, foreign, text_of
from uoarm._support import deadlines
from uoarm.bridge._health import ChannelHealth, ChannelMonitor
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Health

_MOST_EARLY = 1000


@define(eq=False)
class CallUnderWay:
    """One call.

    Attributes:
        number: by which it is cancelled; None: only by who makes it.
        cancel: how the framework is notified; None: it cannot be, or not yet.
        step: for which its caller waits; None: it runs in the caller's thread.
    """

    number: int | None = None
    step: deadlines.StepUnderWay | None = None
    cancel: Callable[[], object] | None = None
    is_cancelled: bool = False


class _Here(threading.local):
    call: CallUnderWay | None = None


class CallsUnderWay:
    """Thread safe. A call stays in the thread in which it began."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._calls: set[CallUnderWay] = set()
        self._early: dict[int, None] = {}
        self._is_closed = False
        self._here = _Here()

    def __len__(self) -> int:
        return len(self._calls)

    def begin(self, call: CallUnderWay) -> CallUnderWay | None:
        """List a call in this thread; return the one that this thread is in already.

        Raises:
            BridgeError: it was cancelled, or the bridge closed, before: it does not begin.
        """
        with self._lock:
            if self._is_closed:
                raise BridgeError("the bridge was closed", FailureReason.CLOSED)
            if call.is_cancelled or call.number in self._early:
                text = "the call was cancelled before it began"
                raise BridgeError(text, FailureReason.REFUSED)
            call.step = deadlines.current()
            self._calls.add(call)
        outer, self._here.call = self._here.call, call
        return outer

    def end(self, call: CallUnderWay, outer: CallUnderWay | None) -> None:
        """List it no more; this thread is in `outer` again."""
        self._here.call = outer
        with self._lock:
            self._calls.discard(call)
            if call.step is not None:  # which may go on, as it is that of a step around the call
                call.step.abandoned.pop(call, None)

    def abandon(self, seconds: float) -> None:
        """Have callers wait so many seconds at most, but for a call in which this is asked."""
        end = time.monotonic() + seconds
        with self._lock:
            for call in self._calls:
                if call.step is not None and call.step is not deadlines.current():
                    call.step.abandoned[call] = end

    @contextmanager
    def cancelling(self, cancel: Callable[[], object]) -> Iterator[None]:
        """Have the call in this thread cancelled in this way for the length of a block.

        Whichever comes first, this or `cancel`: a call that was cancelled before is cancelled here.
        """
        call = self._here.call
        assert call is not None, "in `_call` only"
        with self._lock:
            call.cancel, is_late = cancel, call.is_cancelled
        if is_late:
            cancel()
        try:
            yield
        finally:
            with self._lock:
                call.cancel = None

    def cancel_number(self, number: int) -> bool:
        """Cancel the call of this number, as `cancel` does; one that has not begun never does."""
        with self._lock:
            call = next(
                (
                    call_under_way
                    for call_under_way in self._calls
                    if call_under_way.number == number
                ),
                None,
            )
            if call is None:
                # It begins later, or it has ended, which is not known here.
                self._early[number] = None
                if len(self._early) > _MOST_EARLY:
                    del self._early[next(iter(self._early))]
                return True
        return self.cancel(call)

    def cancel(self, call: CallUnderWay) -> bool:
        """Cancel a call; return whether the framework was notified, which it may be later still."""
        with self._lock:
            call.is_cancelled, way = True, call.cancel
        return way is not None and way() is not False

    def close(self) -> bool:
        """Have no call begin from now on; return whether one is under way."""
        with self._lock:
            self._is_closed = True
            return bool(self._calls)

    def cancel_all(self) -> None:
        """Cancel every call, as `cancel` does; one that cannot be keeps none of the others.

        Raises:
            Exception: what the first one raised that could not be cancelled.
        """
        with self._lock:
            calls = tuple(self._calls)
        errors: list[Exception] = []
        for call in calls:
            try:
                self.cancel(call)
            except Exception as error:  # noqa: BLE001 - raised when all have been tried
                errors.append(error)
        if errors:
            raise errors[0]


T = TypeVar("T")
_log = Log("uoarm")


class ServedRequests(Generic[T]):
    """What is asked of one function, from the framework's thread to some of its own.

    The framework's thread only appends, so that a function that hangs holds up nothing else.
    Threads begin as requests come, and end when none waits. A request that fails makes the channel
    degraded until one succeeds.

    Args:
        what: is served, for threads and causes, such as `service /switch`.
        handle: has one request handled and answers it; raises what it failed with.
        refuse: says to the client that there is no answer, and why.
        at_once: requests that are handled at the same time.
        report: takes changes of health.
        most: requests that may wait; more are refused.
    """

    def __init__(
        self,
        what: str,
        handle: Callable[[T], object],
        refuse: Callable[[T, Exception], object],
        at_once: int,
        report: Callable[[Health, str], object],
        *,
        most: int = 256,
    ) -> None:
        self._what, self._handle, self._refuse = what, handle, refuse
        self._at_once, self._most = at_once, most
        self._monitor = ChannelMonitor(ChannelHealth(what, 0.0), report)
        # Guards all below, between the framework's thread, which appends, and those that handle. A
        # thread that finds no request leaves under the lock under which the next request looks for
        # threads, so that none waits without one.
        self._lock = threading.Lock()
        self._waiting: deque[T] = deque()
        self._handled: list[T] = []
        self._threads = 0
        self._is_closed = False
        self._answered = self._failed = self._refused = 0

    @property
    def is_full(self) -> bool:
        """Whether another request would be refused."""
        return self._is_closed or len(self._waiting) >= self._most

    def facts(self) -> Mapping[str, object]:
        """Return counters of requests."""
        return {
            "answered": self._answered,
            "failed": self._failed,
            "refused": self._refused,
            "waiting": len(self._waiting),
        }

    def put(self, request: T) -> None:
        """Have a request handled, or refused where too many wait; returns at once."""
        with self._lock:
            is_full = self.is_full
            self._refused += is_full
            starts = not is_full and self._threads < self._at_once
            self._threads += starts
            if not is_full:
                self._waiting.append(request)
        if is_full:
            why = "it is closed" if self._is_closed else f"{self._most} requests wait already"
            self._turn_away(request, BridgeError(why, FailureReason.REFUSED))
        elif starts:
            name = f"uoarm serves {self._what}"
            try:
                threading.Thread(target=self._run, name=name, daemon=True).start()
            except RuntimeError:  # the system gives no more: it waits for one, or for the next try
                with self._lock:
                    self._threads -= 1

    def withdraw(self, is_meant: Callable[[T], bool]) -> tuple[list[T], list[T]]:
        """Take requests out that wait; returns them, and those meant that are being handled."""
        with self._lock:
            found = [request for request in self._waiting if is_meant(request)]
            for request in found:
                self._waiting.remove(request)
            return found, [request for request in self._handled if is_meant(request)]

    def peer_reported(self, health: Health, cause: str) -> None:
        """Say how the framework's side is, whatever becomes of requests; OK is the end of it."""
        self._monitor.peer_reported(health, cause)

    def close(self) -> None:
        """Handle no other request; does not wait, since the one that is handled may close it."""
        self._monitor.close()
        with self._lock:
            self._is_closed = True
            self._waiting.clear()

    def _run(self) -> None:
        while True:
            with self._lock:
                if not self._waiting:
                    self._threads -= 1
                    return
                request = self._waiting.popleft()
                self._handled.append(request)
            try:
                foreign(self._handle, request)
            except Exception as error:  # noqa: BLE001 - of the function: the client gets it
                with self._lock:
                    self._failed += 1
                self._turn_away(request, error)
            else:
                with self._lock:
                    self._answered += 1
                self._monitor.passed()
            with self._lock:
                self._handled.remove(request)

    def _turn_away(self, request: T, error: Exception) -> None:
        self._monitor.refused(text_of(error))
        try:
            foreign(self._refuse, request, error)
        except Exception as another:  # noqa: BLE001 - the framework's; there is more to handle
            _log.warning("a client of %s could not be refused: %s", self._what, text_of(another))
