"""The switch interval of our own processes; never that of an application.

A short one lets a thread that passes a message on go before one that computes. But a thread that
waits for the interpreter's lock wakes after each interval to ask for it, in some 4 us: of a hundred
that wait every 0.5 ms the processor does nothing else. So the interval grows with the threads.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from uoarm.errors import UsageError

__all__ = [
    "fit_switch_interval",
    "set_short_switch_interval",
    "short_switch_interval",
    "switch_interval_seconds",
]

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
