"""Ctrl-C while something is half done: it is raised when that is whole, or when it comes again.

Python raises KeyboardInterrupt in the main thread, after any call. Where that thread owns what
others share, half of a change would be lost, and nobody could know which half.
"""

from __future__ import annotations

import _signal  # type: ignore[import-not-found]  # what `signal` wraps, at fifteen times the cost
import signal
import threading
from types import FrameType, TracebackType
from typing import Any

__all__ = ["Uninterrupted"]

_SIGINT = int(signal.SIGINT)


class _Here(threading.local):
    is_put_off = False


_here = _Here()


class Uninterrupted:
    """Puts Ctrl-C off to the end of a `with` block; a second one is raised at once.

    So what hangs in the block can be left still. Does nothing in other threads than the main one,
    which are never interrupted, and within another such block. One that comes as the block begins
    is raised before it. Each is for one block.
    """

    __slots__ = ("_came", "_handler")

    def __init__(self) -> None:
        self._handler: Any = None
        self._came: list[FrameType | None] = []

    def __enter__(self) -> None:
        if threading.get_ident() != threading.main_thread().ident or _here.is_put_off:
            return
        handler = _signal.getsignal(_SIGINT)
        if callable(handler):  # what is no function raises nothing
            _here.is_put_off = True
            self._handler = handler
            _signal.signal(_SIGINT, self._note)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._handler is None:
            return
        self._put_back()
        if self._came:
            self._handler(_SIGINT, self._came.pop())

    def _note(self, number: int, frame: FrameType | None) -> None:
        if not self._came:
            self._came.append(frame)
            return
        self._came.clear()
        self._put_back()
        self._handler(number, frame)

    def _put_back(self) -> None:
        """Have the handler that was there before, unless somebody has set another meanwhile."""
        _here.is_put_off = False
        if _signal.getsignal(_SIGINT) == self._note:
            _signal.signal(_SIGINT, self._handler)
