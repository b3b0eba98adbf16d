"""Interoperability: of every function the chain of frameworks, the types, the first message."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping
from typing import Any

from stage import head, stage, table

from uoarm.client import RemoteRobot, connect
from uoarm.errors import UoarmError

_FRAMEWORKS = {
    "ros": "ROS 2",
    "rtm": "OpenRTM",
    "devices": "ROCOS profile",
    "parts": "plain Python",
    "records": "plain Python",
}
_CALLS: Mapping[str, dict[str, Any]] = {
    "speechGeneration": {"text": "Hello"},
    "bloodPressure": {},
    "patientRecord": {
        "patient": "test",
        "kind": "pulse",
        "value": 70,
        "time": "2026-01-01T00:00:00Z",
    },
}
_SECONDS = 60.0


def chain(plan: Mapping[str, Any]) -> str:
    """Return the components from the source to the one that provides the function."""
    components = [step["component"] for step in plan["steps"]]
    return " → ".join(
        f"{component['name']} ({_FRAMEWORKS[component['bridge']]})" for component in components
    )


def types(plan: Mapping[str, Any]) -> str:
    """Return the native types on the way, as the components' addresses name them."""
    named = []
    for step in plan["steps"]:
        component = step["component"]
        ports = [*component.get("inputs", ()), *component.get("outputs", ())]
        service = component.get("service")
        for port in [*ports, *([service] if service else [])]:
            address = port["endpoint"]["address"]
            named.append(address[-1].rpartition(":")[2] if len(address) == 1 else address[-1])
    return ", ".join(dict.fromkeys(named))


def converted(plan: Mapping[str, Any]) -> str:
    """Return what is given up where messages pass from one component to the next."""
    edges = [f"without {', '.join(edge['losses'])}" for edge in plan["edges"] if edge["losses"]]
    direct = len(plan["edges"]) - len(edges)
    return "; ".join([*edges, *([f"{direct} unchanged"] if direct else [])]) or "nothing to convert"


async def first(robot: RemoteRobot, name: str) -> str:
    """Return how long the first message or reply took."""
    begun = time.monotonic()
    try:
        if name in _CALLS:
            await robot.call(name, _CALLS[name], timeout=_SECONDS)
        else:
            async with await robot.request(name) as stream:
                await stream.get(_SECONDS)
    except UoarmError as error:
        return f"none: {str(error).splitlines()[0]}"
    return f"{time.monotonic() - begun:.2f} s"


async def main() -> None:
    """Ask for every function twice; resolving it first has started its bridges."""
    rows = []
    with stage() as scene:
        async with connect(scene.places.robot_url) as robot:
            for function in await robot.functions():
                name = function["name"]
                plan = (await robot.resolve(name))["plan"]
                row = [name, chain(plan), types(plan), converted(plan)]
                rows.append([*row, await first(robot, name), await first(robot, name)])
    head("Interoperability")
    header = ("function", "chain", "types", "between them", "first message", "asked again")
    table(header, rows)


if __name__ == "__main__":
    asyncio.run(main())
