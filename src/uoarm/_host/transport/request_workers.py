"""Answers to requests, each worked out in a thread, so that the link's own never waits."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from uoarm._host.transport.transport import Reply
from uoarm._workers import WorkerPool
from uoarm.errors import BridgeError, FailureReason

__all__ = ["RequestWorkers"]

_AT_ONCE = 64


class RequestWorkers:
    """Answers at most 64 requests at a time; more are refused at once."""

    def __init__(self, name: str) -> None:
        self._pool = WorkerPool(name, _AT_ONCE)

    def answer(self, reply: Reply, action: Callable[[], Any]) -> None:
        """Reply with what the action returns or raises; returns at once.

        Raises:
            BridgeError: every thread is busy, or it is closed.
        """

        def done(answer: object, error: BaseException | None) -> None:
            reply(answer if error is None else error)

        if not self._pool.submit(action, done=done, queue=False):
            if self._pool.closed:
                raise BridgeError("requests are not answered any more", FailureReason.CLOSED)
            text = f"{_AT_ONCE} requests are being answered already"
            raise BridgeError(text, FailureReason.UNAVAILABLE)

    def close(self) -> None:
        """Take no more; what is under way is answered still."""
        self._pool.close()
