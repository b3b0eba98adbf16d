"""Listeners and observers of changes: events get a number, and come to each in order."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from queue import SimpleQueue

from uoarm._control.engine.events import Event, write_event
from uoarm._dataplane import Clock
from uoarm._raised import LimitedLog, Log, foreign, name_of
from uoarm._support.ordered import keep_newest
from uoarm._support.workers import Lanes
from uoarm.model import StatusEvent

_CLOSE_SECONDS = 2.0
_RECORDED = frozenset({"lost", "failed", "replaced"})
_BURST = 20
_LANE = "log of events"
_log, _log_of_events = Log("uoarm"), Log("uoarm.control")


class EventDispatcher:
    """Numbers events and calls listeners, in a thread of its own: nothing waits for a listener.

    Observers are called at once: they miss nothing that happened before they end.

    The thread begins with the first of either, and is woken while there are listeners. Deaths and
    takeovers have a record in the log each, written by the same thread: at most twenty in ten
    seconds for a component or a bridge, and for all connections together.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        # Held from the number of an event to its place in the queue: listeners get them in order.
        # No listener is called with it.
        self._lock = threading.Lock()
        self._number = 0
        self._listeners: tuple[Callable[[StatusEvent], None], ...] = ()
        self._observers: tuple[Callable[[StatusEvent], None], ...] = ()
        self._events: SimpleQueue[StatusEvent | None] = SimpleQueue()
        self._thread: threading.Thread | None = None
        self._is_closed = False
        self._records: dict[str, LimitedLog] = {}
        self._failures = LimitedLog(_log)

    def post(self, subject: str, change: str, cause: str = "", function: str = "") -> None:
        """Number one change and have the listeners called. Waits for nothing."""
        with self._lock:
            self._number += 1
            is_queued = self._listeners or change in _RECORDED
            if not (is_queued or self._observers):
                return
            event = StatusEvent(self._number, self._clock(), subject, change, cause, function)
            for observer in self._observers:
                observer(event)
            if is_queued:
                self._events.put(event)
                self._start()

    def observe(self, observer: Callable[[StatusEvent], None]) -> Callable[[], None]:
        """Call an observer with every change from now on, within `post`; returns what ends that.

        It runs in whatever thread posts, under the lock: it stores the event, and neither waits,
        raises nor posts.
        """
        with self._lock:
            self._start()  # what is lost later is recorded without waiting for a thread to begin
            self._observers = (*self._observers, observer)

        def end() -> None:
            with self._lock:
                self._observers = _without(self._observers, observer)

        return end

    def listen(self, listener: Callable[[StatusEvent], None]) -> Callable[[], None]:
        """Call a listener for every change from now on; returns what ends that."""
        with self._lock:
            self._start()
            self._listeners = (*self._listeners, listener)

        def end() -> None:
            with self._lock:
                self._listeners = _without(self._listeners, listener)

        return end

    def close(self) -> None:
        """Call listeners for what is left, then end. Waits two seconds at most; idempotent.

        What waits still is counted in the log: it is brought if the listener comes back in time.
        """
        with self._lock:
            is_first, self._is_closed = not self._is_closed, True
            if is_first:
                self._events.put(None)
        thread = self._thread
        if thread is not None and threading.current_thread() is not thread:
            thread.join(_CLOSE_SECONDS)
            count = self._events.qsize() - 1
            if is_first and thread.is_alive() and count > 0:
                text = "a listener has held up %d changes for %g s at the end"
                _log.warning(text, count, _CLOSE_SECONDS)

    def _start(self) -> None:
        if self._thread is None:
            thread = threading.Thread(target=self._run, name="uoarm-events", daemon=True)
            thread.start()
            self._thread = thread

    def _record(self, event: StatusEvent) -> None:
        kind, _, name = event.subject.partition(" ")
        key = f"{event.change} {kind if kind == 'connection' else event.subject}"
        log = self._records.get(key)
        if log is None:
            logger = f"uoarm.component.{name}" if kind == "component" else "uoarm"
            log = LimitedLog(logger, _BURST)
        keep_newest(self._records, key, log)
        log.write(logging.WARNING, f"{event.subject} {event.change}: {event.cause}")

    def _run(self) -> None:
        while (event := self._events.get()) is not None:
            if event.change in _RECORDED:
                self._record(event)
            self._notify(event)

    def _notify(self, event: StatusEvent) -> None:
        # Apart from what waits: its frame would keep the last listener, that has left or not.
        for listener in self._listeners:
            try:
                foreign(listener, event)
            except Exception as error:  # noqa: BLE001 - a listener may raise anything
                text = f"listener {name_of(listener)} failed at event {event.number}"
                self._failures.write(logging.ERROR, text, error)


class EventLog:
    """Writes events of the control plane to the logger `uoarm.control`, at debug level.

    In a lane: a handler is foreign, and may wait for the thread that handles events.
    """

    def __init__(self, lanes: Lanes) -> None:
        self._lanes = lanes

    def write(self, event: Event, now: float) -> None:
        """Have an event written behind those before it. Waits for nothing, and raises nothing."""
        if _log_of_events.logger.isEnabledFor(logging.DEBUG):
            with suppress(Exception):  # of what the event carries
                text = write_event(event, now)
                self._lanes.put(_LANE, partial(_log_of_events.debug, "%s", text))

    def close(self) -> None:
        """Wait until all is written, two seconds at most."""
        if _log_of_events.logger.isEnabledFor(logging.DEBUG):
            is_written = threading.Event()
            self._lanes.put(_LANE, is_written.set)
            is_written.wait(_CLOSE_SECONDS)


def _without(
    callbacks: tuple[Callable[[StatusEvent], None], ...], gone: Callable[[StatusEvent], None]
) -> tuple[Callable[[StatusEvent], None], ...]:
    return tuple(callback for callback in callbacks if callback is not gone)
