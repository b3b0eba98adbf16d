"""Threads for calls that wait, so that the loop never does."""

from __future__ import annotations

import asyncio
import logging
import os
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable, Collection, Hashable, Mapping
from contextlib import suppress
from typing import Any, TypeAlias, TypeVar

from uoarm._raised import LimitedLog, contained
from uoarm._support import deadlines
from uoarm._support.workers import WorkerPool
from uoarm.server._failures import BusyError
from uoarm.server.streams._memory import Shares, acting

_AT_ONCE = 2
_YOUNG_SECONDS = 0.02
_LATE_SECONDS = 0.005


class ThreadTurns:
    """Says when the next job may begin. A plain state for the loop's thread, without a clock.

    A job that waits for a component or for a middleware takes no processor, so that many go side by
    side. Those that compute are no sooner done for it: their threads take the interpreter's lock
    from one another and from the loop, and the more there are, the more of the processor goes into
    that. Which of both it is shows in time: one that has been under way for 20 ms waits, provided
    that the loop itself came to look in time. Where it did not, no thread got the processor, and
    the ages say nothing.

    Args:
        limit: jobs under way, at most.
    """

    look_seconds = _YOUNG_SECONDS
    """When to look again where some could not begin."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._young: dict[object, float] = {}
        self._waiting: set[object] = set()

    @property
    def may_begin(self) -> bool:
        young = len(self._young)
        return young < _AT_ONCE and young + len(self._waiting) < self._limit

    def begin(self, job: object, now: float) -> None:
        """Note that one has begun; its age counts from now on."""
        self._young[job] = now

    def end(self, job: object) -> None:
        self._young.pop(job, None)
        self._waiting.discard(job)

    def look(self, due: float, now: float) -> None:
        """Find out which of them wait instead of computing; `due` is when this was to be called."""
        if now - due > _LATE_SECONDS:
            return
        old = [name for name, begun in self._young.items() if now - begun >= _YOUNG_SECONDS]
        for item in old:
            del self._young[item]
        self._waiting.update(old)


_TURN_SECONDS = 0.002
_log = logging.getLogger("uoarm.server")


class LoopMailbox:
    """Runs actions of other threads in the loop's thread, in order.

    However many come before the loop gets to them, it is woken once. One that fails is logged, and
    those after it run all the same. What takes longer than a moment together waits for the loop's
    next turns, so that what has come over a socket meanwhile goes between.

    On Linux a loop of asyncio is woken by an event of the kernel, in three quarters of the time of
    its own socket pair.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._records = LimitedLog(_log)
        self._loop = loop
        self._actions: deque[Callable[[], None]] = deque()
        self._woken = False
        # Closed when nothing refers to this any more: no thread can write to its number then, which
        # may be another file's.
        self._event: int | None = None
        if hasattr(os, "eventfd") and isinstance(loop, asyncio.SelectorEventLoop):
            self._event = event = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
            weakref.finalize(self, os.close, event).atexit = False
            loop.add_reader(event, self._wake, event)
        # Only of the loop's thread.
        self._is_running = False
        self._last: list[Callable[[], None]] = []

    def put(self, action: Callable[[], None]) -> None:
        """Have an action run in the loop. From any thread; after the loop's end it is lost."""
        # Appended before the flag is looked at, and the flag is cleared before anything is taken:
        # an action that comes in between wakes the loop once too often, never once too seldom.
        self._actions.append(action)
        if not self._woken:
            self._woken = True
            event = self._event
            if event is not None and not self._loop.is_closed():
                os.eventfd_write(event, 1)
                return
            try:
                self._loop.call_soon_threadsafe(self._run)
            except RuntimeError:  # the loop is closed: no client is left to notify
                self._actions.clear()
                self._woken = False

    async def caught_up(self) -> None:
        """Wait until what has been put so far has run. In the loop."""
        ran: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.put(lambda: settle(ran, None, None))
        await ran

    def soon(self, action: Callable[[], None]) -> None:
        """Run an action after those that run now, or in the loop's next turn where none do.

        Only from the loop's thread.
        """
        if self._is_running:
            self._last.append(action)
        else:
            self._loop.call_soon(action)

    def close(self) -> None:
        """Leave the loop, which may go on, with nothing of this; what is put still runs in it.

        Only from the loop's thread.
        """
        event, self._event = self._event, None
        if event is not None:
            self._loop.remove_reader(event)
            self._loop.call_soon(self._run)  # for who has woken it just now

    def _wake(self, event: int) -> None:
        with suppress(BlockingIOError):
            os.eventfd_read(event)
        self._run()

    def _run(self) -> None:
        self._woken, self._is_running = False, True
        end = time.perf_counter() + _TURN_SECONDS
        # As many as there are now: those that come meanwhile have the next turn.
        for _ in range(len(self._actions)):
            # Set, since this turn is asked for here: who puts something need not wake the loop
            # again.
            if time.perf_counter() >= end:
                self._woken = True
                self._loop.call_soon(self._run)
                break
            self._do(self._actions.popleft())
        self._is_running = False
        if self._last:
            last, self._last = self._last, []
            for action in last:
                self._do(action)

    def _do(self, action: Callable[[], None]) -> None:
        try:
            action()
        # As `foreign`, without its call. Those after it must not wait for the next wake-up.
        except BaseException as error:  # noqa: BLE001 - a session of a front end may be in it
            contained(error)
            self._records.write(logging.ERROR, "an action in the server's loop failed", error)


T = TypeVar("T")
CallEnded: TypeAlias = Callable[[Any, "Exception | None"], object]
_FREEING = _LEAVING = 16
_GLANCE_SECONDS = 0.05


class TurnPool:
    """Threads for jobs that open or free something, each of which waits for its turn.

    See `ThreadTurns`; those of each client have their turn after one of every other. All of it is
    for the loop's thread.

    Args:
        name: of the threads.
        limit: jobs under way, where no client needs its share of them; twice as many at most.
        mailbox: brings results back into the loop.
        pool: more for the `WorkerPool`.
    """

    def __init__(self, name: str, limit: int, mailbox: LoopMailbox, **pool: Any) -> None:
        self._mailbox = mailbox
        self._pool = WorkerPool(name, 2 * limit, **pool)
        self._taken = Shares(limit)
        self._turns = ThreadTurns(2 * limit)
        self._waiting: dict[Hashable, deque[Callable[[], None]]] = {}
        self._look: asyncio.TimerHandle | None = None

    @property
    def busy(self) -> int:
        """Jobs under way or waiting for their turn."""
        return self._pool.busy + sum(map(len, self._waiting.values()))

    def submit(self, action: Callable[[], T]) -> asyncio.Future[T]:
        """Run an action after those before it; the future has its result.

        Each is bounded in time by itself, and the caller bounds how many there are.

        Raises:
            BusyError: the server is closing.
        """
        if self._pool.closed:
            raise _closing()
        future: asyncio.Future[T] = asyncio.get_running_loop().create_future()
        owner = acting.get()
        waiting = self._waiting.setdefault(owner, deque())
        waiting.append(lambda: self._begin(action, owner, future))
        self._begin_next()
        return future

    def close(self) -> None:
        """Take no more; those that were taken are done still."""
        for waiting in self._waiting.values():
            for begin in waiting:
                begin()
        # Begun above, not dropped: who waits for one has an answer, and each ends by its own limit.
        self._waiting.clear()
        self._pool.close(drop=False)

    def _begin(self, action: Callable[[], T], owner: Hashable, future: asyncio.Future[T]) -> None:
        # Before the thread gets it, which may be done with it at once.
        self._turns.begin(future, asyncio.get_running_loop().time())
        self._taken.take(owner)

        def done(result: T, error: BaseException | None) -> None:
            self._mailbox.put(lambda: self._end(owner, future, result, error))

        try:
            self._pool.submit(action, done=done)
        except RuntimeError as error:
            # Later, as for any other: who asked for it has no future yet.
            refused = _no_threads(error)
            self._mailbox.put(lambda: self._end(owner, future, None, refused))

    def _end(
        self,
        owner: Hashable,
        future: asyncio.Future[Any],
        result: object,
        error: BaseException | None,
    ) -> None:
        # Given back before the next begins, and before the client goes on, which may open at once.
        self._taken.take(owner, -1)
        self._turns.end(future)
        settle(future, result, error)
        self._begin_next()

    def _begin_next(self) -> None:
        """Begin what may begin, and look again when some of it may be found to wait."""
        while self._turns.may_begin:
            # The first in the order of clients that has less than its share; `self` stands for
            # none.
            owner = next(filter(self._taken.admits, self._waiting), self)
            if owner is self:
                break
            waiting = self._waiting.pop(owner)
            begin = waiting.popleft()
            if waiting:  # after one of every other
                self._waiting[owner] = waiting
            begin()
        if self._waiting and self._look is None:
            loop = asyncio.get_running_loop()
            due = loop.time() + self._turns.look_seconds
            self._look = loop.call_at(due, self._look_again, due)

    def _look_again(self, due: float) -> None:
        self._look = None
        self._turns.look(due, asyncio.get_running_loop().time())
        self._begin_next()


class Workers:
    """Daemon threads for jobs that wait: for calls, for what opens, frees or stops something.

    Daemon, because a bridge that hangs must not keep the process from ending. Those for calls and
    for what opens are shared: a client that has taken less than an equal part of them has one,
    whatever hangs for others, so that there are at most twice as many threads as said here.

    Args:
        limit: calls at one time; one that finds no thread free is refused, never queued.
        openings: what is being opened at one time; the others wait, see `TurnPool`.
        mailbox: brings results back into the loop.
    """

    def __init__(self, limit: int, openings: int, mailbox: LoopMailbox) -> None:
        self._limit = limit
        self._mailbox = mailbox
        self._asking = WorkerPool("uoarm-serve-call", 2 * limit)
        self._asked = Shares(limit)
        self._opening = TurnPool("uoarm-serve-open", openings, mailbox)
        self._freeing = TurnPool("uoarm-serve-free", _FREEING, mailbox)
        self._stopping = WorkerPool("uoarm-serve-stop")
        self._leaving = WorkerPool("uoarm-serve-leave", _LEAVING, patience=_YOUNG_SECONDS)
        self._records = LimitedLog(_log)
        # Calls under way, each with what takes its end. Looked at while there are any.
        self._calls: dict[deadlines.StepUnderWay, tuple[Hashable, CallEnded]] = {}

    @property
    def busy(self) -> int:
        """Jobs under way or waiting for a thread."""
        return self._asking.busy + len(self._calls) + self._opening.busy + self._freeing.busy

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
        if not always:
            self._admit(owner)
        # Taken before the submit: the thread may be done, and give it back, before `submit`
        # returns.
        self._asked.take(owner)
        try:
            return self._submit(self._asking, action, lambda: self._asked.take(owner, -1))
        except BusyError:
            self._asked.take(owner, -1)
            raise

    def call(self, action: Callable[[], object], ended: CallEnded) -> None:
        """Run an action whose steps have limits of their own; one that hangs is given up.

        Only from the loop's thread, in which `ended` is called with what it returned, or raised.

        Raises:
            BusyError: no worker is free, or the server is closing.
        """
        if self._asking.closed:
            raise _closing()
        owner = acting.get()
        self._admit(owner)

        # Where it was given up, `done` is not called any more: each call has one end.
        def done(result: object, error: Exception | None) -> None:
            self._mailbox.put(lambda: self._end_call(step, result, error))

        is_first = not self._calls
        # It may be done in its thread before `step` is assigned: its end is looked up in the loop,
        # after this.
        try:
            step = deadlines.begin("a call", action, done)
        except RuntimeError as error:
            raise _no_threads(error) from error
        self._calls[step] = owner, ended
        self._asked.take(owner)
        if is_first:
            self._look_at_calls(asyncio.get_running_loop())

    def _look_at_calls(self, loop: asyncio.AbstractEventLoop) -> None:
        """Give up what is late, every now and then while there are calls."""
        # A copy: one that is given up is taken out.
        for step in tuple(self._calls):
            error = step.give_up_late()
            if error is not None:
                self._end_call(step, None, error)
        if self._calls:
            loop.call_later(_GLANCE_SECONDS, self._look_at_calls, loop)

    def _end_call(
        self, step: deadlines.StepUnderWay, result: object, error: Exception | None
    ) -> None:
        owner, ended = self._calls.pop(step)
        # Before the client has its answer: it may call again in there.
        self._asked.take(owner, -1)
        ended(result, error)

    def _admit(self, owner: Hashable) -> None:
        if not self._asked.admits(owner) and not self._asking.closed:
            raise BusyError(f"all {self._limit} workers are taken by requests that still wait")

    def open(self, action: Callable[[], T]) -> asyncio.Future[T]:
        """Run an action that opens something, when it is its turn; see `TurnPool.submit`."""
        return self._opening.submit(action)

    def free(self, action: Callable[[], T]) -> asyncio.Future[T]:
        """Run an action that frees something, when all workers are taken, and after a close, too.

        When it is its turn; see `TurnPool.submit`.
        """
        return self._freeing.submit(action)

    def stop(self, action: Callable[[], T]) -> asyncio.Future[T]:
        """Run what stops the robot, or lets it go on: at once, whatever the other threads wait for.

        Never refused; the caller bounds how many there are. Where the system gives no thread it
        runs in the loop: late is better than not at all.
        """
        try:
            return self._submit(self._stopping, action)
        except BusyError:
            future: asyncio.Future[T] = asyncio.get_running_loop().create_future()
            try:
                result = action()
            except Exception as error:  # noqa: BLE001 - given to who asked for it
                future.set_exception(error)
            else:
                future.set_result(result)
            return future

    def leave(self, action: Callable[[], object]) -> None:
        """Run what stops something that a client moved which has gone. From any thread.

        A few side by side, whatever the other threads wait for: a client may move a thousand
        inputs. Those that hang get more threads beside them.
        """
        try:
            self._leaving.submit(action)
        except RuntimeError as error:
            text = "what a client moved is stopped by its lease alone"
            self._records.write(logging.ERROR, text, error)

    def close(self) -> None:
        """Start no more actions; those that were taken are done still. Idempotent."""
        self._asking.close(drop=False)
        self._opening.close()
        self._stopping.close(drop=False)
        self._leaving.close(drop=False)
        self._freeing.close()
        # What was being opened until now is to be freed, and stopped, by threads that do not stay.
        self._freeing = TurnPool("uoarm-serve-free", _FREEING, self._mailbox, idle_seconds=0)
        self._stopping = WorkerPool("uoarm-serve-stop", idle_seconds=0)
        self._leaving = WorkerPool("uoarm-serve-leave", _LEAVING, idle_seconds=0)

    def _submit(
        self, pool: WorkerPool, action: Callable[[], T], ended: Callable[[], None] = lambda: None
    ) -> asyncio.Future[T]:
        future: asyncio.Future[T] = asyncio.get_running_loop().create_future()

        def finish(result: T, error: BaseException | None) -> None:
            ended()
            settle(future, result, error)

        def done(result: T, error: BaseException | None) -> None:
            self._mailbox.put(lambda: finish(result, error))

        try:
            is_taken = pool.submit(action, done=done)
        except RuntimeError as error:
            raise _no_threads(error) from error
        if not is_taken:
            raise _closing()
        return future


def _closing() -> BusyError:
    return BusyError("the server is closing")


def _no_threads(error: RuntimeError) -> BusyError:
    return BusyError(f"the system gives no more threads: {error}")


def settle(future: asyncio.Future[T], result: T, error: BaseException | None) -> None:
    """Give a future its result, or its error, in the thread of its loop."""
    if future.done():  # no client waits for it any more
        return
    if error is None:
        future.set_result(result)
    else:
        future.set_exception(error)


Q = TypeVar("Q", bound=Hashable)
A = TypeVar("A")
Make: TypeAlias = Callable[[Collection[Q]], Mapping[Q, A | Exception]]
"""Answers different questions from one look at the robot, in the thread of the views."""

_LONG_SECONDS = 0.005
_MOST_REST_SECONDS = 0.25


class SharedViews:
    """Answers questions whose cost grows with the robot, so that the loop does not do that work.

    An answer is never of before its question: what is asked while a view is being made waits for
    the next one, together with everything else that is asked until that begins. So however many
    clients ask, each view is made twice at most for all of them.

    There is one thread, since several would only take the interpreter's lock from the loop; it
    rests as long as it has worked. The loop hands out a few answers in each of its turns, since a
    client may get much with each.

    Args:
        mailbox: brings answers back into the loop.
    """

    def __init__(self, mailbox: LoopMailbox) -> None:
        self._mailbox = mailbox
        self._pool = WorkerPool("uoarm-serve-view", 1)
        # Held between the loop, which adds questions, and the thread, which takes all of a view:
        # one that was added later than that must not be lost.
        self._lock = threading.Lock()
        self._asked: dict[Make[Any, Any], dict[Any, list[asyncio.Future[Any]]]] = {}
        self._answered: deque[tuple[asyncio.Future[Any], Any]] = deque()
        self._closed = threading.Event()

    def get(self, make: Make[Q, A], question: Q) -> asyncio.Future[A]:
        """Return the answer to a question; from the loop's thread.

        Args:
            make: answers all questions that have come; the same for all who shall share it. An
                exception in the place of an answer is raised to who asked that.
            question: what is asked.

        Raises:
            BusyError: the server is closing.
        """
        if self._pool.closed:
            raise _closing()
        future: asyncio.Future[A] = asyncio.get_running_loop().create_future()
        with self._lock:
            # Under the lock with the question: two that ask at once must not both find it there
            # already, or no view would be made.
            is_new = make not in self._asked
            self._asked.setdefault(make, {}).setdefault(question, []).append(future)
        if is_new:
            self._pool.submit(lambda: self._make(make))
        return future

    def close(self) -> None:
        """Make nothing more; who waits gets a BusyError."""
        # Ends the rest that the thread takes after a long view.
        self._closed.set()
        self._pool.close()
        with self._lock:
            asked, self._asked = self._asked, {}
        for questions in asked.values():
            self._take(questions, dict.fromkeys(questions, _closing()))

    def _make(self, make: Make[Any, Any]) -> None:
        # Before the look at the robot: what is asked from here on waits for the next view.
        with self._lock:
            questions = self._asked.pop(make, {})
        began = time.perf_counter()
        answers: Mapping[Any, Any]
        try:
            answers = make(questions.keys())
        except BaseException as error:  # noqa: BLE001 - raised to those who asked
            answers = dict.fromkeys(questions, error)
        self._mailbox.put(lambda: self._take(questions, answers))
        took = time.perf_counter() - began
        # The loop, and threads that move data, have the interpreter for as long.
        if took > _LONG_SECONDS:
            self._closed.wait(min(took, _MOST_REST_SECONDS))

    def _take(
        self, questions: Mapping[Any, list[asyncio.Future[Any]]], answers: Mapping[Any, Any]
    ) -> None:
        # Looked at before the answers are added: what waits already has a turn of the loop coming.
        is_idle = not self._answered
        self._answered.extend(
            (future, answers[question])
            for question, futures in questions.items()
            for future in futures
        )
        if is_idle:
            self._hand_out()

    def _hand_out(self) -> None:
        """Wake some of those who wait, and the others in the loop's next turns."""
        for _ in range(min(_AT_ONCE, len(self._answered))):
            future, answer = self._answered.popleft()
            settle(future, answer, answer if isinstance(answer, BaseException) else None)
        if self._answered:
            asyncio.get_running_loop().call_soon(self._hand_out)
