"""Ctrl-C or SIGTERM while something is half done: raised when that is whole, or at a second one.

And while the main thread waits: a signal is noticed within a second (`wait_step`). What a finalizer
asks for is done in a thread of its own (`put_off`): it may come within any call, of any thread.

Python raises KeyboardInterrupt in the main thread, after any call, and so does SIGTERM whatever its
handler raises, SystemExit most often. Where that thread owns what others share, half of a change
would be lost, and it could not be known which half.
"""

from __future__ import annotations

import _signal  # type: ignore[import-not-found]  # what `signal` wraps, at fifteen times the cost
import ctypes
import gc
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from operator import methodcaller
from types import FrameType
from typing import Any, overload

_STEP_SECONDS = 1.0
_NUMBERS = int(signal.SIGINT), int(signal.SIGTERM)
_NOTHING: tuple[int, FrameType | None] = 0, None
_ACTION_OCTETS = 256  # more than a `struct sigaction` has anywhere


def _find_sigaction() -> Any:
    """Return the system's function; None: it has none, as Windows.

    It keeps the interpreter's lock: a thread that changed the same in between would be undone.
    """
    try:
        return ctypes.PyDLL(None).sigaction
    except (AttributeError, OSError, TypeError):
        return None


_sigaction = _find_sigaction()


class _ThreadState(threading.local):
    is_put_off = False


_here = _ThreadState()


class Uninterrupted:
    """Puts Ctrl-C and SIGTERM off to the end of a `with` block; a second one is raised at once.

    So what hangs in the block can be left still. Does nothing in other threads than the main one,
    which are never interrupted, and within another such block. One that comes as the block begins
    is raised before it. Each is for one block.
    """

    __slots__ = ("_came", "_handlers", "_is_inside")

    def __init__(self) -> None:
        self._handlers: dict[int, Any] | None = None

    def __enter__(self) -> None:
        if _here.is_put_off or threading.get_ident() != threading.main_thread().ident:
            return
        handlers = {}
        for number in _NUMBERS:
            handler = _signal.getsignal(number)
            if callable(handler):  # what is no function raises nothing
                handlers[number] = handler
        self._handlers, self._came, self._is_inside = handlers, _NOTHING, True
        try:
            for number in handlers:
                _set_handler(number, self._note)
        except BaseException:  # what came before this, which Python raises here
            self._put_back(handlers)
            raise
        _here.is_put_off = self._is_inside

    def __exit__(self, *_: object) -> None:
        if self._handlers is None:
            return
        try:
            self._put_back(self._handlers)
        finally:  # the one that came is raised, too, where another comes just now
            (number, frame), self._came = self._came, _NOTHING
            if number:
                self._handlers[number](number, frame)

    def _note(self, number: int, frame: FrameType | None) -> None:
        handlers = self._handlers
        assert handlers is not None, "set before this is a handler"
        if self._is_inside and self._came is _NOTHING:
            self._came = number, frame
            return
        self._came = _NOTHING
        self._put_back(handlers)
        handlers[number](number, frame)

    def _put_back(self, handlers: dict[int, Any]) -> None:
        """Have the handlers that were there before, where no others were set meanwhile.

        Python may raise in between what comes just then: what is not put back yet stays with
        `_note`, which is outside then, and puts nothing off any more.
        """
        _here.is_put_off = self._is_inside = False
        for number, handler in handlers.items():
            if _signal.getsignal(number) == self._note:
                _set_handler(number, handler)


def _set_handler(number: int, handler: Any) -> None:
    """Set what Python calls, and leave what the system calls before that.

    A library may have set that without Python's knowledge, and call Python's handler from there, as
    rclpy does, whose own waits else no signal would end any more. Python sets both.
    """
    below = _below(number)
    try:
        _signal.signal(number, handler)
    finally:
        _set_below(number, below)


def _below(number: int) -> Any:
    below = (ctypes.c_char * _ACTION_OCTETS)()
    if _sigaction is not None:
        _sigaction(number, None, below)
    return below


def _set_below(number: int, below: Any) -> None:
    if _sigaction is not None:
        _sigaction(number, below, None)


class _Collection(threading.local):
    """Whether the garbage collector runs in this thread.

    All of it is C: Python handles a signal as a function begins, and drops what is raised in a
    function that the collector calls.
    """

    is_running = False
    start = property(methodcaller("__setattr__", "is_running", True))
    stop = property(methodcaller("__setattr__", "is_running", False))


_collection = _Collection()
gc.callbacks.append(partial(getattr, _collection))  # each phase by its name


def put_off(call: Callable[[], object]) -> bool:
    """Have something called in another thread where a finalizer asks for it; say whether.

    The collector may run within any call: this thread may hold the locks that are needed. As the
    interpreter ends it is not called at all: no thread runs any more, and none would begin.
    """
    if sys.is_finalizing():
        return True
    if not _collection.is_running:
        return False
    threading.Thread(target=call, name="uoarm-finalizer", daemon=True).start()
    return True


@contextmanager
def handlers_kept(numbers: Iterable[int]) -> Iterator[None]:
    """Have signals handled after a `with` block as before it, by Python and by what lies below.

    An event loop that ends leaves Python's own handlers. Only in the main thread.
    """
    wakes = signal.set_wakeup_fd(-1)
    former = [(number, _signal.getsignal(number), _below(number)) for number in numbers]
    try:
        yield
    finally:
        for number, handler, below in former:
            if handler is not None:  # else it was never Python's
                _signal.signal(number, handler)
            _set_below(number, below)
        with suppress(OSError, ValueError):  # it was closed meanwhile
            signal.set_wakeup_fd(wakes)


@overload
def wait_step(left: float) -> float: ...


@overload
def wait_step(left: None = None) -> float | None: ...


def wait_step(left: float | None = None) -> float | None:
    """Return how long this thread may wait before it looks again, of the seconds that are left.

    Python runs the handler of a signal between two instructions of the main thread. A wait that
    begins after the signal came, and before Python has looked, is not ended by it, and neither is
    one while the kernel gives the signal to another thread. So the main thread waits in steps.
    """
    if threading.get_ident() != threading.main_thread().ident:
        return left
    return _STEP_SECONDS if left is None else min(left, _STEP_SECONDS)


def wait_for(event: threading.Event, timeout: float | None = None) -> bool:
    """Wait for an event in such steps; False where `timeout` seconds were too few."""
    end = None if timeout is None else time.monotonic() + timeout
    while not event.wait(wait_step(None if end is None else end - time.monotonic())):
        if end is not None and time.monotonic() >= end:
            return False
    return True


def wait_until(
    changed: threading.Condition, ready: Callable[[], bool], timeout: float | None = None
) -> bool:
    """Wait in such steps for a condition, which is held; False where `timeout` was too short."""
    end = None if timeout is None else time.monotonic() + timeout
    # In a loop: all who wait are woken for anything, and another may have been faster.
    while not ready():
        left = None if end is None else end - time.monotonic()
        if left is not None and left <= 0:
            return False
        changed.wait(wait_step(left))
    return True
