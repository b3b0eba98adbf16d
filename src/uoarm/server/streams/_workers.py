"""Threads for calls that wait, so that the loop never does."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from typing import TypeVar

from uoarm._workers import WorkerPool
from uoarm.server._failures import BusyError
from uoarm.server.streams._loop_mailbox import LoopMailbox
from uoarm.server.streams._opening_turns import OpeningTurns

__all__ = ["Workers"]

T = TypeVar("T")
_FREEING = 16


class Workers:
    """Daemon threads for jobs that wait: for calls, for what opens, frees or stops something.

    Daemon, because a bridge that hangs must not keep the process from ending.

    Args:
        limit: calls at one time; one that finds no thread free is refused, never queued.
        openings: what is being opened at one time; the others wait, see `OpeningTurns`.
        mailbox: brings results back into the loop.
    """

    def __init__(self, limit: int, openings: int, mailbox: LoopMailbox) -> None:
        self._limit = limit
        self._mailbox = mailbox
        self._asking = WorkerPool("uoarm-serve-call", limit)
        self._opening = WorkerPool("uoarm-serve-open", openings)
        self._freeing = WorkerPool("uoarm-serve-free", _FREEING)
        self._stopping = WorkerPool("uoarm-serve-stop")
        self._turns = OpeningTurns(openings)
        self._to_open: deque[Callable[[], None]] = deque()
        self._look: asyncio.TimerHandle | None = None

    @property
    def busy(self) -> int:
        """Jobs under way or waiting for a thread."""
        opening = self._opening.busy + len(self._to_open)
        return self._asking.busy + opening + self._freeing.busy

    def start(self, action: Callable[[], T], *, always: bool = False) -> asyncio.Future[T]:
        """Run an action in a worker; the future has its result. Only from the loop's thread.

        Args:
            action: what waits.
            always: let it wait for a thread rather than refuse it; for what goes on.

        Raises:
            BusyError: no worker is free.
        """
        return self._submit(self._asking, action, queue=always)

    def open(self, action: Callable[[], T]) -> asyncio.Future[T]:
        """Run an action that opens something; it waits for its turn after those before it.

        Each is bounded in time by itself, and the caller bounds how many there are.

        Raises:
            BusyError: the server is closing.
        """
        if self._opening.closed:
            raise _closing()
        future: asyncio.Future[T] = asyncio.get_running_loop().create_future()
        self._to_open.append(lambda: self._begin(action, future))
        self._open_next()
        return future

    def free(self, action: Callable[[], T]) -> asyncio.Future[T]:
        """Run an action that frees something, when all workers are taken, too.

        Never refused; it waits for those before it. Each is bounded in time by itself, and the
        caller bounds how many there are.
        """
        return self._submit(self._freeing, action, queue=True)

    def stop(self, action: Callable[[], T]) -> asyncio.Future[T]:
        """Run what stops the robot, or lets it go on: at once, whatever the other threads wait for.

        The caller bounds how many there are.

        Raises:
            BusyError: the server is closing.
        """
        return self._submit(self._stopping, action, queue=True)

    def close(self) -> None:
        """Start no more actions; those that were taken are done still. Idempotent."""
        while self._to_open:
            self._to_open.popleft()()
        self._asking.close(drop=False)
        self._opening.close(drop=False)
        self._stopping.close(drop=False)
        self._freeing.close(drop=False)
        # What was being opened until now is to be freed still, by threads that do not stay.
        self._freeing = WorkerPool("uoarm-serve-free", _FREEING, idle_seconds=0)

    def _begin(self, action: Callable[[], T], future: asyncio.Future[T]) -> None:
        self._turns.begin(future, asyncio.get_running_loop().time())

        def done(result: T, error: BaseException | None) -> None:
            self._mailbox.put(lambda: self._opened(future, result, error))

        self._opening.submit(action, done=done)

    def _opened(self, future: asyncio.Future[T], result: T, error: BaseException | None) -> None:
        self._turns.end(future)
        _finish(future, result, error)
        self._open_next()

    def _open_next(self) -> None:
        """Begin what may begin, and look again when some of it may be found to wait."""
        while self._to_open and self._turns.may_begin:
            self._to_open.popleft()()
        if self._to_open and self._look is None:
            loop = asyncio.get_running_loop()
            due = loop.time() + self._turns.look_seconds
            self._look = loop.call_at(due, self._look_again, due)

    def _look_again(self, due: float) -> None:
        self._look = None
        self._turns.look(due, asyncio.get_running_loop().time())
        self._open_next()

    def _submit(
        self, pool: WorkerPool, action: Callable[[], T], *, queue: bool
    ) -> asyncio.Future[T]:
        future: asyncio.Future[T] = asyncio.get_running_loop().create_future()

        def done(result: T, error: BaseException | None) -> None:
            self._mailbox.put(lambda: _finish(future, result, error))

        if not pool.submit(action, done=done, queue=queue):
            if pool.closed:
                raise _closing()
            raise BusyError(f"all {self._limit} workers are taken by requests that still wait")
        return future


def _closing() -> BusyError:
    return BusyError("the server is closing")


def _finish(future: asyncio.Future[T], result: T, error: BaseException | None) -> None:
    if future.done():  # nobody waits for it any more
        return
    if error is None:
        future.set_result(result)
    else:
        future.set_exception(error)
