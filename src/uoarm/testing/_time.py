"""Time in tests: limits that grow on a slow machine, a clock that a test moves."""

from __future__ import annotations

import inspect
import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from uoarm._arguments import arguments
from uoarm.bridge import Bridge, Channel

__all__ = ["ManualClock", "default_limits", "patience", "slowness", "wait"]

_IDLE_SECONDS = 60.0
_SLOWEST = 10.0
_VARIABLE = "UOARM_TEST_SLOWNESS"
_SAMPLE_COUNT = 200_000
_SAMPLE_SECONDS = 0.02
_GLANCE_SECONDS = 0.005


def slowness() -> float:
    """Return how many times slower than an idle one of two gigahertz this machine is; 1 to 10.

    Measured once: the time of a fixed sample of work, times the processes that wait for each
    core. Child processes inherit the figure in ``UOARM_TEST_SLOWNESS``, which may also be set.
    """
    given = os.environ.get(_VARIABLE)
    if given is None:
        given = os.environ[_VARIABLE] = f"{_sample() * _crowd():.1f}"
    return min(max(1.0, float(given)), _SLOWEST)


def patience() -> float:
    """Return the seconds that a test waits for anything that is to happen.

    It is a limit for what would hang otherwise, not a measure of speed: a minute on an
    idle machine, longer by `slowness` on another. Do not assert that something happens within it.
    """
    return _IDLE_SECONDS * slowness()


@arguments()
def wait(
    ready: Callable[[], object],
    never: str = "it did not come to pass",
    timeout: float | None = None,
) -> None:
    """Wait until something is true of which there is no event, looking every five milliseconds.

    Raises:
        AssertionError: with the text of `never`, after `timeout` or else `patience` seconds.
    """
    deadline = time.monotonic() + (patience() if timeout is None else timeout)
    pause = threading.Event()
    while not ready():
        assert time.monotonic() < deadline, never
        pause.wait(_GLANCE_SECONDS)


def _sample() -> float:
    """Return the best of three times of the sample of work, as a multiple of what is usual."""
    times = []
    for _ in range(3):
        begin = time.perf_counter()
        sum(range(_SAMPLE_COUNT))
        sum(index & 1 for index in range(_SAMPLE_COUNT))
        times.append(time.perf_counter() - begin)
    return min(times) / _SAMPLE_SECONDS


def _crowd() -> float:
    """Return how many processes there are for each core; 1 where the system does not say."""
    load = getattr(os, "getloadavg", lambda: (1.0,))()[0]
    return max(1.0, float(load) / (os.cpu_count() or 1))


class ManualClock:
    """Seconds that only a test moves; callable, so that it fits wherever a clock is injected."""

    @arguments()
    def __init__(self, start: float = 0.0) -> None:
        self._now = start

    def __call__(self) -> float:
        """Return the seconds that it shows."""
        return self._now

    def now(self) -> float:
        """Return the seconds that it shows."""
        return self._now

    def advance(self, seconds: float) -> float:
        """Move it forward and return what it shows then.

        Raises:
            ValueError: the step is negative; time only grows.
        """
        if not seconds >= 0:
            raise ValueError(f"a clock cannot be advanced by {seconds} s")
        self._now += seconds
        return self._now


@contextmanager
def default_limits(seconds: float, *, closing: bool = True) -> Iterator[None]:
    """Have calls of bridges, channels and managers that are given no `timeout` last so long.

    What an application waits for a framework is nothing that a test is about, unless it says so.

    Args:
        seconds: the limit.
        closing: whether it holds for closing, too. What hangs as it is closed is given up after its
            limit, and nothing fails: a long one keeps the caller that closes it.
    """
    from uoarm import AsyncRobotManager, RobotManager  # noqa: PLC0415 - slow to import

    methods = (
        inspect.unwrap(method).__kwdefaults__ or {}
        for owner in (Bridge, Channel, RobotManager, AsyncRobotManager)
        for name, method in inspect.getmembers(owner, inspect.isfunction)
        if closing or name != "close"
    )
    found = [(item, item["timeout"]) for item in methods if isinstance(item.get("timeout"), float)]
    for defaults, _ in found:
        defaults["timeout"] = seconds
    try:
        yield
    finally:
        for defaults, before in found:
            defaults["timeout"] = before
