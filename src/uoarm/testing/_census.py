"""What this process holds, threads and file descriptors, and what processor time it takes."""

from __future__ import annotations

import gc
import os
import threading
import time
from contextlib import suppress
from pathlib import Path

from uoarm.testing._patience import patience

__all__ = ["Census", "processor_share"]

_DESCRIPTORS = ("/proc/self/fd", "/dev/fd")
_OF_THE_CORE = "uoarm-step"
_GLANCE_SECONDS = 0.01


def processor_share(seconds: float, *others: int) -> float:
    """Return which share of one processor this process takes in so many seconds from now.

    What waits takes next to none; a loop that turns for nothing takes all that it gets.

    Args:
        seconds: how long to look.
        others: ids of processes that are counted, too, where the system tells of them: Linux.
    """
    begin, before = time.monotonic(), _processor_seconds(others)
    threading.Event().wait(seconds)
    return (_processor_seconds(others) - before) / (time.monotonic() - begin)


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


def _processor_seconds(others: tuple[int, ...]) -> float:
    seconds = time.process_time()
    for process in others:
        with suppress(OSError):
            text = Path(f"/proc/{process}/stat").read_text(encoding="utf-8")
            user, system = text.rpartition(")")[2].split()[11:13]  # its name may have blanks
            seconds += (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")
    return seconds


def _count_descriptors() -> int:
    """Return how many descriptors are open, 0 where the system does not tell."""
    for folder in _DESCRIPTORS:
        try:
            return sum(1 for _ in Path(folder).iterdir())
        except OSError:
            continue
    return 0
