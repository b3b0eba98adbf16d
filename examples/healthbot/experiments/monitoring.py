"""Dynamic monitoring: kill each part in turn, and see who is told, what is lost, and what recovers.

A part is killed as a crash would kill it. Two applications are connected: one uses the function,
one only watches. Then the part is started again.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any

from attrs import define, field
from stage import Stage, head, stage, table

from uoarm.client import connect
from uoarm.errors import UoarmError

_SETTLED = 3.0
_WINDOW = 12.0
_RETURN = 30.0
_FIRST = 60.0
_NOTHING = "nothing"


@define
class Observed:
    """What a user and a watcher of one function saw; times of the monotonic clock."""

    arrivals: list[float] = field(factory=list)
    changes: list[tuple[float, str]] = field(factory=list)
    ended: str = ""

    def first_change(self, since: float) -> tuple[str, str]:
        """Return how long until a change was told, and what it said."""
        for moment, text in self.changes:
            if moment >= since:
                return f"{moment - since:.2f} s", text
        return "never", ""

    def gap(self, since: float) -> float | None:
        """Return how long the user went without a message, None while none came again."""
        after = [moment for moment in self.arrivals if moment > since]
        pairs = zip([since, *after], after, strict=False)
        return max((later - earlier for earlier, later in pairs), default=None)


async def use(url: str, name: str, seen: Observed) -> None:
    """Be the application that uses a stream."""
    async with connect(url) as robot:
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
    return _NOTHING


async def until(what: Callable[[], Awaitable[bool]], seconds: float) -> float | None:
    """Return how long it took until something was so, None when it never was."""
    begun = time.monotonic()
    while time.monotonic() - begun < seconds:
        if await what():
            return time.monotonic() - begun
        await asyncio.sleep(0.1)
    return None


async def stream_row(scene: Stage, part: str, name: str) -> list[str]:
    """Kill a part behind a stream; return a row of the table."""
    url, seen = scene.places.robot_url, Observed()
    tasks = [asyncio.create_task(use(url, name, seen)), asyncio.create_task(watch(url, seen))]
    try:

        async def flows() -> bool:
            return len(seen.arrivals) > 1

        if await until(flows, _FIRST) is None:
            return [part, name, f"no message before: {seen.ended}", "", "", "", ""]
        await asyncio.sleep(_SETTLED)
        before = await using(url, name)
        rate = len(seen.arrivals) / (time.monotonic() - seen.arrivals[0])
        killed = time.monotonic()
        scene.crew.kill(part)
        await asyncio.sleep(_WINDOW)
        after = await using(url, name)
        noticed, told = seen.first_change(killed)
        gap = seen.gap(killed)
        lost = f"{gap:.2f} s, about {max(0, round(gap * rate) - 1)}" if gap else "all"
        await asyncio.to_thread(scene.crew.start, scene.parts[part])

        async def returned() -> bool:
            return await using(url, name) == before

        back = await until(returned, _RETURN)
        return [
            f"{part} ({scene.parts[part].framework})",
            name,
            noticed,
            told or (seen.ended and f"the user: {seen.ended}") or "nobody",
            lost,
            after if after != before else "itself: nothing changed",
            f"{back:.1f} s" if back is not None else "no",
        ]
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def called(url: str, name: str, request: Any) -> tuple[str, float]:
    """Call a service; return what came of it and how long it took."""
    begun = time.monotonic()
    async with connect(url) as robot:
        try:
            reply = await robot.call(name, request, timeout=40.0)
        except UoarmError as error:
            return str(error).splitlines()[0][:80], time.monotonic() - begun
    kept = {key: value for key, value in reply.items() if key in _KEPT}
    return ", ".join(f"{key} {value}" for key, value in kept.items()), time.monotonic() - begun


_KEPT = ("systolic", "diastolic", "stored", "waiting", "played")


async def call_row(scene: Stage, part: str, name: str, request: Any) -> list[str]:
    """Kill a part behind a service; return a row of the table."""
    url = scene.places.robot_url
    await called(url, name, request)
    scene.crew.kill(part)
    without, seconds = await called(url, name, {**request, **_other(request)})
    await asyncio.to_thread(scene.crew.start, scene.parts[part])
    again, _ = await called(url, name, {**request, **_other(request)})
    framework = scene.parts[part].framework
    told = "whoever calls, in the reply"
    return [f"{part} ({framework})", name, f"{seconds:.2f} s", told, "nothing", without, again]


def _other(request: Any) -> Any:
    """Return what makes a measurement another one."""
    return {"value": time.monotonic() % 40 + 50} if "value" in request else {}


async def main() -> None:
    """Kill everything once."""
    pulse = {"patient": "test", "kind": "pulse", "value": 70, "time": "2026-01-01T00:00:00Z"}
    with stage() as scene:
        rows = [
            await stream_row(scene, "camera", "faceDetection"),
            await stream_row(scene, "detector", "faceDetection"),
            await stream_row(scene, "naming", "faceDetection"),
            await stream_row(scene, "clip", "pulseRate"),
            await stream_row(scene, "clip", "bloodOxygen"),
            await call_row(scene, "cuff", "bloodPressure", {}),
            await call_row(scene, "records", "patientRecord", pulse),
        ]
    head("Dynamic monitoring")
    table(
        ("killed", "seen through", "noticed after", "told", "lost", "went on with", "back after"),
        rows,
    )


if __name__ == "__main__":
    asyncio.run(main())
