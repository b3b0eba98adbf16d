"""Bridges and simulated devices put together for tests, and ways to wait without sleeping."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from queue import Empty, Queue
from typing import Any

from lines import LIMIT, fresh_link
from uoarm_rocos._framing import LengthFramer, StuffedFramer
from uoarm_rocos.simulate import (
    LineEnd,
    LineFaults,
    Model,
    ProfileServer,
    PtyEnd,
    Simulated,
    TcpEnd,
    run,
)

from uoarm.bridge import Bridge, HealthEvent, Registry
from uoarm.model import BridgeSpec, Endpoint, Health, Role

ROLES = {"output": Role.OUTPUT, "input": Role.INPUT, "service": Role.SERVICE}
# `describe` waits as long as a test does, and is to say what became of the device before.
QUICK = {"wait": LIMIT / 2, "backoff": [0.02, 0.1]}


def endpoint(device: str, api: str, role: str = "output") -> Endpoint:
    return Endpoint("rocos", device, ROLES[role], (device, api), api)


class Events:
    """What a bridge reports, in order; also a receiver of messages."""

    def __init__(self) -> None:
        self.queue: Queue[Any] = Queue()
        self.unread: list[str] = []

    def __call__(self, event: Any, writer: str = "") -> None:
        self.queue.put(event)

    def let_go(self, writer: str = "") -> None:
        """Nothing of a device stands."""

    def unreadable(self, why: str) -> None:
        self.unread.append(why)

    def readable(self) -> None:
        """Each message says so."""

    def get(self) -> Any:
        return self.queue.get(timeout=LIMIT)

    def until(self, wanted: Callable[[Any], bool]) -> Any:
        """Return the first that is wanted, or fail when it does not come."""
        seen: list[Any] = []
        end = time.monotonic() + LIMIT
        while True:
            assert time.monotonic() < end, f"it never came; there were {seen[-5:]}"
            try:
                seen.append(self.get())
            except Empty:
                raise AssertionError(f"it never came; there were {seen[-5:]}") from None
            if wanted(seen[-1]):
                return seen[-1]

    def health(self, health: Health) -> HealthEvent:
        event = self.until(lambda item: item.health is health)
        assert isinstance(event, HealthEvent)
        return event


@contextmanager
def bridged(**devices: dict[str, object]) -> Iterator[tuple[Bridge, Events]]:
    """A bridge with these devices, and what it reports."""
    given = {name: {**QUICK, **options} for name, options in devices.items()}
    bridge = Registry().create(BridgeSpec("rocos", "rocos", {"devices": given}))
    events = Events()
    bridge.watch(events)
    try:
        yield bridge, events
    finally:
        bridge.close()


@contextmanager
def running(device: Simulated, end: LineEnd, faults: LineFaults | None = None) -> Iterator[str]:
    """A device that runs in a thread; its URL."""
    stop = threading.Event()
    thread = threading.Thread(target=run, args=(device, end, stop, faults), daemon=True)
    where = end.where
    thread.start()
    try:
        yield where
    finally:
        stop.set()
        thread.join(LIMIT)
        assert not thread.is_alive()


def unplugged_by(end: LineEnd, pulled: threading.Event) -> LineEnd:
    """The same end, whose cable is out and in again, once, each time that the event is set."""
    read = end.read

    def read_unless_pulled(timeout: float) -> bytes | None:
        if not pulled.is_set():
            return read(timeout)
        pulled.clear()
        end.cut()
        return None

    end.read = read_unless_pulled  # type: ignore[method-assign] # of this end alone
    return end


def line_end(kind: str) -> LineEnd:
    """A device's end of a new line: `tcp` or `pty`."""
    return TcpEnd() if kind == "tcp" else PtyEnd(fresh_link())


def on_cable(end: LineEnd, plugged: threading.Event) -> LineEnd:
    """The same end, whose cable is out while the event is not set; its port stays its own."""
    read, meet = end.read, end.meet

    def read_if_plugged(timeout: float) -> bytes | None:
        if plugged.is_set():
            return read(timeout)
        end.cut()
        return None

    def meet_if_plugged(timeout: float) -> bool:
        if plugged.is_set():
            return meet(timeout)
        if not end.framed:
            plugged.wait(timeout)
        elif meet(timeout):  # over TCP a host is always taken, and then let go
            end.cut()
        return False

    end.read = read_if_plugged  # type: ignore[method-assign] # of this end alone
    end.meet = meet_if_plugged  # type: ignore[method-assign] # the same
    return end


@contextmanager
def served(model: Model, kind: str = "tcp", faults: LineFaults | None = None) -> Iterator[str]:
    """A device that speaks the profile for a model, on this kind of line; its URL."""
    end = line_end(kind)
    framer = LengthFramer if end.framed else StuffedFramer
    with ExitStack() as stack:
        yield stack.enter_context(running(ProfileServer(model, framer), end, faults))
