"""How much of what one client sends is taken on, and where it is decoded."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from uoarm.server._limits import Limits

__all__ = ["Decoder", "RateLimiter"]

T = TypeVar("T")
# Decoding costs at most some 0.3 us for each octet, so 2 ms for a frame of this length.
_QUICK_OCTETS = 8192


class RateLimiter:
    """Says how long to wait before a client is read on: a token bucket for each rate, no clock.

    A bucket holds one second's worth. A message is always taken, and may overdraw a bucket by
    whatever it costs: the wait after it makes up for that.

    Args:
        limits: the rates.
        now: seconds.
    """

    def __init__(self, limits: Limits, now: float) -> None:
        self._rates = (
            limits.messages_per_second,
            limits.octets_per_second,
            limits.elements_per_second,
        )
        self._left = list(self._rates)
        self._at = now

    def spend(self, now: float, *, octets: int, elements: int) -> float:
        """Count one message; returns the seconds to wait before the next is read, mostly 0."""
        passed, self._at = max(0.0, now - self._at), now
        wait = 0.0
        for place, cost in enumerate((1, octets, elements)):
            rate = self._rates[place]
            left = min(rate, self._left[place] + passed * rate) - cost
            self._left[place] = left
            if left < 0:
                wait = max(wait, -left / rate)
        return wait


class Decoder:
    """Runs decoding in the loop where it is quick, and otherwise in the one thread of all clients.

    One thread, because decoders hold the interpreter's lock: two would only take memory for two
    messages at a time. A client is not read on meanwhile, so each has one place in the queue.
    """

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="uoarm-decode")

    async def run(self, octets: int, decode: Callable[[], T]) -> T:
        """Return the result of `decode`, which takes time in proportion to `octets`."""
        if octets <= _QUICK_OCTETS:
            return decode()
        return await asyncio.get_running_loop().run_in_executor(self._thread, decode)

    def close(self) -> None:
        """Begin with nothing more; does not wait for what is under way."""
        self._thread.shutdown(wait=False, cancel_futures=True)
