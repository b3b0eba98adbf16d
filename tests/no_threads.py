"""The system gives no more threads, as at the limit of a user or of a container."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest


@contextmanager
def no_threads(names: str = "", *, but: str = "no such") -> Iterator[None]:
    """Have the system give no thread whose name has this in it, and nothing of `but`."""
    starts = threading.Thread.start

    def start(thread: threading.Thread) -> None:
        if names in thread.name and but not in thread.name:
            raise RuntimeError("can't start new thread")
        starts(thread)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(threading.Thread, "start", start)
        yield
