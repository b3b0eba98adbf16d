"""Threads for calls that wait, so that the loop never does."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Hashable
from typing import TypeVar

from uoarm._workers import WorkerPool
from uoarm.server._failures import BusyError
from uoarm.server.streams._loop_mailbox import LoopMailbox
from uoarm.server.streams._opening_turns import OpeningTurns
from uoarm.server.streams._shares import Shares, acting

__all__ = ["Workers"]

T = TypeVar("T")
_FREEING = 16


class Workers:
    """Daemon threads for jobs that wait: for calls, for what opens, frees or stops something.

    Daemon, because a bridge that hangs must not keep the process from ending. Those for calls and
    for what opens are shared: a client that has taken less than an equal part of them has one,
    whatever hangs for others, so that there are at most twice as many threads as said here.

    Args:
        limit: calls at one time; one that finds no thread free is refused, never queued.
        openings: what is being opened at one time; the others wait, see `OpeningTurns`, and those
            of each client have their turn after one of every other.
        mailbox: brings results back into the loop.
    """

    def __init__(self, limit: int, openings: int, mailbox: LoopMailbox) -> None:
        self._limit = limit
        self._mailbox = mailbox
        self._asking = WorkerPool("uoarm-serve-call", 2 * limit)
        self._asked = Shares(limit)
        self._opening = WorkerPool("uoarm-serve-open", 2 * openings)
        self._opened_by = Shares(openings)
        self._freeing = WorkerPool("uoarm-serve-free", _FREEING)
        self._stopping = WorkerPool("uoarm-serve-stop")
        self._turns = OpeningTurns(2 * openings)
        self._to_open: dict[Hashable, deque[Callable[[], None]]] = {}
        self._look: asyncio.TimerHandle | None = None

    @property
    def busy(self) -> int:
        """Jobs under way or waiting for a thread."""
        opening = self._opening.busy + sum(map(len, self._to_open.values()))
        return self._asking.busy + opening + self._freeing.busy

    @property
    def stopping(self) -> int:
        """Stops and releases under way."""
        return self._stopping.busy

    def start(self, action: Callable[[], T], *, always: bool = False) -> asyncio.Future[T]:
        """Run an action in a worker; the future has its result. Only from the loop's thread.

        Args:
            action: what waits.
            always: let it wait for a thread rather than refuse it; for what goes on.

        Raises:
            BusyError: no worker is free.
        """
        owner = acting.get()
        if not always and not self._asked.admits(owner) and not self._asking.closed:
            raise BusyError(f"all {self._limit} workers are taken by requests that still wait")
        self._asked.take(owner)
        try:
            return self._submit(self._asking, action, lambda: self._asked.take(owner, -1))
        except BusyError:
            self._asked.take(owner, -1)
            raise

    def open(self, action: Callable[[], T]) -> asyncio.Future[T]:
        """Run an action that opens something; it waits for its turn after those before it.

        Each is bounded in time by itself, and the caller bounds how many there are.

        Raises:
            BusyError: the server is closing.
        """
        if self._opening.closed:
            raise _closing()
        future: asyncio.Future[T] = asyncio.get_running_loop().create_future()
        owner = acting.get()
        waiting = self._to_open.setdefault(owner, deque())
        waiting.append(lambda: self._begin(action, owner, future))
        self._open_next()
        return future

    def free(self, action: Callable[[], T]) -> asyncio.Future[T]:
        """Run an action that frees something, when all workers are taken, too.

        Never refused; it waits for those before it. Each is bounded in time by itself, and the
        caller bounds how many there are.
        """
        return self._submit(self._freeing, action)

    def stop(self, action: Callable[[], T]) -> asyncio.Future[T]:
        """Run what stops the robot, or lets it go on: at once, whatever the other threads wait for.

        The caller bounds how many there are.

        Raises:
            BusyError: the server is closing.
        """
        return self._submit(self._stopping, action)

    def close(self) -> None:
        """Start no more actions; those that were taken are done still. Idempotent."""
        for waiting in self._to_open.values():
            for begin in waiting:
                begin()
        self._to_open.clear()
        self._asking.close(drop=False)
        self._opening.close(drop=False)
        self._stopping.close(drop=False)
        self._freeing.close(drop=False)
        # What was being opened until now is to be freed still, by threads that do not stay.
        self._freeing = WorkerPool("uoarm-serve-free", _FREEING, idle_seconds=0)

    def _begin(self, action: Callable[[], T], owner: Hashable, future: asyncio.Future[T]) -> None:
        self._turns.begin(future, asyncio.get_running_loop().time())
        self._opened_by.take(owner)

        def done(result: T, error: BaseException | None) -> None:
            self._mailbox.put(lambda: self._opened(owner, future, result, error))

        self._opening.submit(action, done=done)

    def _opened(
        self,
        owner: Hashable,
        future: asyncio.Future[T],
        result: T,
        error: BaseException | None,
    ) -> None:
        self._opened_by.take(owner, -1)
        self._turns.end(future)
        _finish(future, result, error)
        self._open_next()

    def _open_next(self) -> None:
        """Begin what may begin, and look again when some of it may be found to wait."""
        while self._turns.may_begin:
            owner = next(filter(self._opened_by.admits, self._to_open), self)
            if owner is self:
                break
            waiting = self._to_open.pop(owner)
            begin = waiting.popleft()
            if waiting:  # after one of every other
                self._to_open[owner] = waiting
            begin()
        if self._to_open and self._look is None:
            loop = asyncio.get_running_loop()
            due = loop.time() + self._turns.look_seconds
            self._look = loop.call_at(due, self._look_again, due)

    def _look_again(self, due: float) -> None:
        self._look = None
        self._turns.look(due, asyncio.get_running_loop().time())
        self._open_next()

    def _submit(
        self, pool: WorkerPool, action: Callable[[], T], ended: Callable[[], None] = lambda: None
    ) -> asyncio.Future[T]:
        future: asyncio.Future[T] = asyncio.get_running_loop().create_future()

        def finish(result: T, error: BaseException | None) -> None:
            ended()
            _finish(future, result, error)

        if not pool.submit(
            action, done=lambda result, error: self._mailbox.put(lambda: finish(result, error))
        ):
            raise _closing()
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
