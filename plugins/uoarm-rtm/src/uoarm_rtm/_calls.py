"""The calls to other processes that are under way, so that the ORB never ends under one of them.

omniORB aborts the process when it is destroyed while a call is under way after a shutdown
(`giopRope.cc`, observed with 4.3.3); a thread that comes back from a call while the interpreter
ends aborts it too.
"""

from __future__ import annotations

import threading
from types import TracebackType

from omniORB import CORBA

__all__ = ["CallGuard", "calls"]


class CallGuard:
    """A context manager around calls; entered from any thread, also nested."""

    def __init__(self) -> None:
        # Taken twice for each message, and as it is: a condition would double what that costs.
        self._lock = threading.Lock()
        self._changed = threading.Condition(self._lock)
        self._count = 0
        self._ended = False

    def __enter__(self) -> None:
        """Begin a call; raises CORBA.BAD_INV_ORDER when no call may begin any more."""
        with self._lock:
            if self._ended:
                raise CORBA.BAD_INV_ORDER(0, CORBA.COMPLETED_NO)
            self._count += 1

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End a call."""
        with self._lock:
            self._count -= 1
            if self._ended and not self._count:
                self._changed.notify_all()

    def end(self, seconds: float) -> bool:
        """Let no call begin any more, and wait for those under way.

        Returns:
            whether all have come back in time.
        """
        with self._changed:
            self._ended = True
            return self._changed.wait_for(lambda: not self._count, seconds)

    def begin(self) -> None:
        """Let calls begin, with a new ORB."""
        with self._changed:
            self._ended = False


calls = CallGuard()
"""Of this process, as the ORB is: every call is among them."""
