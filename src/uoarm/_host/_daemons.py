"""Threads for what may wait for a framework, and which no end of the process waits for."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from queue import SimpleQueue

__all__ = ["DaemonThreads"]

_log = logging.getLogger("uoarm")


class DaemonThreads:
    """Does actions in threads, started as they are needed, up to a limit; the rest waits in order.

    Not a pool of `concurrent.futures`, for whose threads the interpreter waits when it ends: a
    call of a component that takes a minute would keep a host for a minute that is told to end.

    Args:
        name: of the threads.
        most: how many there are at most.
    """

    def __init__(self, name: str, most: int) -> None:
        self._name = name
        self._most = most
        self._lock = threading.Lock()
        self._actions: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._started = 0
        self._idle = 0
        self._closed = False

    def submit(self, action: Callable[[], None]) -> bool:
        """Have an action done; returns at once. False when it is closed. From any thread."""
        with self._lock:
            if self._closed:
                return False
            self._actions.put(action)
            if self._idle:
                self._idle -= 1
            elif self._started < self._most:
                self._started += 1
                threading.Thread(target=self._run, name=self._name, daemon=True).start()
        return True

    def close(self) -> None:
        """Begin nothing more; what is under way ends alone. Once is enough."""
        with self._lock:
            self._closed = True
            for _ in range(self._started):
                self._actions.put(None)

    def _run(self) -> None:
        while (action := self._actions.get()) is not None and not self._closed:
            try:
                action()
            except Exception:  # noqa: BLE001 - whatever it is, the next action is done
                _log.exception("a thread of %s failed", self._name)
            del action  # with the message that it holds
            with self._lock:
                self._idle += 1
