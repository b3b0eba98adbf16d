"""Dynamic monitoring: kill each part in turn, and see who is told, what is lost, and what recovers.

A part is killed as a crash would kill it. Two applications are connected: one uses the function,
one only watches. Then the part is started again.
"""

from __future__ import annotations

import asyncio
import os
import signal
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from attrs import define, field
from stage import Stage, head, stage, table

from uoarm.client import connect
from uoarm.errors import UoarmError

_SETTLED = 3.0
_WINDOW = 14.0
_RETURN = 60.0
_FIRST = 60.0
_NOTHING = "nothing"


@define
class Observed:
    """What a user and a watcher of one function saw; times of the monotonic clock."""

    arrivals: list[float] = field(factory=list)
    changes: list[tuple[float, str]] = field(factory=list)
    ended: str = ""

    def told(self, since: float) -> tuple[str, str]:
        """Return how long until the first change was told, and all that were."""
        later = [(moment, text) for moment, text in self.changes if moment >= since]
        noticed = f"{later[0][0] - since:.2f} s" if later else "never"
        words = dict.fromkeys(text for _, text in later)
        if self.ended:
            words[f"the user: {self.ended.splitlines()[0][:60]}"] = None
        return noticed, "; ".join(words) or "nobody"

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


def host_of(scene: Stage, library: str) -> int:
    """Return the process of `uoarm serve` in which a bridge with this library runs.

    Raises:
        LookupError: there is none.
    """
    robot = scene.crew["robot"].process.pid
    children = Path(f"/proc/{robot}/task").glob("*/children")
    for pid in {int(word) for each in children for word in each.read_text().split()}:
        if library in Path(f"/proc/{pid}/maps").read_text():
            return pid
    raise LookupError(f"no process of the robot has loaded {library}")


async def stream_row(scene: Stage, part: str, name: str, library: str = "") -> list[str]:
    """Kill a part behind a stream, or the host of a bridge; return a row of the table."""
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
        if library:
            os.kill(host_of(scene, library), signal.SIGKILL)
        else:
            scene.crew.kill(part)
        await asyncio.sleep(_WINDOW)
        after = await using(url, name)
        noticed, told = seen.told(killed)
        gap = seen.gap(killed)
        lost = f"{gap:.2f} s, about {max(0, round(gap * rate) - 1)}" if gap else "all"
        if not library:
            await asyncio.to_thread(scene.crew.start, scene.parts[part])

        async def returned() -> bool:
            return await using(url, name) == before

        back = await until(returned, _RETURN)
        title = part if library else f"{part} ({scene.parts[part].framework})"
        same = "the same components"
        returning = f"{back:.1f} s" if back is not None else "no"
        went_on = after if after != before else same
        return [title, name, noticed, told, lost, went_on, "" if went_on == same else returning]
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def robot_row(scene: Stage) -> list[str]:
    """Kill the robot manager's own process; its users must come again."""
    url, seen = scene.places.robot_url, Observed()
    user = asyncio.create_task(use(url, "pulseRate", seen))

    async def flows() -> bool:
        return len(seen.arrivals) > 1

    async def ended() -> bool:
        return user.done()

    await until(flows, _FIRST)
    scene.crew.kill("robot")
    noticed = await until(ended, _FIRST)
    begun = time.monotonic()
    await asyncio.to_thread(scene.crew.start, scene.parts["robot"])
    again = Observed()
    user = asyncio.create_task(use(url, "pulseRate", again))
    await until(lambda: _some(again), _FIRST)
    back = f"{again.arrivals[0] - begun:.1f} s" if again.arrivals else "no"
    user.cancel()
    await asyncio.gather(user, return_exceptions=True)
    told = f"the user: {seen.ended.splitlines()[0][:60]}" if seen.ended else "nobody"
    soon = f"{noticed:.2f} s" if noticed is not None else "never"
    return ["robot (uoarm)", "pulseRate", soon, told, "all until it asks again", "nothing", back]


async def _some(seen: Observed) -> bool:
    return bool(seen.arrivals)


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
            await stream_row(scene, "host of the OpenRTM bridge", "faceDetection", "omnipy"),
            await stream_row(scene, "host of the ROS 2 bridge", "faceDetection", "rclpy"),
            await call_row(scene, "cuff", "bloodPressure", {}),
            await call_row(scene, "records", "patientRecord", pulse),
            await robot_row(scene),
        ]
    head("Dynamic monitoring")
    table(
        ("killed", "seen through", "noticed after", "told", "lost", "went on with", "back after"),
        rows,
    )


if __name__ == "__main__":
    asyncio.run(main())
