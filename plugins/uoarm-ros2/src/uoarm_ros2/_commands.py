"""What `uoarm ros2` shows, as values that can be printed as JSON; no terminal here."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from uoarm.bridge import Bridge, Description, Registry
from uoarm.model import BridgeSpec, Endpoint, Options, Role
from uoarm_ros2._named_types import installed
from uoarm_ros2._types import import_type, kind_of

__all__ = ["graph", "installed", "seen", "structure", "types"]

Row = dict[str, Any]


@contextmanager
def seen(options: Options) -> Iterator[Bridge]:
    """Have a bridge for one command.

    Raises:
        BridgeError: it cannot be made.
    """
    bridge = Registry().create(BridgeSpec("ros2_command", "ros2", options))
    try:
        yield bridge
    finally:
        bridge.close()


def graph(bridge: Bridge) -> list[Row]:
    """Return every node with its topics, services and actions."""
    return [
        {
            "node": component.name,
            "endpoints": [
                {
                    "role": at.role.value,
                    "name": at.address[0],
                    "type": at.address[1],
                    "known": report != Description(),
                }
                for at, report in component.endpoints
            ],
            **({"missing": component.detail} if component.detail else {}),
        }
        for component in bridge.discover()
    ]


def types(bridge: Bridge) -> list[Row]:
    """Return every type on the graph: whether it is installed, or known from a node."""
    found: dict[str, Row] = {}
    for component in bridge.discover():
        for at, report in component.endpoints:
            name = at.address[1]
            row = found.setdefault(name, {"type": name, "known": "", "nodes": []})
            if component.name not in row["nodes"]:
                row["nodes"].append(component.name)
            if not row["known"] and report != Description():
                row["known"] = "installed" if _is_installed(name) else "described by its node"
    return [found[name] for name in sorted(found)]


def _is_installed(name: str) -> bool:
    try:
        import_type(name)
    except Exception:  # noqa: BLE001 - the answer, whatever the reason
        return False
    return True


def structure(bridge: Bridge, name: str, type_name: str) -> Row:
    """Return the structures of a topic, a service or an action, with the type if it is given.

    Raises:
        BridgeError: it is not there, or its type is not known.
    """
    address = (name, type_name) if type_name else (name,)
    is_message = kind_of(type_name) == "msg" if type_name else _is_topic(bridge, name)
    options: Options = {"peer": "optional"} if type_name else {}
    role = Role.OUTPUT if is_message else Role.SERVICE
    at = Endpoint(bridge.name, name, role, address, options=options)
    report = bridge.describe(at)
    parts = {"message": report.message, "request": report.request, "reply": report.reply}
    return {
        part: {"type": value.native_type, "structure": value.schema}
        for part, value in parts.items()
        if value is not None
    }


def _is_topic(bridge: Bridge, name: str) -> bool:
    """Whether a name is a topic's, as far as the graph tells; what is nothing counts as one."""
    everything = [at for component in bridge.discover() for at, _ in component.endpoints]
    kinds = {at.role for at in everything if at.address[0].strip("/") == name.strip("/")}
    return kinds != {Role.SERVICE}
