"""What an event loop does: the fixtures `longest_step` and `waits`."""

from __future__ import annotations

import gc
import sys
import threading
import time
from asyncio import BaseEventLoop, Handle, TimerHandle
from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import Any

import pytest


@pytest.fixture
def longest_step(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], float]]:
    """Return the CPU seconds of the longest step, so far, of the loop in the thread of that name.

    A step is what a loop does between two looks at its sockets: as long as it takes, no client is
    served. Neither what else the machine does nor how many steps wait before it makes it longer.
    Nor does a collection of garbage that happens to begin in it: it looks at all that the tests
    of this process keep.
    """
    longest: dict[str, float] = defaultdict(float)
    collecting: dict[int, float] = defaultdict(float)  # of each thread, which alone changes its own
    run = Handle._run

    def collected(phase: str, facts: dict[str, int]) -> None:
        spent = time.thread_time()
        collecting[threading.get_ident()] += spent if phase == "stop" else -spent

    def timed(handle: Handle) -> None:
        thread = threading.get_ident()
        begin = time.thread_time() - collecting[thread]
        run(handle)
        name = threading.current_thread().name
        spent = time.thread_time() - collecting[thread] - begin
        longest[name] = max(longest[name], spent)

    monkeypatch.setitem(sys.modules, "uvloop", None)  # its loop reports no steps
    monkeypatch.setattr(Handle, "_run", timed)
    gc.callbacks.append(collected)
    yield longest.__getitem__
    gc.callbacks.remove(collected)


@pytest.fixture
def waits(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], list[float]]:
    """Return the seconds of all timers, so far, that the loop in the thread of that name was given.

    What looks at something again and again has one for each look.
    """
    seconds: dict[str, list[float]] = defaultdict(list)
    later = BaseEventLoop.call_later

    def noted(loop: BaseEventLoop, delay: float, *arguments: Any, **options: Any) -> TimerHandle:
        seconds[threading.current_thread().name].append(delay)
        return later(loop, delay, *arguments, **options)

    monkeypatch.setitem(sys.modules, "uvloop", None)  # its loop is another one
    monkeypatch.setattr(BaseEventLoop, "call_later", noted)
    return seconds.__getitem__
