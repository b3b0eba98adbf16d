"""Waiting for what another process does, which cannot set an event here."""

from __future__ import annotations

import time
from collections.abc import Callable

_LOOK_SECONDS = 0.02


def eventually(so: Callable[[], object], never: str, seconds: float = 60.0) -> None:
    """Return once something is so, however slow the machine is; fail where it never is.

    Args:
        so: looks whether it is.
        never: what to say otherwise.
        seconds: after which that is said.
    """
    deadline = time.monotonic() + seconds
    while not so():
        assert time.monotonic() < deadline, never
        time.sleep(_LOOK_SECONDS)
