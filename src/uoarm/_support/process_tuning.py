"""How our own processes are tuned: the switch interval, and the memory that the allocator keeps.

Neither is ever set in an application's process.

A short one lets a thread that passes a message on go before one that computes. But a thread that
waits for the interpreter's lock wakes after each interval to ask for it, in some 4 us: of a hundred
that wait every 0.5 ms the processor does nothing else. So the interval grows with the threads.

By itself glibc's allocator gives a large block back to the system when it is freed, and each page
of the next one is faulted in anew. That is half of what a picture costs a process. Other libraries
are left alone.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from uoarm.errors import UsageError

_VARIABLE = "UOARM_SWITCH_INTERVAL"
_USUAL = 0.5
_LEAST, _MOST = 0.01, 1000.0
_EACH_SECONDS = 20e-6
_LONG_SECONDS = 0.005
"""What CPython has by itself."""
_short: float | None = None  # like the interval itself, of the process


def switch_interval_seconds() -> float:
    """Return the switch interval that the user asks for, or 0.5 ms, in seconds.

    Raises:
        UsageError: the variable holds no number of milliseconds from 0.01 to 1000.
    """
    given = os.environ.get(_VARIABLE, "")
    try:
        milliseconds = float(given or _USUAL)
    except ValueError:
        milliseconds = 0.0
    if not _LEAST <= milliseconds <= _MOST:
        raise UsageError(
            f"{_VARIABLE}: expected milliseconds, {_LEAST:g} to {_MOST:g}, got {given[:40]!r}"
        )
    return milliseconds / 1000


def set_short_switch_interval() -> None:
    """Have threads switched after `switch_interval_seconds`, for good; see `fit_switch_interval`.

    Raises:
        UsageError: as `switch_interval_seconds`.
    """
    global _short  # noqa: PLW0603 - see above
    _short = switch_interval_seconds()
    fit_switch_interval()


def fit_switch_interval() -> None:
    """Fit the interval to the number of threads, where a short one was set. From any thread.

    To be called when a thread has begun or ends. 20 us for each, no longer than CPython's own
    interval: all of them together take a fifth of a processor at most where they only wait.
    """
    short = _short
    if short is not None:
        fitting = min(_LONG_SECONDS, threading.active_count() * _EACH_SECONDS)
        sys.setswitchinterval(max(short, fitting))


@contextmanager
def short_switch_interval() -> Iterator[None]:
    """Have threads switched after `switch_interval_seconds`, and as before afterwards.

    Decoders, encoders and checks of messages keep the interpreter's lock as long as they may, 5 ms
    by default; whatever else is to pass a message on waits for them.

    Raises:
        UsageError: as `switch_interval_seconds`.
    """
    global _short  # noqa: PLW0603 - see above
    before, short_before = sys.getswitchinterval(), _short
    set_short_switch_interval()
    try:
        yield
    finally:
        _short = short_before
        sys.setswitchinterval(before)


_BLOCK, _FREE = 2**25, 2**28
KEEPING = {"MALLOC_MMAP_THRESHOLD_": str(_BLOCK), "MALLOC_TRIM_THRESHOLD_": str(_FREE)}
"""The environment of a process that keeps blocks up to the first size, and as much as the second.

Source: mallopt(3).
"""
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of <malloc.h>


def keep_memory() -> None:
    """Have this process keep as much, for good, unless its environment says something of it."""
    if KEEPING.keys() & os.environ.keys():
        return
    with contextlib.suppress(AttributeError):  # another C library
        set_option = ctypes.CDLL(None).mallopt
        set_option(_MMAP_THRESHOLD, _BLOCK)
        set_option(_TRIM_THRESHOLD, _FREE)


def give_memory_back() -> None:
    """Return free memory to the system, where the C library is one that can."""
    with contextlib.suppress(AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
