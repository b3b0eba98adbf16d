"""What the steps of an event loop cost: the fixture `longest_step`."""

from __future__ import annotations

import sys
import threading
import time
from asyncio import Handle
from collections import defaultdict
from collections.abc import Callable

import pytest

__all__ = ["longest_step"]


@pytest.fixture
def longest_step(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], float]:
    """Return the CPU seconds of the longest step, so far, of the loop in the thread of that name.

    A step is what a loop does between two looks at its sockets: as long as it takes, no client is
    served. Neither what else the machine does nor how many steps wait before it makes it longer.
    """
    longest: dict[str, float] = defaultdict(float)
    run = Handle._run

    def timed(handle: Handle) -> None:
        begin = time.thread_time()
        run(handle)
        name = threading.current_thread().name
        longest[name] = max(longest[name], time.thread_time() - begin)

    monkeypatch.setitem(sys.modules, "uvloop", None)  # its loop reports no steps
    monkeypatch.setattr(Handle, "_run", timed)
    return longest.__getitem__
