"""Threads for calls that wait, so that the loop never does."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any, TypeVar

from uoarm.errors import UoarmError
from uoarm.server._hop import Hop

__all__ = ["BusyError", "Workers"]

T = TypeVar("T")
_FREEING = 16


class BusyError(UoarmError):
    """Every worker is taken; nothing was begun. Ask again later."""


class Workers:
    """Daemon threads for jobs that wait, and some of their own for what frees something.

    Daemon, because a bridge that hangs must not keep the process from ending.

    Args:
        limit: jobs at one time; one that finds no thread free is refused, never queued.
        hop: brings results back into the loop.
    """

    def __init__(self, limit: int, hop: Hop) -> None:
        self._limit = limit
        self._asking = _Threads("uoarm-serve", limit, hop)
        self._freeing = _Threads("uoarm-serve-free", _FREEING, hop)

    @property
    def busy(self) -> int:
        """Jobs under way or waiting for a thread."""
        return self._asking.busy + self._freeing.busy

    def start(self, action: Callable[[], T], *, always: bool = False) -> asyncio.Future[T]:
        """Run an action in a worker; the future has its result. Only from the loop's thread.

        Args:
            action: what waits.
            always: let it wait for a thread rather than refuse it; for what goes on.

        Raises:
            BusyError: no worker is free.
        """
        if self._asking.busy >= self._limit and not always:
            raise BusyError(f"all {self._limit} workers are taken by requests that still wait")
        return self._asking.put(action)

    def free(self, action: Callable[[], T]) -> asyncio.Future[T]:
        """Run an action that frees something, when all workers are taken, too.

        Never refused; it waits for those before it. Each is bounded in time by itself, and the
        caller bounds how many there are.
        """
        return self._freeing.put(action)

    def close(self) -> None:
        """Let idle threads end; those at work end after it."""
        self._asking.close()
        self._freeing.close()


class _Threads:
    """Threads started as they are needed, up to a number; further jobs wait in order."""

    def __init__(self, name: str, most: int, hop: Hop) -> None:
        self._name = name
        self._most = most
        self._hop = hop
        self._jobs: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._started = 0
        self.busy = 0

    def put(self, action: Callable[[], T]) -> asyncio.Future[T]:
        future: asyncio.Future[T] = asyncio.get_running_loop().create_future()
        self.busy += 1
        self._jobs.put(lambda: self._work(action, future))
        if self._started < min(self.busy, self._most):
            self._started += 1
            name = f"{self._name}-{self._started}"
            threading.Thread(target=self._serve, name=name, daemon=True).start()
        return future

    def close(self) -> None:
        for _ in range(self._started):
            self._jobs.put(None)

    def _serve(self) -> None:
        while (job := self._jobs.get()) is not None:
            job()
            del job  # with what it holds

    def _work(self, action: Callable[[], T], future: asyncio.Future[T]) -> None:
        try:
            result = action()
        except BaseException as error:  # noqa: BLE001 - handed to whoever awaits
            failure = error
            self._hop.put(lambda: self._finish(future, future.set_exception, failure))
        else:
            self._hop.put(lambda: self._finish(future, future.set_result, result))

    def _finish(
        self, future: asyncio.Future[T], conclude: Callable[[Any], None], outcome: object
    ) -> None:
        self.busy -= 1
        if not future.done():
            with contextlib.suppress(asyncio.InvalidStateError):
                conclude(outcome)
