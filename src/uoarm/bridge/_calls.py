"""Calls of services that are under way in one bridge, and how each is cancelled."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from attrs import define

from uoarm.errors import BridgeError, FailureReason

__all__ = ["CallUnderWay", "CallsUnderWay"]

_MOST_EARLY = 1000


@define(eq=False)
class CallUnderWay:
    """One call.

    Attributes:
        number: by which it is cancelled; None: only by who makes it.
        cancel: how the framework is notified; None: it cannot be, or not yet.
    """

    number: int | None = None
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
        self._here = _Here()

    def __len__(self) -> int:
        return len(self._calls)

    def begin(self, call: CallUnderWay) -> CallUnderWay | None:
        """List a call in this thread; return the one that this thread is in already.

        Raises:
            BridgeError: it was cancelled before, and does not begin.
        """
        with self._lock:
            if call.is_cancelled or call.number in self._early:
                text = "the call was cancelled before it began"
                raise BridgeError(text, FailureReason.REFUSED)
            self._calls.add(call)
        outer, self._here.call = self._here.call, call
        return outer

    def end(self, call: CallUnderWay, outer: CallUnderWay | None) -> None:
        """List it no more; this thread is in `outer` again."""
        self._here.call = outer
        with self._lock:
            self._calls.discard(call)

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
