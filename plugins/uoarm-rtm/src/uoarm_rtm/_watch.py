"""Checks again and again, and on request."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

__all__ = ["Ticker"]

_AGAIN_SECONDS = 0.02

_log = logging.getLogger("uoarm.rtm")

Tick = Callable[[], None]


class Ticker:
    """A thread that calls some ticks again and again, each on its own, and others on request.

    Args:
        ticks: returns what to call now.
        seconds: pause between rounds; 0 for no thread at all.
    """

    def __init__(self, ticks: Callable[[], list[Tick]], seconds: float) -> None:
        self._ticks = ticks
        self._seconds = seconds
        self._changed = threading.Condition(threading.Lock())
        self._ended = False
        self._urgent: dict[Tick, None] = {}
        self._thread = threading.Thread(target=self._run, name="uoarm-rtm-watch", daemon=True)

    def start(self) -> None:
        """Begin, where there are rounds at all."""
        if self._seconds:
            self._thread.start()

    def soon(self, tick: Tick) -> None:
        """Have a tick called next, after the one under way, and once more 20 ms later.

        A component reports a state before it is in it (observed). Several that wait are one.
        """
        with self._changed:
            self._urgent[tick] = None
            self._changed.notify_all()

    def close(self, seconds: float) -> None:
        """End the thread after the tick under way, and wait for that up to `seconds`.

        A thread that lets go of references while the interpreter ends aborts the process.
        """
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        if self._thread.is_alive() and self._thread is not threading.current_thread():
            self._thread.join(seconds)

    def _run(self) -> None:
        while True:
            for tick in self._ticks():
                if not self._rest(0):
                    return
                _call(tick)
            if not self._rest(self._seconds):
                return

    def _rest(self, seconds: float) -> bool:
        """Let time pass, and call what is urgent meanwhile; returns whether to go on.

        What comes faster than it is called does not keep the others from their turn.
        """
        until = time.monotonic() + seconds
        while True:
            with self._changed:
                left = until - time.monotonic()
                self._changed.wait_for(lambda: self._ended or self._urgent, left)
                if self._ended:
                    return False
                urgent, self._urgent = self._urgent, {}
            if not urgent:
                return True
            for _ in range(2):
                for tick in urgent:
                    _call(tick)
                with self._changed:  # also because a component may report without end
                    if self._changed.wait_for(lambda: self._ended, _AGAIN_SECONDS):
                        return False
            if time.monotonic() >= until:
                return True


def _call(tick: Tick) -> None:
    try:
        tick()
    except Exception:  # noqa: BLE001 - one that fails hurts no other
        _log.exception("a check of OpenRTM failed")
