"""Waiting for what other threads and processes do, where no event tells of it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

__all__ = ["wait"]


def wait(
    ready: Callable[[], object], seconds: float = 10.0, never: str = "it did not come to pass"
) -> None:
    """Wait until something is true, looking every five milliseconds; fails when time runs out."""
    deadline = time.monotonic() + seconds
    pause = threading.Event()
    while not ready():
        assert time.monotonic() < deadline, never
        pause.wait(0.005)
