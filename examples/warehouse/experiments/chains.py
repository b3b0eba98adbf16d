"""Interoperability: of every function the chain of frameworks, the types, and what is given up.

    python examples/warehouse/experiments/chains.py

The scene runs, all but the application. Prints a table of the plans that the robot has proven.
"""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Mapping
from typing import Any, Final

from experiment import Row, Tables, options, stage
from warehouse_scene.parts import newcomer

from uoarm.client import connect
from uoarm.errors import UoarmError

_BRIDGES: Final = {
    "ros": "ROS 2",
    "rtm": "OpenRTM",
    "fleet": "VDA 5050, 2.1",
    "fleet3": "VDA 5050, 3.0",
    "line": "XML device",
    "parts": "plain Python",
}
_SECONDS: Final = 120.0
_AGAIN: Final = 1.0


def chain(plan: Mapping[str, Any]) -> str:
    """Return the components from the source to the one that provides the function."""
    components = [step["component"] for step in plan["steps"]]
    return " → ".join(
        f"{component['name']} ({_BRIDGES[component['bridge']]})" for component in components
    )


def types(plan: Mapping[str, Any]) -> str:
    """Return the types, or ports, of components that are not plain Python."""
    named = []
    for step in plan["steps"]:
        component = step["component"]
        ports = [*component.get("inputs", ()), *component.get("outputs", ())]
        ports += [component["service"]] if component.get("service") else []
        addresses = [port["endpoint"]["address"] for port in ports]
        named += [" ".join(address[1:]) for address in addresses if len(address) > 1]
    return ", ".join(dict.fromkeys(named))


def given_up(plan: Mapping[str, Any]) -> str:
    """Return what is lost where messages pass from one component to the next."""
    return ", ".join(dict.fromkeys(loss for edge in plan["edges"] for loss in edge["losses"]))


async def rows(url: str) -> list[Row]:
    """Resolve every function; what needs the newcomer is asked until it has been found."""
    found: list[Row] = []
    async with connect(url) as robot:
        for function in await robot.functions():
            name = function["name"]
            try:
                plan = (await asyncio.wait_for(_resolved(robot, name), _SECONDS))["plan"]
            except (UoarmError, asyncio.TimeoutError) as error:
                cells = (name, f"none: {str(error).splitlines()[0]}", "", "", "")
            else:
                edges = str(len(plan["edges"]))
                cells = (name, chain(plan), types(plan), edges, given_up(plan))
            head = ("function", "chain", "types", "edges proven", "given up")
            found.append(dict(zip(head, cells, strict=True)))
    return found


async def _resolved(robot: Any, name: str) -> Mapping[str, Any]:
    while True:
        try:
            report: Mapping[str, Any] = await robot.resolve(name)
        except UoarmError:
            if "guest" not in name.lower():
                raise
            await asyncio.sleep(_AGAIN)
        else:
            return report


def main() -> int:
    """Run it and print the table."""
    chosen = options(__doc__)
    tables = Tables(chosen.json)
    with stage(without=["orders", "page"]) as scene:
        scene.crew.start(newcomer(scene.places))
        found = asyncio.run(rows(scene.places.robot_url))
    tables.add("Interoperability", found)
    tables.print()
    return 1 if any(str(row["chain"]).startswith("none") for row in found) else 0


if __name__ == "__main__":
    sys.exit(main())
