"""Requests for a function that is offered in a framework: handled by some threads, others wait."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Mapping
from typing import Generic, TypeVar

from uoarm._raised import text_of
from uoarm.bridge._health import ChannelHealth, ChannelMonitor
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Health

__all__ = ["ServedRequests"]

T = TypeVar("T")
_log = logging.getLogger("uoarm")


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
            threading.Thread(target=self._run, name=name, daemon=True).start()

    def withdraw(self, is_meant: Callable[[T], bool]) -> tuple[list[T], list[T]]:
        """Take requests out that wait; returns them, and those meant that are being handled."""
        with self._lock:
            found = [request for request in self._waiting if is_meant(request)]
            for request in found:
                self._waiting.remove(request)
            return found, [request for request in self._handled if is_meant(request)]

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
                self._handle(request)
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
            self._refuse(request, error)
        except Exception as another:  # noqa: BLE001 - the framework's; there is more to handle
            _log.warning("a client of %s could not be refused: %s", self._what, text_of(another))
