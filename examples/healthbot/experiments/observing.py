"""What an application sees: one that uses a function, and one that only watches."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress

from attrs import define, field

from uoarm.client import connect
from uoarm.errors import UoarmError

__all__ = ["NOTHING", "Observed", "until", "use", "using", "watch"]

NOTHING = "nothing"


@define
class Observed:
    """What a user and a watcher of one function saw; times of the monotonic clock."""

    arrivals: list[float] = field(factory=list)
    changes: list[tuple[float, str]] = field(factory=list)
    ended: str = ""

    def notified(self, since: float) -> tuple[float | None, str]:
        """Return how long until the first change was reported, and all that were."""
        later = [(moment, text) for moment, text in self.changes if moment >= since]
        noticed = later[0][0] - since if later else None
        words = dict.fromkeys(text for _, text in later)
        if self.ended:
            words[f"the user: {self.ended.splitlines()[0][:60]}"] = None
        return noticed, "; ".join(words) or "no one"

    def gap(self, since: float) -> float | None:
        """Return how long the user went without a message, None while none came again."""
        after = [moment for moment in self.arrivals if moment > since]
        pairs = zip([since, *after], after, strict=False)
        return max((later - earlier for earlier, later in pairs), default=None)


async def use(url: str, name: str, seen: Observed, *, resume: bool = True) -> None:
    """Be the application that uses a stream; without `resume` a drop of its link ends it."""
    async with connect(url, resume=resume) as robot:
        try:
            async for _ in await robot.request(name):
                seen.arrivals.append(time.monotonic())
        except UoarmError as error:
            seen.ended = str(error)


async def watch(url: str, seen: Observed) -> None:
    """Be the application that watches."""
    async with connect(url) as robot:
        with suppress(UoarmError):
            async for event in robot.watch():
                text = f"{event.subject} {event.change}"
                seen.changes.append((time.monotonic(), text))


async def using(url: str, name: str) -> str:
    """Return the components behind the only connection."""
    async with connect(url) as robot:
        for connection in (await robot.status())["connections"]:
            if connection["function"] == name:
                return ", ".join(connection["components"])
    return NOTHING


async def until(what: Callable[[], Awaitable[bool]], seconds: float) -> float | None:
    """Return how long it took until something was so, None when it never was."""
    begun = time.monotonic()
    while time.monotonic() - begun < seconds:
        if await what():
            return time.monotonic() - begun
        await asyncio.sleep(0.1)
    return None
