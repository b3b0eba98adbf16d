"""Heterogeneous applications: a browser and a terminal, in two environments, at the same time."""

from __future__ import annotations

import asyncio
from collections import Counter
from contextlib import suppress

from applications import browser_visit, terminal_visit
from stage import head, stage, table

from uoarm.client import connect

_LOOK_SECONDS = 0.1


async def look(url: str, held: Counter[str], most: Counter[str]) -> None:
    """Note how often each function is open, and by how many connections at most at one time."""
    async with connect(url) as robot:
        while True:
            functions = Counter(
                connection["function"] for connection in (await robot.status())["connections"]
            )
            held.update(functions.keys())
            for name, count in functions.items():
                most[name] = max(most[name], count)
            await asyncio.sleep(_LOOK_SECONDS)


async def main() -> None:
    """Run both applications twice: at the same time, beside a client that watches."""
    held: Counter[str] = Counter()
    most: Counter[str] = Counter()
    with stage() as scene:
        robot = scene.places.robot_url
        looking = asyncio.create_task(look(robot, held, most))
        visits = await asyncio.gather(
            browser_visit(scene.places.page_url), terminal_visit(robot), terminal_visit(robot)
        )
        looking.cancel()
        with suppress(asyncio.CancelledError):
            await looking
        async with connect(robot) as client:
            left = len((await client.status())["connections"])
    names = ("browser, HTML and JavaScript", "terminal, Node.js", "terminal, Node.js, a second one")
    head("Heterogeneous applications")
    table(
        ("application", "greeting", "outcome", "seconds"),
        [
            (name, visit.greeting, visit.outcome, f"{visit.seconds:.0f}")
            for name, visit in zip(names, visits, strict=True)
        ],
    )
    table(
        ("function", "connections of the robot at one time, at most"),
        [(name, str(count)) for name, count in most.items()],
    )
    print(f"Connections left when all had gone: {left}.")


if __name__ == "__main__":
    asyncio.run(main())
