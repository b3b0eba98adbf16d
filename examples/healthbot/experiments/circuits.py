"""The robot of the latency experiment: a loop in every framework, alone and one behind another."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml
from loops import TYPE

__all__ = ["FRAMEWORKS", "configuration", "message", "name_of"]

FRAMEWORKS = {"python": "plain Python", "ros2": "ROS 2", "rtm": "OpenRTM", "rocos": "ROCOS profile"}
_TIME = {"sec": 0, "nsec": 0}


def name_of(first: str, second: str = "") -> str:
    """Return the function that goes through one framework, or through two."""
    return f"{first}_{second}" if second else first


def message(first: str, number: int) -> dict[str, Any]:
    """Return what an application sends into a framework."""
    return {"tm": _TIME, "data": number} if first == "rtm" else {"data": number}


def configuration(nameserver: str, device: str, domain: int, *, hosted: bool) -> str:
    """Return the robot file.

    Args:
        nameserver: where the RT-Component is bound.
        device: URL of the device.
        domain: of ROS 2.
        hosted: whether each bridge runs in a process of its own.
    """
    host = {"host": True} if hosted else {}
    bridges = {
        "python": {"options": {"path": [str(Path(__file__).parent)]}, **host},
        "ros2": {"options": {"domain_id": domain, "wait": 0}, **host},
        "rtm": {"options": {"nameserver": nameserver}, **host},
        "rocos": {"options": {"devices": {"loop": {"url": device}}}, **host},
    }
    functions = dict(_functions())
    return yaml.safe_dump({"version": 1, "bridges": bridges, "functions": functions})


def _functions() -> Iterator[tuple[str, Any]]:
    for first in FRAMEWORKS:
        yield name_of(first), {"components": [_component(first, name_of(first), {})]}
    for first in FRAMEWORKS:
        for second in FRAMEWORKS:
            if first != second:
                name = name_of(first, second)
                yield name, {"components": [_component(second, name, _source(first, second))]}


def _source(first: str, second: str) -> dict[str, Any]:
    source: dict[str, Any] = {"from": first, "map": {}}
    if second == "rtm":
        source["map"] = {"tm": {"const": _TIME}}
    if first == "rtm":
        source["allow_loss"] = ["tm"]
    return source


def _component(framework: str, name: str, source: dict[str, Any]) -> dict[str, Any]:
    addresses: dict[str, tuple[list[str], list[str]]] = {
        "python": (["loops:number"], ["loops:number"]),
        "ros2": ([f"/{name}", "std_msgs/msg/Int32"], [f"/{name}", "std_msgs/msg/Int32"]),
        "rtm": (["Loop0.rtc", "in", TYPE], ["Loop0.rtc", "out", TYPE]),
        "rocos": (["loop", "loop"], ["loop", "loop"]),
    }
    options = {"ros2": {"peer": "optional"}, "rtm": {"activate": True}}.get(framework, {})
    into, out = addresses[framework]
    return {
        "name": f"{name}_loop",
        "bridge": framework,
        "input": {**source, "endpoint": into, "options": options},
        "output": {"endpoint": out, "options": options if framework == "ros2" else {}},
    }
