"""Threads for calls that wait: a pool of workers, lanes of calls one after another, and a timer."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from contextvars import Context, copy_context
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any, Generic, TypeAlias, TypeVar

from attrs import define, field, frozen

from uoarm._raised import LimitedLog, contained, on_failure
from uoarm._support.process_tuning import fit_switch_interval
from uoarm.errors import UoarmError

T = TypeVar("T")
Done: TypeAlias = Callable[[Any, Exception | None], object]
"""Takes what a call returned, or None and what it raised, contained where it is no Exception."""
Job: TypeAlias = Callable[[], None]

_IDLE_SECONDS = 10.0
_LEAST_SECONDS = 0.02
_log = logging.getLogger("uoarm")


class WorkerPoolClosedError(UoarmError):
    """The call had not begun when its pool was closed, and never will."""


@frozen(eq=False)
class _Task(Generic[T]):
    call: Callable[..., T]
    args: tuple[Any, ...]
    done: Done | None
    # That of the thread which asks: whose question it is goes with the question.
    context: Context = field(factory=copy_context)


class WorkerPool:
    """Runs calls in daemon threads, which are started as they are needed and used again.

    A thread that finds nothing more to do waits some seconds for the next call and then ends: to
    start and join one costs several times as much as to wake one. The one that became idle last is
    woken first, so that those that are not needed end.

    Not a pool of `concurrent.futures`, for whose threads the interpreter waits when it ends: a call
    of a component that hangs would keep the process for ever.

    All methods may be called from any thread, and return at once.

    Args:
        name: of the threads.
        limit: threads at most; a call that finds all at work waits for one, in order, so that a
            pool with one thread keeps the order. None: a thread for each call that is under way.
        idle_seconds: how long a thread waits for the next call; 0: it ends at once.
        patience: where calls wait and fewer than one a thread has begun in so many seconds, as
            most are held up, the pool has twice as many threads; None: the limit stands.

    Example:
        >>> pool = WorkerPool("uoarm-describe", limit=4)
        >>> pool.submit(bridge.describe, endpoint, done=lambda result, error: ...)
        True
    """

    def __init__(
        self,
        name: str,
        limit: int | None = None,
        *,
        idle_seconds: float = _IDLE_SECONDS,
        patience: float | None = None,
    ) -> None:
        self._records = LimitedLog(_log)
        self._name = name
        self._limit = float("inf") if limit is None else limit
        self._idle_seconds = idle_seconds
        self._patience = patience
        self._is_watched = False  # whether a thread looks whether those that wait get on
        self._begun = 0  # calls that had waited
        self._closing = threading.Event()
        self._lock = threading.Lock()
        self._waiting: deque[_Task[Any]] = deque()
        self._idle: list[SimpleQueue[_Task[Any] | None]] = []
        self._threads = 0
        self._beginning = False  # whether a thread begins that has no task
        self._busy = 0
        self._closed = False

    @property
    def busy(self) -> int:
        """Calls that are under way or wait for a thread."""
        return self._busy

    @property
    def closed(self) -> bool:
        return self._closed

    def submit(
        self, call: Callable[..., T], *args: Any, done: Done | None = None, queue: bool = True
    ) -> bool:
        """Have a call run in a thread of the pool.

        Args:
            call: what may wait.
            args: handed to it.
            done: called once, in the call's thread, when the call does not count as busy any more:
                a caller that learns of an end through it finds room for the next. What it raises is
                logged; without it, what the call raises is.
            queue: False to refuse the call, rather than let it wait, where all threads are at work.

        Returns:
            Whether the call was taken: False where the pool is closed or, without `queue`, full;
            then nothing is called.

        Raises:
            RuntimeError: the system gives no more threads.
        """
        task = _Task(call, args, done)
        with self._lock:
            if self._closed or (not queue and self._busy >= self._limit):
                return False
            self._busy += 1
            if self._idle:
                self._idle.pop().put(task)
                return True
            if self._threads >= self._limit:
                self._waiting.append(task)
                if self._patience is not None and not self._is_watched:
                    self._begin_to_watch(self._patience)
                return True
            self._threads += 1
        try:
            self._start(task)
        except RuntimeError:
            with self._lock:
                self._threads -= 1
                self._busy -= 1
            raise
        return True

    def close(self, *, drop: bool = True) -> int:
        """Take no more calls, and let idle threads end; what is under way goes on. Idempotent.

        Args:
            drop: drop the calls that have not begun: the `done` of each gets a
                `WorkerPoolClosedError`, in this thread. Otherwise they are run first.

        Returns:
            How many were dropped.
        """
        dropped: list[_Task[Any]] = []
        with self._lock:
            self._closed = True
            self._closing.set()
            while self._idle:
                self._idle.pop().put(None)
            if drop:
                dropped.extend(self._waiting)
                self._waiting.clear()
                self._busy -= len(dropped)
        error = WorkerPoolClosedError(f"{self._name} was closed before the call began")
        for task in dropped:
            self._conclude(task, None, error)
        return len(dropped)

    def _start(self, task: _Task[Any] | None) -> None:
        """Start a thread, already counted, that begins with a task; None: it waits for one."""
        inbox: SimpleQueue[_Task[Any] | None] = SimpleQueue()
        if task is not None:
            inbox.put(task)  # not an argument of the thread, which would hold it until its end
        work = partial(self._work, inbox, begins=task is not None)
        PoolThread(self, target=work, name=self._name, daemon=True).start()
        fit_switch_interval()

    def _begin_to_watch(self, patience: float) -> None:
        """Have a thread watch those that wait; the caller holds the lock."""
        watch = partial(self._watch, patience)
        thread = threading.Thread(target=watch, name=f"{self._name}-watch", daemon=True)
        with suppress(RuntimeError):  # the system gives no more: then the next that waits tries
            thread.start()
            self._is_watched = True

    def _watch(self, patience: float) -> None:
        """Have more threads as long as calls wait and do not get on; ends when none waits."""
        while True:
            with self._lock:
                begun, more = self._begun, int(self._threads)
                if not self._waiting:
                    self._is_watched = False
                    return
            self._closing.wait(patience)
            with self._lock:
                is_last = self._closed
                if not self._waiting or (not is_last and self._begun - begun >= more):
                    continue
                # What is left at the end has no later chance: a thread for each.
                more = len(self._waiting) if is_last else min(more, len(self._waiting))
                self._threads += more
            for left in range(more, 0, -1):
                try:
                    self._start(None)
                except RuntimeError:  # the system gives no more: those that there are go on
                    with self._lock:
                        self._threads -= left
                    break
            if is_last:
                return

    def prepare(self) -> None:
        """Have a thread wait, so that the next call need not wait for the start of one."""
        with self._lock:
            is_there = self._idle or self._beginning
            if is_there or self._closed or self._threads >= self._limit:
                return
            self._threads += 1
            self._beginning = True
        try:
            self._start(None)
        except RuntimeError:  # the system gives no more: then the next call starts its own
            with self._lock:
                self._threads -= 1
                self._beginning = False

    def _work(self, inbox: SimpleQueue[_Task[Any] | None], *, begins: bool) -> None:
        task = inbox.get() if begins else self._next(inbox, is_first=True)
        while task is not None:
            result, error = None, None
            try:
                result = task.context.run(task.call, *task.args)
            except BaseException as raised:  # noqa: BLE001 - whatever it is, the thread goes on
                error = contained(raised)
            with self._lock:
                self._busy -= 1
            self._conclude(task, result, error)
            del task, result, error  # with what they hold, before this waits for the next
            task = self._next(inbox)
        fit_switch_interval()

    def _next(
        self, inbox: SimpleQueue[_Task[Any] | None], *, is_first: bool = False
    ) -> _Task[Any] | None:
        """Wait for a task; None ends the thread."""
        with self._lock:
            self._beginning = self._beginning and not is_first
            if self._waiting:
                self._begun += 1
                return self._waiting.popleft()
            if self._closed or not self._idle_seconds:
                self._threads -= 1
                return None
            self._idle.append(inbox)
        # Where no time is left when it is looked at again, CPython 3.10 to 3.12 waits without a
        # limit: such a thread stays, and the next call or the end of the pool wakes it.
        try:
            return inbox.get(timeout=self._idle_seconds)
        except Empty:
            pass
        with self._lock:
            if inbox in self._idle:
                self._idle.remove(inbox)
                self._threads -= 1
                return None
        return inbox.get_nowait()  # handed over, under the lock, when the wait had just ended

    def _conclude(self, task: _Task[Any], result: object, error: Exception | None) -> None:
        if task.done is None:
            if error is not None and not isinstance(error, WorkerPoolClosedError):
                text = f"a call in a thread of {self._name} failed"
                self._records.write(logging.ERROR, text, error)
            return
        try:
            task.done(result, error)
        except BaseException as raised:  # noqa: BLE001 - whatever it is, the thread goes on
            text = f"the callback of a call in a thread of {self._name} failed"
            self._records.write(logging.ERROR, text, raised)


class PoolThread(threading.Thread):
    """A thread of a pool, of which one may see that it only waits for the next call."""

    def __init__(self, pool: WorkerPool, **given: Any) -> None:
        super().__init__(**given)
        self._pool = pool

    @property
    def is_idle(self) -> bool:
        """Whether nothing is to be done in its pool, so that it ends by itself in some seconds."""
        return not (self._pool.busy or self._pool.closed)


class WorkerExecutor(ThreadPoolExecutor):
    """A pool of workers where an executor is wanted; an event loop takes this class as its default.

    It goes on when the main thread has ended and others of the application live on, which other
    executors do not, and the interpreter does not wait for a call that hangs. (CPython 3.12.0 to
    3.12.2 start no thread then: python/cpython#113964.)

    Args:
        name: of the threads.
        limit: threads at most, as with `WorkerPool`.
    """

    def __init__(self, name: str, limit: int | None = None) -> None:
        # Nothing of the base is used: it begins with the first call that it is given.
        self._pool = WorkerPool(name, limit)

    def submit(self, call: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:
        """Have a call run in a thread of the pool.

        Raises:
            RuntimeError: it was shut down, or the system gives no more threads.
        """
        future: Future[T] = Future()

        def done(_: Any, error: Exception | None) -> None:
            if isinstance(error, WorkerPoolClosedError):
                future.cancel()

        if not self._pool.submit(settle, future, partial(call, *args, **kwargs), done=done):
            raise RuntimeError("cannot begin a call: its threads were shut down")
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:  # noqa: ARG002, FBT001, FBT002 - as the base has it
        """Take no more calls. Idempotent; waits for none, not even where it is asked to."""
        self._pool.close(drop=cancel_futures)


def settle(future: Future[T], call: Callable[[], T]) -> None:
    """Run a call, and have a future get its end; nothing where that was cancelled."""
    if not future.set_running_or_notify_cancel():
        return
    try:
        result = call()
    except BaseException as error:  # noqa: BLE001 - of who waits for the future
        future.set_exception(contained(error))
        del future  # its error has this frame
    else:
        future.set_result(result)


@frozen
class _Reply:
    """The reply that the driver of a lane waits for."""

    error: BaseException | None


@define(eq=False)
class _Lane:
    """Jobs, and whether a thread is doing them or waits for them.

    Attributes:
        are_quick: says of each job whether it is quick.
        is_waited_for: whether nothing is to be done in it yet.
    """

    jobs: SimpleQueue[Job | _Reply] = field(factory=SimpleQueue)
    is_driven: bool = False
    has_begun: bool = False
    are_quick: tuple[Callable[[], bool], ...] = ()
    is_waited_for: bool = True


class Lanes:
    """Does the jobs of each lane one after another, those of several lanes at the same time.

    Args:
        start: begins a call in a worker thread; it neither waits for it nor raises.
    """

    def __init__(self, start: Callable[[Job], None]) -> None:
        self._start = start
        # Guards the table, and whether a thread does the jobs of a lane: one that is put just as
        # its lane is found empty would be done by no thread.
        self._lock = threading.Lock()
        self._lanes: dict[str, _Lane] = {}

    def reserve(self, name: str) -> None:
        """Leave what comes into a new lane to a call of `drive`."""
        # Before the event that puts the first job, as a lane that is not there is a worker's.
        with self._lock:
            self._lanes[name] = _Lane(is_driven=True)

    def put(self, name: str, job: Job, *, is_quick: Callable[[], bool] | None = None) -> None:
        """Have a job done after the others of its lane. Waits for nothing.

        Args:
            name: of the lane.
            job: to be done; it raises nothing.
            is_quick: says whether it calls nothing that may hang; None: it may.
        """
        with self._lock:
            lane = self._lanes.get(name)
            if lane is None:
                lane = self._lanes[name] = _Lane()
            # Under the lock of the last look of who serves: it finds this job, or the lane is gone
            # by now.
            lane.jobs.put(job)
            lane.are_quick = (*lane.are_quick, is_quick or _never)
            lane.is_waited_for = False
            if lane.is_driven:
                return
            lane.is_driven = True
        self._start(partial(self._serve, name, lane))

    def reply(self, name: str, error: BaseException | None) -> None:
        """End the `drive` of a lane after the jobs that are in it; nothing where there is none."""
        with self._lock:
            lane = self._lanes.get(name)
            if lane is not None:
                lane.jobs.put(_Reply(error))
                lane.is_waited_for = False

    def drive(self, name: str) -> None:
        """Do the jobs of a lane that was reserved, in this thread, until the reply.

        Where that is interrupted, a worker thread goes on. Does nothing where the lane was
        abandoned before.

        Raises:
            BaseException: the error of the reply.
        """
        with self._lock:
            lane = self._lanes.get(name)
            # This thread may have been given up before it began: the worker takes the reply, too.
            if lane is None or lane.has_begun:
                return
            lane.has_begun = True
        # The reply is a job among the others: what was put before it is done before it.
        with on_failure(self._start, partial(self._serve, name, lane)):
            while not isinstance(job := lane.jobs.get(), _Reply):
                job()
        self._end(name, job)

    def drive_quick(self, name: str) -> bool:
        """Do the jobs of a lane that was reserved, where there are some and all are quick.

        Returns:
            Whether that was all; False: the rest, or all of it, is for `drive`, with a time limit.

        Raises:
            BaseException: the error of the reply.
        """
        with self._lock:
            lane = self._lanes[name]
            are_quick = () if lane.is_waited_for else lane.are_quick
        if not (are_quick and all(is_quick() for is_quick in are_quick)):
            return False
        # Where what was quick to open has died by now, another plan is sought, and a wait for that
        # needs a time limit.
        while not lane.jobs.empty():
            if isinstance(job := lane.jobs.get_nowait(), _Reply):
                self._end(name, job)
                return True
            job()
        return False

    def _end(self, name: str, reply: _Reply) -> None:
        with self._lock:
            del self._lanes[name]
        if reply.error is not None:
            raise reply.error

    def abandon(self, name: str) -> None:
        """Have a worker thread do the jobs of a lane that was reserved, unless `drive` began."""
        with self._lock:
            lane = self._lanes.get(name)
            # Exactly one thread does its jobs: the caller's where that came first, else a worker.
            if lane is None or lane.has_begun:
                return
            lane.has_begun = True
        self._start(partial(self._serve, name, lane))

    def _serve(self, name: str, lane: _Lane) -> None:
        while True:
            try:
                job = lane.jobs.get_nowait()
            except Empty:
                # Looked at again with the lock, with which jobs are put: one that comes now finds
                # this lane gone, and begins another.
                with self._lock:
                    if lane.jobs.empty():
                        self._lanes.pop(name, None)
                        return
                continue
            if not isinstance(job, _Reply):
                job()


def _never() -> bool:
    return False


class Timer:
    """Calls back at the earliest of the times asked for, then waits to be asked again.

    It may call early where the clock is not the machine's own: what is called looks at the
    clock. Times that lie close together are one call, since each has everything looked at that
    waits. The thread begins with the first time asked for.

    Args:
        reached: called in the timer's thread.
    """

    def __init__(self, clock: Callable[[], float], reached: Callable[[], None]) -> None:
        self._clock = clock
        self._reached = reached
        # Guards the one time that is waited for. No list of times: what is not yet due is said so
        # again.
        self._changed = threading.Condition(threading.Lock())
        self._due: float | None = None
        self._is_closed = False
        self._thread: threading.Thread | None = None

    def wake_at(self, time: float) -> None:
        """Call back at this time, or at an earlier one asked for. Any thread.

        Raises:
            RuntimeError: the system gives no thread; it is not waited for.
        """
        with self._changed:
            if self._is_closed or (self._due is not None and self._due <= time):
                return
            if self._thread is None:
                thread = threading.Thread(target=self._run, name="uoarm-control", daemon=True)
                thread.start()
                self._thread = thread
            self._due = time
            self._changed.notify()

    def close(self) -> None:
        """Call back no more. Idempotent."""
        with self._changed:
            self._is_closed = True
            self._changed.notify()

    def _run(self) -> None:
        while self._wait():
            self._reached()

    def _wait(self) -> bool:
        """Wait until the earliest time; False when there will be none."""
        with self._changed:
            while not self._is_closed:
                if self._due is None:
                    self._changed.wait()
                    continue
                seconds = max(_LEAST_SECONDS, self._due - self._clock())
                if not self._changed.wait(seconds):
                    self._due = None
                    return True
            return False
