"""Time limits around foreign code: one worker thread a call, given up when it is late.

`run` hands a step to a daemon thread and waits for it no longer than its limit. A step that
itself calls `run` stays in its thread: the waiter then watches the inner step's limit and names
the inner step when it gives up, so that a whole transaction of many steps costs one hop. A step
that the transaction can do without is isolated: it has a thread and a limit of its own.
A step that keeps its limit by itself costs no hop.
A late result is handed to `on_late`, which puts it away. Steps that clean up after a step that
was given up get limits of their own. What hangs for ever keeps its thread, so a step of which too
many hang already is not begun again.
"""

from __future__ import annotations

import logging
import math
import os
import threading
import time
from collections import Counter
from collections.abc import Callable
from typing import Any, Generic, TypeAlias, TypeVar

from uoarm._interrupts import Uninterrupted
from uoarm._raised import Log, contained, foreign, text_of
from uoarm._support.workers import WorkerPool
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason

T = TypeVar("T")

_log = Log("uoarm")
_GLANCE_SECONDS = 0.05
_HANGING_EACH = 16
_HANGING_IN_ALL = 256


class BoundedStep:
    """The name of a step, put together where it is shown: in most steps it never is.

    Args:
        *parts: shown one after another; values that do not change.
    """

    __slots__ = ("_parts",)

    def __init__(self, *parts: object) -> None:
        self._parts = parts

    def __str__(self) -> str:
        return "".join(map(str, self._parts))


class _Hanging:
    """The steps that were given up and go on still, each of which keeps a thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.steps: Counter[str] = Counter()

    def add(self, step: str) -> None:
        with self._lock:
            self.steps[step] += 1

    def remove(self, step: str) -> None:
        with self._lock:
            self.steps -= Counter({step: 1})

    def check(self, step: str | BoundedStep) -> None:
        """Refuse to begin a step of which too many hang."""
        with self._lock:
            same, every = self.steps[str(step)], self.steps.total()
        if same >= _HANGING_EACH or every >= _HANGING_IN_ALL:
            which = f"{same} of these" if same >= _HANGING_EACH else f"{every} calls of frameworks"
            raise BridgeError(
                f"{step} was not begun: {which} were given up before and hang still",
                FailureReason.UNAVAILABLE,
            )


class _Job(Generic[T]):
    """One outermost step on its worker thread, and the deadline that holds at this moment."""

    def __init__(
        self,
        step: str | BoundedStep,
        limit: float,
        action: Callable[[], T],
        on_late: Callable[[T], None] | None,
        on_give_up: Callable[[], object] | None,
        grace: float,
        done: Callable[[T | None, Exception | None], object] | None = None,
    ) -> None:
        self.step = step
        self.limit = limit
        self.deadline = time.monotonic() + limit
        self.given_up = False
        self.isolated: _Job[Any] | None = None
        self.on_give_up = on_give_up
        self.grace = grace
        self._hangs_in = ""
        self._level = logging.WARNING  # of the record that it failed late
        # When it is given up, at the latest, by what in it waits for something that was closed.
        self.abandoned: dict[object, float] = {}
        self._action = action
        self._on_late = on_late
        self._done = done
        self._is_over = False
        self._finished = threading.Lock()
        self._finished.acquire()
        self._verdict = threading.Lock()
        self._result: T
        self._error: Exception | None = None

    def work(self) -> None:
        _current.job = self
        try:
            self._result = self._action()
        except BaseException as error:  # noqa: BLE001 - handed to the waiter
            self._error = contained(error)  # in this thread nothing is the user's
        finally:
            _current.job = None
        with self._verdict:
            self._is_over = True
            self._finished.release()
            late = self.given_up
        if late:
            _hanging.remove(self._hangs_in)
            self._put_away()
        elif self._done is not None:
            self._done(None if self._error else self._result, self._error)

    def give_up_late(self) -> BridgeError | None:
        """Give it up where it is late or abandoned, and return the error that says so."""
        if self.given_up:
            return None
        now = time.monotonic()
        if any(now >= end for end in tuple(self.abandoned.values())) and self._give_up(None):
            text = f"{self._innermost()} was given up: the bridge was closed"
            return BridgeError(text, FailureReason.CLOSED)
        if now >= self.deadline + self.grace and self._give_up(self.on_give_up):
            text = f"{self._innermost()} did not finish within {self.limit:g} s and was given up"
            return BridgeTimeoutError(text)
        return None

    def _put_away(self) -> None:
        if self._error is not None:
            _log.log(self._level, "%s failed after it was given up: %s", self.step, self._error)
        elif self._on_late is not None:
            self._on_late(self._result)

    def run(self) -> T:
        """Begin, and wait for the result; the deadline may move to an inner step's meanwhile."""
        is_begun = False
        try:
            # A Ctrl-C just after the thread has it would leave its result to none.
            with Uninterrupted():
                _workers.submit(self.work)
                is_begun = True
            self._wait()
        except BridgeError:
            raise
        except BaseException:  # Ctrl-C: its caller waits no longer, as after its deadline
            self._level = logging.DEBUG  # who ends the whole need not know how its parts end
            if is_begun and not self._give_up(self.on_give_up):
                self._put_away()
            raise
        if self._error is not None:
            raise self._error
        return self._result

    def _wait(self) -> None:
        # The deadline and its grace are read at each look: they are those of an inner step for a
        # while, which may end within its grace, by an error that the step around it deals with.
        while not self._finished.acquire(timeout=self._glance()):
            if (error := self.give_up_late()) is not None:
                raise error

    def _glance(self) -> float:
        return max(0.0, min(self.deadline + self.grace - time.monotonic(), _GLANCE_SECONDS))

    def _innermost(self) -> str | BoundedStep:
        innermost: _Job[Any] = self
        while (inner := innermost.isolated) is not None:  # read once: it may be over now
            innermost = inner
        return innermost.step

    def _give_up(self, notify: Callable[[], object] | None) -> bool:
        """Have the result put away when it comes; False where it is there."""
        with self._verdict:
            if self._is_over or self.given_up:  # which a Ctrl-C may find done
                return self.given_up
            self.given_up = True
            self._hangs_in = str(self.step)
            _hanging.add(self._hangs_in)
        if notify is not None:
            try:
                foreign(notify)
            except Exception as error:  # noqa: BLE001 - who waits learns that it is late, not this
                _log.warning("%s could not be asked to end: %s", self.step, text_of(error))
        return True


class _CurrentJob(threading.local):
    job: _Job[Any] | None = None


_current = _CurrentJob()
_workers = WorkerPool("uoarm-step")
_hanging = _Hanging()


def _forget_threads() -> None:
    global _workers, _current, _hanging
    _workers, _current, _hanging = WorkerPool("uoarm-step"), _CurrentJob(), _Hanging()


os.register_at_fork(after_in_child=_forget_threads)


def run(
    step: str | BoundedStep,
    limit: float,
    action: Callable[[], T],
    *,
    on_late: Callable[[T], None] | None = None,
    on_give_up: Callable[[], object] | None = None,
    keeps_time: bool = False,
    isolated: bool = False,
    grace: float = 0.0,
) -> T:
    """Run an action under a time limit and return what it returns.

    Args:
        step: what is being done, as the subject of the error's sentence.
        limit: seconds.
        action: called once, in another thread unless this is already one of ours.
        on_late: takes a result that came after the step was given up, in the worker's thread.
        on_give_up: called when the step is given up, in the thread that waits; so that what goes
            on alone may be asked to end.
        keeps_time: the action ends within the limit by itself, with an error of its own: it runs
            in the caller's thread, and it is never given up.
        isolated: the step around this one, if any, is not given up with it: who waits for it goes
            on waiting.
        grace: seconds more that the action is given to end with an error of its own, which says
            what it waited for.

    Raises:
        BridgeTimeoutError: the step did not finish in time; it goes on alone, its result dropped.
        BridgeError: it was not begun, because too many like it hang already.
        Exception: what the action raised; in another thread, what is none is contained.
    """
    if _hanging.steps:
        _hanging.check(step)
    outer = _current.job
    if outer is None or outer.given_up or isolated:
        if keeps_time:
            return action()
        job = _Job(step, limit, action, on_late, on_give_up, grace)
        if outer is None:
            return job.run()
        outer.isolated = job
        try:
            return job.run()
        finally:
            outer.isolated = None
    return _run_inside(outer, step, limit, action, on_late, on_give_up, grace)


def left(otherwise: float) -> float:
    """Return the seconds that the step in this thread still has; `otherwise` outside of any."""
    job = _current.job
    if job is None or job.given_up or job.deadline == math.inf:
        return otherwise
    return max(0.0, job.deadline - time.monotonic())


StepUnderWay: TypeAlias = _Job[Any]


def current() -> StepUnderWay | None:
    """Return the step that runs in this thread, the outermost; None outside of any."""
    return _current.job


def begin(
    step: str,
    action: Callable[[], T],
    done: Callable[[T | None, Exception | None], object],
) -> StepUnderWay:
    """Run an action in another thread and do not wait for it; the limits are those of its steps.

    Args:
        step: what is being done, as with `run`.
        action: called once.
        done: takes what it returned, or raised, in its thread; not where it was given up.

    Returns:
        The step: who waits for it calls `give_up_late` every 50 ms or so.
    """
    job = _Job(step, math.inf, action, None, None, 0.0, done)
    _workers.submit(job.work)
    return job


def _run_inside(
    outer: _Job[Any],
    step: str | BoundedStep,
    limit: float,
    action: Callable[[], T],
    on_late: Callable[[T], None] | None,
    on_give_up: Callable[[], object] | None,
    grace: float,
) -> T:
    before = outer.step, outer.limit, outer.deadline, outer.on_give_up, outer.grace
    deadline = time.monotonic() + limit
    if deadline < outer.deadline:
        outer.limit, outer.deadline, outer.grace = limit, deadline, grace
    outer.step = step
    if on_give_up is not None:
        outer.on_give_up = on_give_up
    try:
        result = action()
    finally:
        if not outer.given_up:
            outer.step, outer.limit, outer.deadline, outer.on_give_up, outer.grace = before
    if outer.given_up:
        if on_late is not None:
            on_late(result)
        raise BridgeTimeoutError(f"{step} finished only after it had been given up")
    return result
