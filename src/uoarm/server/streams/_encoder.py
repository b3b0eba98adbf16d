"""Where messages are written that take long: beside the loop, by one thread for all clients."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

from uoarm._wire import is_octets
from uoarm.model import Message

__all__ = ["Encoder", "takes_long"]

T = TypeVar("T")
# A number takes at most some 0.5 us to write, and 256 octets less: so some 2 ms.
_QUICK = 4096
_OCTETS_SHIFT = 8
_SCALARS = frozenset({int, float, bool, type(None)})
_TEXTS = frozenset({str, bytes, bytearray, memoryview})


def takes_long(message: Message) -> bool:
    """Say whether a message takes more than some 2 ms to write in any form; quick to say."""
    left = _QUICK
    waiting: list[Any] = [message]
    for item in waiting:
        kind = type(item)
        if kind in _SCALARS:
            continue
        if kind is dict or kind is list or kind is tuple:
            left -= len(item)
            if left >= 0:
                waiting += item.values() if kind is dict else item
        elif kind in _TEXTS:
            left -= len(item) >> _OCTETS_SHIFT
        elif is_octets(item):
            left -= item.nbytes >> _OCTETS_SHIFT
        else:  # an array of numbers, of the standard library or of numpy
            left -= getattr(item, "size", 0) or (len(item) if hasattr(item, "__len__") else 0)
        if left < 0:
            return True
    return False


class Encoder:
    """One thread in which long messages are written.

    One, because writers hold the interpreter's lock: several would keep the loop waiting for it,
    and take memory for as many messages at a time.
    """

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="uoarm-encode")
        self._closed = False

    def start(self, write: Callable[[], object]) -> asyncio.Future[object] | None:
        """Begin to write, from the loop's thread; None after `close`."""
        if self._closed:
            return None
        return asyncio.get_running_loop().run_in_executor(self._thread, write)

    def wait(self, message: Message, write: Callable[[], T]) -> T:
        """Return what `write` makes of a message, in a worker: it waits for its turn."""
        if self._closed or not takes_long(message):
            return write()
        return self._thread.submit(write).result()

    def close(self) -> None:
        """Begin with nothing more; does not wait for what is under way."""
        self._closed = True
        self._thread.shutdown(wait=False)
