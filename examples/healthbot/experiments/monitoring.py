"""Dynamic monitoring: each part is killed in turn: who is notified, what is lost and recovers.

A part is killed as a crash would kill it. Two applications are connected: one uses the function,
one only watches. Then the part is started again.
"""

from __future__ import annotations

import argparse
import asyncio
import os
import signal
import time
from pathlib import Path
from typing import Any

from attrs import asdict, frozen
from observing import NOTHING, Observed, until, use, using, watch
from stage import Stage, host_of, load, machine, record, stage, table, writable

from uoarm.client import connect
from uoarm.errors import UoarmError

_SETTLED = 3.0
_WINDOW = 14.0
_RETURN = 60.0
_FIRST = 60.0
_HEAD = (
    *("killed", "seen through", "noticed after", "reported"),
    *("lost", "went on with", "back after"),
)
_SAME = "the same components"


@frozen
class Death:
    """What became of a death.

    Attributes:
        killed: the part.
        function: through which it was seen.
        noticed: seconds until a client was notified; None: none ever was.
        notified: who, and what.
        silence: seconds without a message; None where nothing flows, or none came again.
        lost: what the user missed.
        went_on: what it went on with.
        back: seconds from the part's start until the user had it again; None: it had not.
        answer: the reply that a caller got once the part was back.
    """

    killed: str
    function: str
    noticed: float | None
    notified: str
    lost: str
    went_on: str
    silence: float | None = None
    back: float | None = None
    answer: str = ""

    def row(self) -> tuple[str, ...]:
        """Return a row of the table."""
        noticed = "never" if self.noticed is None else f"{self.noticed:.2f} s"
        back = self.answer or ("no" if self.back is None else f"{self.back:.1f} s")
        if self.went_on == _SAME:
            back = ""
        return self.killed, self.function, noticed, self.notified, self.lost, self.went_on, back


async def stream_row(scene: Stage, part: str, name: str, library: str = "") -> Death:
    """Kill a part behind a stream, or the host of a bridge; return what became of it."""
    url, seen = scene.places.robot_url, Observed()
    tasks = [asyncio.create_task(use(url, name, seen)), asyncio.create_task(watch(url, seen))]
    try:

        async def flows() -> bool:
            return len(seen.arrivals) > 1

        if await until(flows, _FIRST) is None:
            return Death(part, name, None, f"no message before: {seen.ended}", "", "")
        await asyncio.sleep(_SETTLED)
        before = await using(url, name)
        rate = len(seen.arrivals) / (time.monotonic() - seen.arrivals[0])
        killed = time.monotonic()
        if library:
            os.kill(host_of(scene.crew["robot"].process.pid, library), signal.SIGKILL)
        else:
            scene.crew.kill(part)
        await asyncio.sleep(_WINDOW)
        after = await using(url, name)
        noticed, text = seen.notified(killed)
        gap = seen.gap(killed)
        lost = f"{gap:.2f} s, about {max(0, round(gap * rate) - 1)}" if gap else "all"
        if not library:
            await asyncio.to_thread(scene.crew.start, scene.parts[part])

        async def returned() -> bool:
            return await using(url, name) == before

        back = await until(returned, _RETURN)
        title = part if library else f"{part} ({scene.parts[part].framework})"
        went_on = after if after != before else _SAME
        return Death(title, name, noticed, text, lost, went_on, gap, back)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def robot_row(scene: Stage) -> Death:
    """Kill the robot manager's own process; its users must come again."""
    url, seen = scene.places.robot_url, Observed()
    user = asyncio.create_task(use(url, "pulseRate", seen, resume=False))

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
    back = again.arrivals[0] - begun if again.arrivals else None
    user.cancel()
    await asyncio.gather(user, return_exceptions=True)
    text = f"the user: {seen.ended.splitlines()[0][:60]}" if seen.ended else "no one"
    lost = "all until it asks again"
    return Death("robot (uoarm)", "pulseRate", noticed, text, lost, NOTHING, None, back)


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


async def call_row(scene: Stage, part: str, name: str, request: Any) -> Death:
    """Kill a part behind a service; return what became of it."""
    url = scene.places.robot_url
    await called(url, name, request)
    scene.crew.kill(part)
    without, seconds = await called(url, name, {**request, **_other(request)})
    await asyncio.to_thread(scene.crew.start, scene.parts[part])
    again, _ = await called(url, name, {**request, **_other(request)})
    title = f"{part} ({scene.parts[part].framework})"
    text = "the caller, in the reply"
    return Death(title, name, seconds, text, NOTHING, without, answer=again)


def _other(request: Any) -> Any:
    """Return what makes a measurement another one."""
    return {"value": time.monotonic() % 40 + 50} if "value" in request else {}


async def main(file: Path | None) -> None:
    """Kill everything once; write what became of it to a file, for plots, where one is given."""
    pulse = {"patient": "test", "kind": "pulse", "value": 70, "time": "2026-01-01T00:00:00Z"}
    before = load()
    with stage() as scene:
        deaths = [
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
    measured = machine(before)
    print(f"Dynamic monitoring, {measured}\n")
    table(_HEAD, [death.row() for death in deaths])
    if file is not None:
        record(file, measured, [asdict(death) for death in deaths])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--record", type=writable, metavar="FILE", help="write the figures as JSON")
    asyncio.run(main(parser.parse_args().record))
