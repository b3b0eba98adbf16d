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


class BusyError(UoarmError):
    """Every worker is taken; nothing was begun. Ask again later."""


class Workers:
    """Daemon threads, started as they are needed, up to a limit.

    Daemon, because a bridge that hangs must not keep the process from ending.

    Args:
        limit: threads at most; a job that finds none free is refused, never queued.
        hop: brings results back into the loop.
    """

    def __init__(self, limit: int, hop: Hop) -> None:
        self._limit = limit
        self._hop = hop
        self._jobs: SimpleQueue[Callable[[], None] | None] = SimpleQueue()
        self._threads = 0
        self._busy = 0

    @property
    def busy(self) -> int:
        """Jobs under way."""
        return self._busy

    def start(self, action: Callable[[], T], *, always: bool = False) -> asyncio.Future[T]:
        """Run an action in a worker; the future has its result. Only from the loop's thread.

        Args:
            action: what waits.
            always: begin it also when all workers are taken, for what frees something.

        Raises:
            BusyError: no worker is free.
        """
        if self._busy >= self._limit and not always:
            raise BusyError(f"all {self._limit} workers are taken by requests that still wait")
        future: asyncio.Future[T] = asyncio.get_running_loop().create_future()
        self._busy += 1
        self._jobs.put(lambda: self._work(action, future))
        if self._threads < self._busy:
            self._threads += 1
            name = f"uoarm-serve-{self._threads}"
            threading.Thread(target=self._serve, name=name, daemon=True).start()
        return future

    def close(self) -> None:
        """Let idle threads end; those at work end after it."""
        for _ in range(self._threads):
            self._jobs.put(None)

    def _serve(self) -> None:
        while (job := self._jobs.get()) is not None:
            job()

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
        self._busy -= 1
        if not future.done():
            with contextlib.suppress(asyncio.InvalidStateError):
                conclude(outcome)
