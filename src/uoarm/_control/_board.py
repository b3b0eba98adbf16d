"""The board: changes of the system, numbered, told to listeners in order by one thread."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from queue import SimpleQueue

from uoarm._dataplane import Clock
from uoarm.model import StatusEvent

__all__ = ["Board"]

_log = logging.getLogger("uoarm")
_CLOSE_SECONDS = 2.0


class Board:
    """Numbers events, calls listeners, and runs the manager's own reactions.

    Everything runs in one thread of its own, in order, so that no bridge and no message waits
    for a listener.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._number = 0
        self._listeners: tuple[Callable[[StatusEvent], None], ...] = ()
        self._work: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="uoarm-events", daemon=True)
        self._thread.start()

    def post(self, subject: str, change: str, cause: str = "") -> None:
        """Number one change and have it told."""
        with self._lock:
            self._number += 1
            event = StatusEvent(self._number, self._clock(), subject, change, cause)
            self._work.put(lambda: self._tell(event))

    def react(self, reaction: Callable[[], None]) -> None:
        """Run the manager's reaction to an event in the board's thread."""
        self._work.put(reaction)

    def listen(self, listener: Callable[[StatusEvent], None]) -> Callable[[], None]:
        """Tell a listener every change from now on; returns what ends that."""
        with self._lock:
            self._listeners = (*self._listeners, listener)

        def end() -> None:
            with self._lock:
                self._listeners = tuple(one for one in self._listeners if one is not listener)

        return end

    def close(self) -> None:
        """Tell what is left, then end. Waits two seconds at most."""
        self._work.put(None)
        if threading.current_thread() is not self._thread:
            self._thread.join(_CLOSE_SECONDS)

    def _tell(self, event: StatusEvent) -> None:
        for listener in self._listeners:
            try:
                listener(event)
            except Exception:  # noqa: BLE001 - a listener may raise anything
                _log.exception("listener %r failed at event %d", listener, event.number)

    def _run(self) -> None:
        while (work := self._work.get()) is not None:
            try:
                work()
            except Exception:  # noqa: BLE001 - the thread must outlive every reaction
                _log.exception("a reaction to an event failed")
