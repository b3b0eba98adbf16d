"""Waiting in asyncio with a deadline, without losing a cancellation.

`asyncio.wait_for` may return as if nothing was when it is cancelled at the moment at which that
ends which it waits for, before CPython 3.12: https://github.com/python/cpython/issues/86296.
So nothing here, and nothing else in uoarm, uses it.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable
from typing import TypeVar

T = TypeVar("T")


async def event_by(event: asyncio.Event, deadline: float | None) -> None:
    """Return when the event is set; it is set, too, when the loop's clock shows `deadline`."""
    if deadline is None:
        await event.wait()
        return
    timer = asyncio.get_running_loop().call_at(deadline, event.set)
    try:
        await event.wait()
    finally:
        timer.cancel()


async def result_within(seconds: float, work: Awaitable[T]) -> T:
    """Return what a coroutine or future comes to; it is cancelled when that takes too long.

    A cancellation of the caller cancels it, too, and is always passed on.

    Raises:
        asyncio.TimeoutError: it took too long.
        BaseException: what it raised.
    """
    task = asyncio.ensure_future(work)
    task.add_done_callback(lambda done: done.cancelled() or done.exception())
    try:
        await asyncio.wait({task}, timeout=seconds)
    finally:
        if task.cancel():
            await asyncio.wait({task})
    if task.cancelled():
        raise asyncio.TimeoutError
    return task.result()
