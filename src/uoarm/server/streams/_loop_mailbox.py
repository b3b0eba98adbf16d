"""The one way from other threads into the server's loop: one wake-up, whatever has come."""

from __future__ import annotations

import asyncio
import logging
import time
from collections import deque
from collections.abc import Callable

from uoarm._raised import foreign

__all__ = ["LoopMailbox"]

_TURN_SECONDS = 0.002
_log = logging.getLogger("uoarm.server")


class LoopMailbox:
    """Runs actions of other threads in the loop's thread, in order.

    However many come before the loop gets to them, it is woken once. One that fails is logged, and
    those after it run all the same. What takes longer than a moment together waits for the loop's
    next turns, so that what has come over a socket meanwhile goes between.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._actions: deque[Callable[[], None]] = deque()
        self._woken = False

    def put(self, action: Callable[[], None]) -> None:
        """Have an action run in the loop. From any thread; after the loop's end it is lost."""
        self._actions.append(action)
        if not self._woken:
            self._woken = True
            try:
                self._loop.call_soon_threadsafe(self._run)
            except RuntimeError:  # the loop is closed: nobody is left to notify
                self._actions.clear()
                self._woken = False

    def _run(self) -> None:
        self._woken = False
        end = time.perf_counter() + _TURN_SECONDS
        for _ in range(len(self._actions)):
            if time.perf_counter() >= end:
                self._woken = True
                self._loop.call_soon(self._run)
                return
            action = self._actions.popleft()
            try:
                foreign(action)
            except Exception:  # noqa: BLE001 - those after it must not wait for the next wake-up
                _log.exception("an action in the server's loop failed")
