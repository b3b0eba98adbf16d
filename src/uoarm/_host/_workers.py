"""Threads that work out the answers to requests, so that the link's own thread never waits."""

from __future__ import annotations

from collections.abc import Callable
from threading import BoundedSemaphore
from typing import Any

from uoarm._host._daemons import DaemonThreads
from uoarm._host._link import Reply
from uoarm.errors import BridgeError, FailureReason

__all__ = ["Workers"]

_AT_ONCE = 64


class Workers:
    """Answers at most 64 requests at a time, each in a thread; more are refused at once."""

    def __init__(self, name: str) -> None:
        self._threads = DaemonThreads(name, _AT_ONCE)
        self._room = BoundedSemaphore(_AT_ONCE)

    def answer(self, reply: Reply, action: Callable[[], Any]) -> None:
        """Reply with what the action returns or raises; returns at once.

        Raises:
            BridgeError: every thread is busy, or it is closed.
        """
        if not self._room.acquire(blocking=False):
            text = f"{_AT_ONCE} requests are being answered already"
            raise BridgeError(text, FailureReason.UNAVAILABLE)
        if not self._threads.submit(lambda: self._work(reply, action)):
            raise BridgeError("requests are not answered any more", FailureReason.CLOSED)

    def close(self) -> None:
        """Take no more; what is under way ends alone."""
        self._threads.close()

    def _work(self, reply: Reply, action: Callable[[], Any]) -> None:
        try:
            answer = action()
        except BaseException as error:  # noqa: BLE001 - whatever it is, the other end is told
            answer = error
        finally:
            self._room.release()
        reply(answer)
