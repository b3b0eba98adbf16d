"""Compatibility: the same two applications on another robot, where every provider is another one.

Nothing but the robot file is exchanged: robot.yaml for robot-plain.yaml.
"""

from __future__ import annotations

import asyncio

from applications import browser_visit, terminal_visit
from stage import Stage, head, stage, table

from uoarm.client import connect

_FILES = ("robot.yaml", "robot-plain.yaml")
_HELPERS = {"spareOximetry"}


async def providers(scene: Stage) -> dict[str, str]:
    """Return who provides each function now."""
    async with connect(scene.places.robot_url) as robot:
        names = [
            function["name"]
            for function in await robot.functions()
            if function["name"] not in _HELPERS
        ]
        plans = {name: (await robot.resolve(name))["plan"] for name in names}
    return {name: plan["steps"][-1]["component"]["name"] for name, plan in plans.items()}


async def main() -> None:
    """Visit both robots with both applications."""
    who, visits = [], []
    for file in _FILES:
        with stage(file) as scene:
            who.append(await providers(scene))
            terminal = await terminal_visit(scene.places.robot_url)
            browser = await browser_visit(scene.places.page_url)
        visits += [(file, "terminal, Node.js", terminal), (file, "browser", browser)]
    head("Compatibility")
    ours, other = who
    table(("function", *_FILES), [(name, ours[name], other[name]) for name in ours])
    table(
        ("robot", "application, unchanged", "greeting", "outcome"),
        [(file, name, visit.greeting, visit.outcome) for file, name, visit in visits],
    )
    same = [name for name in ours if ours[name] == other[name]]
    print(f"Functions whose provider is the same on both: {', '.join(same) or 'none'}.")


if __name__ == "__main__":
    asyncio.run(main())
