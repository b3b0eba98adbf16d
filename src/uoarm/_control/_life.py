"""The life of a connection: where it is between its opening and its end, and why it ended."""

from __future__ import annotations

import threading
from collections.abc import Callable

from uoarm.model import ConnectionState

__all__ = ["GOING_ON", "Life"]

GOING_ON = frozenset({ConnectionState.RUNNING, ConnectionState.WAITING})


class Life:
    """The states of one connection, which move down their list only, but for a wait.

    Does nothing itself; every decision is made under one lock, so that of several threads one
    opens, one ends, and nothing changes hands after the end has begun.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._passed = threading.Event()
        self.state = ConnectionState.OPENING
        self.cause = ""

    @property
    def is_over(self) -> bool:
        """Whether the end has come, for whatever reason."""
        return self.state in {ConnectionState.CLOSED, ConnectionState.FAILED}

    def start(self) -> bool:
        """Run from now on; False when the end began during the opening."""
        with self._lock:
            if self.state is not ConnectionState.OPENING:
                return False
            self.state = ConnectionState.RUNNING
        self._passed.set()
        return True

    def wait(self, cause: str) -> bool:
        """Wait from now on for what can take over; False when it does not run."""
        with self._lock:
            if self.state is not ConnectionState.RUNNING:
                return False
            self.state, self.cause = ConnectionState.WAITING, cause
            return True

    def change(self, swap: Callable[[], None]) -> bool:
        """Do a quick `swap` that no end can come between, and run; False when it has ended."""
        with self._lock:
            if self.state not in GOING_ON:
                return False
            swap()
            self.state, self.cause = ConnectionState.RUNNING, ""
            return True

    def begin_end(self, cause: str) -> bool:
        """Begin to end; False for every caller but the first."""
        with self._lock:
            if self.state is not ConnectionState.OPENING and self.state not in GOING_ON:
                return False
            self.state = ConnectionState.CLOSING
            self.cause = cause
        self._passed.set()
        return True

    def finish(self, state: ConnectionState) -> None:
        """Say how it ended: CLOSED or FAILED."""
        self.state = state

    def wait_opened(self, timeout: float) -> None:
        """Wait until the opening is over, however it went, `timeout` seconds at most."""
        self._passed.wait(timeout)
