"""The threads of the control plane: lanes of calls, the timer, and the dispatcher of its events."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from functools import partial
from queue import Empty, SimpleQueue
from typing import TypeAlias, TypeVar

from attrs import define, field, frozen

from uoarm._dataplane import Clock
from uoarm._raised import LimitedLog, foreign
from uoarm.model import StatusEvent

__all__ = ["EventDispatcher", "Job", "Lanes", "Timer", "keep_newest"]

Job: TypeAlias = Callable[[], None]
T = TypeVar("T")


@frozen
class _Done:
    """The reply that the driver of a lane waits for."""

    error: BaseException | None


@define(eq=False)
class _Lane:
    """Jobs, and whether a thread is doing them or waits for them.

    Attributes:
        are_quick: says of each job whether it is quick.
        is_waited_for: whether nothing is to be done in it yet.
    """

    jobs: SimpleQueue[Job | _Done] = field(factory=SimpleQueue)
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
                lane.jobs.put(_Done(error))
                lane.is_waited_for = False

    def drive(self, name: str) -> None:
        """Do the jobs of a lane that was reserved, in this thread, until the reply.

        Where that is interrupted, a worker thread goes on.

        Raises:
            BaseException: the error of the reply.
        """
        with self._lock:
            lane = self._lanes[name]
            lane.has_begun = True
        # The reply is a job among the others: what was put before it is done before it.
        try:
            while not isinstance(job := lane.jobs.get(), _Done):
                job()
        except BaseException:
            self._start(partial(self._serve, name, lane))
            raise
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
            if isinstance(job := lane.jobs.get_nowait(), _Done):
                self._end(name, job)
                return True
            job()
        return False

    def _end(self, name: str, reply: _Done) -> None:
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
            if not isinstance(job, _Done):
                job()


def _never() -> bool:
    return False


_LEAST_SECONDS = 0.02


class Timer:
    """Calls back at the earliest of the times asked for, then waits to be asked again.

    It may call early where the clock is not the machine's own: what is called looks at the
    clock. Times that lie close together are one call, since each has everything looked at that
    waits. The thread begins with the first time asked for.

    Args:
        reached: called in the timer's thread.
    """

    def __init__(self, clock: Clock, reached: Callable[[], None]) -> None:
        self._clock = clock
        self._reached = reached
        # Guards the one time that is waited for. No list of times: what is not yet due is said so
        # again.
        self._changed = threading.Condition(threading.Lock())
        self._due: float | None = None
        self._is_closed = False
        self._thread: threading.Thread | None = None

    def wake_at(self, time: float) -> None:
        """Call back at this time, or at an earlier one asked for. Any thread."""
        with self._changed:
            if self._is_closed or (self._due is not None and self._due <= time):
                return
            self._due = time
            self._changed.notify()
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, name="uoarm-control", daemon=True)
                self._thread.start()

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


_log = logging.getLogger("uoarm")
_CLOSE_SECONDS = 2.0
_RECORDED = frozenset({"lost", "failed", "replaced"})
_BURST = 20


class EventDispatcher:
    """Numbers events and calls listeners, in a thread of its own: nothing waits for a listener.

    The thread begins with the first listener, and is woken only while there are some. Deaths and
    takeovers have a record in the log each, written by the same thread: at most twenty in ten
    seconds for a component or a bridge, and for all connections together.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        # Held from the number of an event to its place in the queue: listeners get them in order.
        # None is called with it.
        self._lock = threading.Lock()
        self._number = 0
        self._listeners: tuple[Callable[[StatusEvent], None], ...] = ()
        self._events: SimpleQueue[StatusEvent | None] = SimpleQueue()
        self._thread: threading.Thread | None = None
        self._records: dict[str, LimitedLog] = {}

    def post(self, subject: str, change: str, cause: str = "", function: str = "") -> None:
        """Number one change and have the listeners called. Waits for nothing."""
        with self._lock:
            self._number += 1
            if self._listeners or change in _RECORDED:
                self._start()
                now = self._clock()
                event = StatusEvent(self._number, now, subject, change, cause, function)
                self._events.put(event)

    def listen(self, listener: Callable[[StatusEvent], None]) -> Callable[[], None]:
        """Call a listener for every change from now on; returns what ends that."""
        with self._lock:
            self._listeners = (*self._listeners, listener)
            self._start()

        def end() -> None:
            with self._lock:
                self._listeners = tuple(
                    callback for callback in self._listeners if callback is not listener
                )

        return end

    def close(self) -> None:
        """Call listeners for what is left, then end. Waits two seconds at most."""
        self._events.put(None)
        thread = self._thread
        if thread is not None and threading.current_thread() is not thread:
            thread.join(_CLOSE_SECONDS)

    def _start(self) -> None:
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="uoarm-events", daemon=True)
            self._thread.start()

    def _record(self, event: StatusEvent) -> None:
        kind, _, name = event.subject.partition(" ")
        key = f"{event.change} {kind if kind == 'connection' else event.subject}"
        log = self._records.get(key)
        if log is None:
            logger = f"uoarm.component.{name}" if kind == "component" else "uoarm"
            log = LimitedLog(logger, _BURST)
        keep_newest(self._records, key, log)
        log.write(logging.WARNING, f"{event.subject} {event.change}: {event.cause}")

    def _run(self) -> None:
        while (event := self._events.get()) is not None:
            if event.change in _RECORDED:
                self._record(event)
            self._notify(event)

    def _notify(self, event: StatusEvent) -> None:
        # Apart from what waits: its frame would keep the last listener, that has left or not.
        for listener in self._listeners:
            try:
                foreign(listener, event)
            except Exception:  # noqa: BLE001 - a listener may raise anything
                _log.exception("listener %r failed at event %d", listener, event.number)


# Names of discovered components come and go for ever: what is counted by name needs a bound.
_NAMES = 1000


def keep_newest(by_name: dict[str, T], name: str, value: T) -> None:
    """Set a value, and forget those that were set longest ago: names come and go for ever."""
    by_name.pop(name, None)
    by_name[name] = value
    while len(by_name) > _NAMES:
        del by_name[next(iter(by_name))]
