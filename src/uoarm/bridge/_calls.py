"""Calls of services that are under way in one bridge, and how each is cancelled."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from attrs import define

__all__ = ["CallUnderWay", "CallsUnderWay"]


@define(eq=False)
class CallUnderWay:
    """One call.

    Attributes:
        component: which provides the service.
        cancel: how the framework is told; None: it cannot be, or not yet.
    """

    component: str
    cancel: Callable[[], object] | None = None
    is_cancelled: bool = False


class CallsUnderWay:
    """Thread safe. A call stays in the thread in which it began."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._calls: set[CallUnderWay] = set()
        self._here = threading.local()

    @contextmanager
    def begun(self, call: CallUnderWay) -> Iterator[None]:
        """Have a call listed for the length of a block, in the thread that makes it."""
        outer = getattr(self._here, "call", None)
        self._here.call = call
        with self._lock:
            self._calls.add(call)
        try:
            yield
        finally:
            self._here.call = outer
            with self._lock:
                self._calls.discard(call)

    @contextmanager
    def cancelling(self, cancel: Callable[[], object]) -> Iterator[None]:
        """Have the call in this thread cancelled in this way for the length of a block.

        Whichever comes first, this or `cancel`: a call that was cancelled before is cancelled here.
        """
        call: CallUnderWay = self._here.call
        with self._lock:
            call.cancel, is_late = cancel, call.is_cancelled
        if is_late:
            cancel()
        try:
            yield
        finally:
            with self._lock:
                call.cancel = None

    def of(self, component: str) -> tuple[CallUnderWay, ...]:
        """Return the calls of a component."""
        with self._lock:
            return tuple(one for one in self._calls if one.component == component)

    def cancel(self, call: CallUnderWay) -> bool:
        """Cancel a call; return whether the framework was told, which it may be later still."""
        with self._lock:
            call.is_cancelled, way = True, call.cancel
        if way is not None:
            way()
        return way is not None
