"""A census of what this process holds: threads and file descriptors."""

from __future__ import annotations

import gc
import threading
import time
from pathlib import Path

from uoarm.testing._patience import patience

__all__ = ["Census"]

_DESCRIPTORS = ("/proc/self/fd", "/dev/fd")
_OF_THE_CORE = "uoarm-step"
_GLANCE_SECONDS = 0.01


class Census:
    """The threads and descriptors at one moment, to be compared with a later one.

    The core's own idle step threads do not count: they end by themselves. Nor do threads that a
    library started without Python, which call into it: Python does not know when they end.
    """

    def __init__(self) -> None:
        gc.collect()
        self._threads = set(threading.enumerate())
        self._descriptors = _count_descriptors()

    def check(self, timeout: float | None = None) -> None:
        """Hold that nothing is left over, giving threads and descriptors time to end.

        Without a timeout they have the time of `patience`.

        Raises:
            AssertionError: it names the threads, or gives the number of descriptors, that stay.
        """
        deadline = time.monotonic() + (patience() if timeout is None else timeout)
        pause = threading.Event()
        # Not joined: one of them may be about to begin, which Python refuses to join.
        while names := sorted(thread.name for thread in self._left_over()):
            if time.monotonic() >= deadline:
                raise AssertionError(f"{len(names)} threads are left over: {', '.join(names[:8])}")
            pause.wait(_GLANCE_SECONDS)
            gc.collect()  # a pool's threads end when nobody refers to it any more
        gc.collect()
        while (extra := _count_descriptors() - self._descriptors) > 0:
            if time.monotonic() >= deadline:
                raise AssertionError(f"{extra} file descriptors are left over")
            pause.wait(_GLANCE_SECONDS)

    def _left_over(self) -> list[threading.Thread]:
        return [
            thread
            for thread in threading.enumerate()
            if thread not in self._threads
            and thread.name != _OF_THE_CORE
            and not isinstance(thread, threading._DummyThread)  # noqa: SLF001 - nobody joins these
        ]


def _count_descriptors() -> int:
    """Return how many descriptors are open, 0 where the system does not tell."""
    for folder in _DESCRIPTORS:
        try:
            return sum(1 for _ in Path(folder).iterdir())
        except OSError:
            continue
    return 0
