"""The switch interval of our own processes; never that of an application."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from uoarm.errors import UsageError

__all__ = ["short_switch_interval", "switch_interval_seconds"]

_VARIABLE = "UOARM_SWITCH_INTERVAL"
_USUAL = 0.5
_LEAST, _MOST = 0.01, 1000.0


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


@contextmanager
def short_switch_interval() -> Iterator[None]:
    """Have threads switched after `switch_interval_seconds`, and as before afterwards.

    Decoders, encoders and checks of messages keep the interpreter's lock as long as they may, 5 ms
    by default; whatever else is to pass a message on waits for them.

    Raises:
        UsageError: as `switch_interval_seconds`.
    """
    before, seconds = sys.getswitchinterval(), switch_interval_seconds()
    sys.setswitchinterval(seconds)
    try:
        yield
    finally:
        sys.setswitchinterval(before)
