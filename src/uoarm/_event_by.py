"""Waiting for an event of asyncio with a deadline, in the task that waits.

`asyncio.wait_for` runs what it waits for in a task of its own, and before CPython 3.12 it may
return as if nothing was when it is cancelled at the moment at which that task ends:
https://github.com/python/cpython/issues/86296
"""

from __future__ import annotations

import asyncio

__all__ = ["event_by"]


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
