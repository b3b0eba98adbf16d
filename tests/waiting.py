"""Waiting for what other threads and processes do, where no event tells of it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

__all__ = ["wait"]


def wait(ready: Callable[[], object], seconds: float = 10.0) -> None:
    """Wait until something is true, looking every five milliseconds; fails when time runs out."""
    deadline = time.monotonic() + seconds
    pause = threading.Event()
    while not ready():
        assert time.monotonic() < deadline, "it did not come to pass"
        pause.wait(0.005)
