"""Scripts: sources of the `python` bridge that emit what a test puts, while it runs."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterator
from types import GenericAlias
from typing import Any, ClassVar

__all__ = ["Script"]


class Script:
    """What a source of the `python` bridge emits, put there by the test while the robot runs.

    What is put waits for the newest source of the script that opens, and for no other. A source
    takes from the moment in which it opens, before its connection is told as running: not only
    once its thread has begun. One that is closed takes nothing, though its thread may be
    waiting still, and neither does one after which another opened.

    ``numbers = script.source(Number)`` in a module of tests makes the component that a
    configuration names as ``module:numbers``. May be used from any thread.

    Attributes:
        END: put, it ends the source as one that has no more messages.
        started: how often a source of it has opened since the last `reset`.
    """

    END: ClassVar[object] = object()

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._items: deque[object] = deque()
        self._newest: _Run | None = None
        self.started = 0

    def put(self, *items: object) -> None:
        """Have these emitted, in order; an exception is raised by the source instead."""
        with self._changed:
            self._items.extend(items)
            self._changed.notify_all()

    def reset(self) -> None:
        """Forget what was put, and end what still plays. Twice is once."""
        with self._changed:
            self._items.clear()
            self._newest = None
            self.started = 0
            self._changed.notify_all()

    def source(self, hint: Any) -> type:
        """Return a component that emits what is put, with messages of the hinted structure."""
        script = self

        class Source:
            def __init__(self) -> None:
                self._run: _Run | None = None

            def __iter__(self) -> Iterator[Any]:
                self._run = script._begin()  # in the thread that opens, unlike a generator's body
                return self._run

            def close(self) -> None:
                if self._run is not None:
                    script._end(self._run)

        Source.__iter__.__annotations__["return"] = GenericAlias(Iterator, (hint,))
        return Source

    def _begin(self) -> _Run:
        with self._changed:
            self._newest = _Run(self._take)
            self.started += 1
            self._changed.notify_all()
            return self._newest

    def _end(self, run: _Run) -> None:
        with self._changed:
            if self._newest is run:
                self._newest = None
                self._changed.notify_all()

    def _take(self, run: _Run) -> object:
        """Wait for the next item of a run; `END` once it is not the newest."""
        with self._changed:
            self._changed.wait_for(lambda: self._newest is not run or self._items)
            return self._items.popleft() if self._newest is run else self.END


class _Run(Iterator[Any]):
    """One source from its opening to its end."""

    def __init__(self, take: Callable[[_Run], object]) -> None:
        self._take = take

    def __next__(self) -> Any:
        item = self._take(self)
        if item is Script.END:
            raise StopIteration
        if isinstance(item, Exception):
            raise item
        return item
