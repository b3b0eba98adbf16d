"""Sources: the thread that iterates over a component, for as long as somebody listens."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable, Iterator
from typing import Any

from uoarm._raised import foreign
from uoarm._workers import WorkerPool
from uoarm.errors import BridgeError, FailureReason

__all__ = ["IteratedSource"]

Finished = Callable[[Exception | None], None]


class IteratedSource:
    """Iterates in a worker thread from the first listener's coming to the last one's leaving.

    May be used from any thread.

    Args:
        iterate: makes the iterator; called in the listener's thread, so that it may refuse.
        emitter: returns what takes the next message; called in the source's thread before it is
            known whether somebody listens still, so that no message is lost between.
        name: of the thread meanwhile.
        workers: give the thread.

    Attributes:
        failure: what the iteration raised; it is not begun again.
    """

    def __init__(
        self,
        iterate: Callable[[], Iterator[Any]],
        emitter: Callable[[], Callable[[Any], None]],
        name: str,
        workers: WorkerPool,
    ) -> None:
        self._iterate = iterate
        self._emitter = emitter
        self._name = name
        self._workers = workers
        self._changing = threading.Lock()
        self._listeners: dict[Hashable, Finished] = {}
        self._run: _Run | None = None
        self.failure: Exception | None = None

    def add_listener(self, key: Hashable, finished: Finished) -> None:
        """Start iterating unless it does already.

        `finished` hears of the end, with the exception if there was one, unless `key` was removed
        before.

        Raises:
            BridgeError: the workers were closed.
        """
        with self._changing:
            failure = self.failure
            if self._run is None and failure is None:
                run = _Run(self._iterate(), self._emitter, self._ended, self._name)
                if not self._workers.submit(run.work):
                    raise BridgeError(f"{self._name} is closed", FailureReason.CLOSED)
                self._run = run
            self._listeners[key] = finished
        if failure is not None:
            finished(failure)

    def remove_listener(self, key: Hashable) -> None:
        """Forget a listener; after the last one the iteration ends with the next message."""
        with self._changing:
            self._listeners.pop(key, None)
            if not self._listeners:
                self._stop()

    def stop(self) -> None:
        """Tell the iteration to end, and nobody of it."""
        with self._changing:
            self._listeners.clear()
            self._stop()

    def _stop(self) -> None:
        if self._run is not None:
            self._run.stopped = True
            self._run = None
            # Its thread may be in foreign code for long: the next start shall not wait for another.
            self._workers.prepare()

    def _ended(self, run: _Run, failure: Exception | None) -> None:
        with self._changing:
            if self._run is not run:
                return
            self._run = None
            self.failure = failure
            listeners = list(self._listeners.values())
        for finished in listeners:
            finished(failure)


class _Run:
    """One iteration from its beginning to its end."""

    def __init__(
        self,
        messages: Iterator[Any],
        emitter: Callable[[], Callable[[Any], None]],
        ended: Callable[[_Run, Exception | None], None],
        name: str,
    ) -> None:
        self._messages = messages
        self._emitter = emitter
        self._ended = ended
        self._name = name
        self.stopped = False

    def work(self) -> None:
        thread = threading.current_thread()
        before, thread.name = thread.name, self._name
        try:
            self._iterate()
        finally:
            thread.name = before

    def _iterate(self) -> None:
        failure: Exception | None = None
        for step in (self._emit_all, self._close):
            try:
                foreign(step)
            except Exception as error:  # noqa: BLE001 - a component may raise anything
                failure = failure or error
        self._ended(self, failure)

    def _emit_all(self) -> None:
        for message in self._messages:
            emit = self._emitter()
            if self.stopped:
                break
            emit(message)

    def _close(self) -> None:
        close = getattr(self._messages, "close", None)
        if callable(close):
            close()
