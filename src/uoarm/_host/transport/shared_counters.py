"""How far each flow is, in memory that both processes map, so that no death hides it."""

from __future__ import annotations

import mmap
import tempfile
import threading
from array import array
from collections import deque
from typing import IO

_SLOTS = 4096
_WIDTH = 8


class SharedCounters:
    """Counters in a file without a name, which both ends have open.

    Args:
        file: its descriptor, which may be closed afterwards.
        gives: whether this end gives out the counters.
    """

    def __init__(self, file: int, *, gives: bool) -> None:
        # A slot has one writer, and is aligned, so that its number is read whole without a lock
        # that two processes would have to share, and a death could leave held.
        shared = mmap.mmap(file, _SLOTS * _WIDTH)
        self.numbers: memoryview | array[int] = memoryview(shared).cast("q")
        self._free = deque(SharedCounter(self, slot) for slot in range(_SLOTS if gives else 0))
        # Guards the free counters, from the threads that open and close channels of one bridge.
        self._lock = threading.Lock()

    @staticmethod
    def make_file() -> IO[bytes]:
        """Return a file for counters that stand at nought.

        Raises:
            OSError: there is no room for it.
        """
        file = tempfile.TemporaryFile()  # noqa: SIM115 - the caller closes it
        try:
            file.write(bytes(_SLOTS * _WIDTH))
            file.flush()
        except OSError:
            file.close()
            raise
        return file

    def counter(self) -> SharedCounter | None:
        """Give out a counter that stands at nought; None when there is none left."""
        with self._lock:
            if not self._free:
                return None
            # The one that has been free for longest: its last reader has the best chance to be
            # gone.
            before = self._free.popleft()
            before.end()
            counter = SharedCounter(self, before.slot)
        counter.set(0)
        return counter

    def take_back(self, counter: SharedCounter | None) -> None:
        """Have a counter given out again, after all those that are free; it counts till then."""
        if counter is not None:
            with self._lock:
                self._free.append(counter)

    def close(self) -> None:
        """Let go of the memory; counters stand still from now on."""
        # A copy first: readers may come at any time, and must not find the map closed.
        self.numbers = array("q", self.numbers)  # the map ends with its last reader


class Handling(threading.local):
    """The message that this thread hands to a component.

    Attributes:
        counter: of those that the component has taken; None: this thread hands none.
        number: of this one among them.
    """

    counter: SharedCounter | None = None
    number = 0

    def answered(self) -> None:
        """Count the message as taken, as something comes of it: else it would be lost as well."""
        if self.counter is not None:
            self.counter.set(self.number)


HANDLING = Handling()


class SharedCounter:
    """One of the shared counters: written by one end, read by either.

    Args:
        counters: that it is part of.
        slot: where; the end that gave it out has sent it to the other.
    """

    __slots__ = ("_counters", "_last", "slot")

    def __init__(self, counters: SharedCounters, slot: int) -> None:
        self._counters = counters
        self.slot = slot
        self._last: int | None = None

    def set(self, value: int) -> None:
        self._counters.numbers[self.slot] = value

    def read(self) -> int:
        """Return the number as it is now, or was when they were closed or it was given out anew."""
        return self._counters.numbers[self.slot] if self._last is None else self._last

    def end(self) -> None:
        """Stand still from now on."""
        self._last = self.read()
