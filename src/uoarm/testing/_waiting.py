"""Waiting in tests: limits that grow on a slow machine, clocks, and what other threads do."""

from __future__ import annotations

import inspect
import math
import os
import threading
import time
from array import array
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from itertools import chain
from typing import Any, Generic, TypeVar

from uoarm._arguments import arguments
from uoarm.bridge import Bridge, Channel
from uoarm.model import Message, StatusMap

_IDLE_SECONDS = 60.0
_SLOWEST = 10.0
_VARIABLE = "UOARM_TEST_SLOWNESS"
_SAMPLE_COUNT = 200_000
_SAMPLE_SECONDS = 0.02
_FIRST_GLANCE_SECONDS, _GLANCE_SECONDS = 0.005, 0.02
T = TypeVar("T")


def slowness() -> float:
    """Return how many times slower than an idle one of two gigahertz this machine is; 1 to 10.

    Measured once: the time of a fixed sample of work, times the processes that wait for each
    core. Child processes inherit the figure in ``UOARM_TEST_SLOWNESS``, which may also be set.
    """
    given = os.environ.get(_VARIABLE)
    if given is None:
        given = os.environ[_VARIABLE] = f"{_sample() * crowd():.1f}"
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
    never: str | Callable[[], str] = "it did not come to pass",
    timeout: float | None = None,
) -> None:
    """Wait until something is true of which there is no event.

    Looks after five milliseconds, then less and less often, and fifty times a second in the end.

    Args:
        ready: called until it returns what is true.
        never: why it failed, or a function that returns this, called then.
        timeout: seconds.

    Raises:
        AssertionError: with the text of `never`, after `timeout` or else `patience` seconds.
    """
    deadline = time.monotonic() + (patience() if timeout is None else timeout)
    pause, seconds = threading.Event(), _FIRST_GLANCE_SECONDS
    while not ready():
        assert time.monotonic() < deadline, never() if callable(never) else never
        pause.wait(seconds)
        seconds = min(1.25 * seconds, _GLANCE_SECONDS)


def _sample() -> float:
    """Return the best of three times of the sample of work, as a multiple of what is usual."""
    times = []
    for _ in range(3):
        begin = time.perf_counter()
        sum(range(_SAMPLE_COUNT))
        sum(index & 1 for index in range(_SAMPLE_COUNT))
        times.append(time.perf_counter() - begin)
    return min(times) / _SAMPLE_SECONDS


def crowd() -> float:
    """Return how many processes want each core now; 1 where the system does not say."""
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


class Collector:
    """A `deliver` that keeps what comes, and lets a test wait for it or hold it up.

    The collector itself is a `Delivery`, which keeps what a bridge says beside that, too.

    Attributes:
        overlaps: deliveries that began while another one of this collector was under way.
        unread: why messages could not be read, in order; empty: something could be.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._messages: list[Message] = []
        self._begun = 0
        self._busy = 0
        self.overlaps = 0
        self.unread: list[str] = []
        self._open = threading.Event()
        self._open.set()

    @property
    def begun(self) -> int:
        """How many deliveries have begun, those that are held up included."""
        return self._begun

    @property
    def messages(self) -> list[Message]:
        """What has come so far, in order."""
        with self._changed:
            return list(self._messages)

    def deliver(self, message: Message) -> None:
        """Keep one message, once nothing holds it up."""
        with self._changed:
            self._begun += 1
            self.overlaps += self._busy > 0
            self._busy += 1
            self._changed.notify_all()
        self._open.wait()
        with self._changed:
            self._messages.append(message)
            self._busy -= 1
            self._changed.notify_all()

    def __call__(self, message: Message, writer: str = "") -> None:
        """Keep one message, of any writer."""
        del writer
        self.deliver(message)

    def let_go(self, writer: str = "") -> None:
        """Keep what came: nothing stands here."""

    def unreadable(self, why: str | Exception) -> None:
        """Keep why a message could not be read."""
        with self._changed:
            self.unread.append(str(why))
            self._changed.notify_all()

    def readable(self) -> None:
        """Keep that something could be read."""
        self.unreadable("")

    @contextmanager
    def held(self) -> Iterator[None]:
        """Hold up every delivery meanwhile, as a consumer does that is too slow."""
        self._open.clear()
        try:
            yield
        finally:
            self._open.set()

    def wait(self, count: int, timeout: float | None = None) -> list[Message]:
        """Return the messages once there are `count` or more; without a timeout, see `patience`.

        Raises:
            AssertionError: fewer came within `timeout` seconds.
        """
        timeout = patience() if timeout is None else timeout
        with self._changed:
            if not self._changed.wait_for(lambda: len(self._messages) >= count, timeout):
                came = len(self._messages)
                raise AssertionError(f"{came} of {count} messages came within {timeout:g} s")
            return list(self._messages)

    def wait_for(self, fits: Callable[[Message], bool], timeout: float | None = None) -> None:
        """Wait until a message has come that fits.

        Raises:
            AssertionError: none came within `timeout` seconds.
        """
        timeout = patience() if timeout is None else timeout
        with self._changed:
            if not self._changed.wait_for(lambda: any(map(fits, self._messages)), timeout):
                raise AssertionError(f"no such message within {timeout:g} s: {self._messages}")

    def wait_begun(self, count: int, timeout: float | None = None) -> None:
        """Wait until `count` deliveries have begun.

        Raises:
            AssertionError: fewer began within `timeout` seconds.
        """
        timeout = patience() if timeout is None else timeout
        with self._changed:
            if not self._changed.wait_for(lambda: self._begun >= count, timeout):
                text = f"{self._begun} of {count} deliveries began within {timeout:g} s"
                raise AssertionError(text)


class Background(Generic[T]):
    """An action in a thread of its own, whose end a test waits for no longer than it says."""

    @arguments()
    def __init__(self, action: Callable[[], T]) -> None:
        self._action = action
        self._result: T
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="uoarm-test", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            self._result = self._action()
        except BaseException as error:  # noqa: BLE001 - raised where the result is asked for
            self._error = error

    def result(self, timeout: float | None = None) -> T:
        """Return what the action returned, or raise what it raised.

        Raises:
            AssertionError: it is still running after `timeout` seconds.
        """
        timeout = patience() if timeout is None else timeout
        self._thread.join(timeout)
        if self._thread.is_alive():
            raise AssertionError(f"still running after {timeout:g} s: {self._action}")
        if self._error is not None:
            raise self._error
        return self._result


def plain(value: Any) -> Any:
    """Return the same message with lists in the place of buffers and arrays."""
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, (bytes, bytearray)):
        return list(value)
    if isinstance(value, (memoryview, array)) or hasattr(value, "__array__"):
        return value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return value


_AS_IN_PYTHON = frozenset({int, float, str})


def same(one: Any, other: Any) -> bool:
    """Whether two messages are equal by value: buffers as lists, NaN as itself, 1.0 as 1.

    True and 1 differ, as they do in JSON.
    """
    return _equal(plain(one), plain(other))


def _equal(one: Any, other: Any) -> bool:
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_equal(one[key], other[key]) for key in one)
    if isinstance(one, list) and isinstance(other, list):
        # A picture is a list of millions.
        if _AS_IN_PYTHON.issuperset(map(type, chain(one, other))) and one == other:
            return True
        return len(one) == len(other) and all(map(_equal, one, other))
    if isinstance(one, bool) or isinstance(other, bool):
        return one is other
    if isinstance(one, float) and isinstance(other, float) and math.isnan(one):
        return math.isnan(other)
    return bool(one == other)


@arguments()
def losses(status: StatusMap) -> Counter[str]:
    """Return how many messages were lost, by reason; 0 for each reason that is not there.

    Counts what routes dropped, those of plans that were replaced included, what was lost with
    components that died or were let go, as `lost`, what living links lost, as `lost_on_link`, and
    what living components emitted while no consumer took it, as `undelivered`. What is still under
    way is not lost: compare when nothing moves. What several routes of an output got may be lost on
    one and received on another: see `copies`. Routes that several connections shared when they
    ended are counted once for each of them.
    """
    found: Counter[str] = Counter()
    for connection in status.connections:
        found["lost"] += connection.lost
        for route in connection.ended:
            found.update(dict(route.dropped))
    for route in status.routes:
        found.update(dict(route.dropped))
    for component in status.components:
        for channel in component.channels:
            for reason in ("lost_on_link", "undelivered"):
                lost = dict(channel.facts).get(reason, 0)
                found[reason] += lost if isinstance(lost, int) else 0
    return +found


@arguments()
def copies(status: StatusMap) -> int:
    """Return how many messages were given to one more route of the output that emitted them.

    Each of them is received or lost a second time, so what was sent and the copies are what was
    received or lost. Routes that several connections shared count as for `losses`.
    """
    ended = (route for connection in status.connections for route in connection.ended)
    return sum(route.copies for route in (*ended, *status.routes))
