"""What a bridge shows of the components that its option `discover` lists: none runs for it."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

from uoarm.bridge import Description, Discovered
from uoarm.errors import BridgeError
from uoarm.local._target import Target
from uoarm.model import Endpoint, Options, Role

__all__ = ["LISTED", "listed"]

LISTED = {
    "type": "array",
    "items": {
        "anyOf": [
            {"type": "string", "minLength": 1},
            {
                "type": "object",
                "required": ["component"],
                "properties": {
                    "component": {"type": "string", "minLength": 1},
                    "name": {"type": "string", "minLength": 1},
                    "parameters": {"type": "object"},
                },
                "additionalProperties": False,
            },
        ]
    },
    "description": "Components that discovery shows: module:attribute, also with parameters.",
}


def listed(
    bridge: str, entries: Iterable[Any], find: Callable[[tuple[str, ...]], Target]
) -> Iterator[Discovered]:
    """Yield what discovery shows of each entry; one that cannot be used has its cause as detail.

    Args:
        bridge: the name of the instance.
        entries: of the option.
        find: imports what an address names; raises BridgeError.
    """
    for entry in entries:
        report: Mapping[str, Any] = entry if isinstance(entry, Mapping) else {"component": entry}
        address = (str(report["component"]),)
        name = str(report.get("name") or address[0].partition(":")[2] or address[0])
        parameters: Options = report.get("parameters", {})
        try:
            target = find(address)
            ends = [
                Endpoint(bridge, name, role, address, port, parameters=parameters)
                for role, port in _ports(target, parameters)
            ]
            ports = tuple((end, _described(target, end)) for end in ends)
        except Exception as error:  # noqa: BLE001 - importing a module may raise anything
            cause = str(error) if isinstance(error, BridgeError) else repr(error)
            yield Discovered(name, (), f"cannot be used: {cause}")
            continue
        yield Discovered(name, ports, address[0])


def _ports(target: Target, parameters: Options) -> Iterator[tuple[Role, str]]:
    """Yield the ports that an object may be used with: as a stream, and as a service, if it can."""
    if not target.is_class:
        takes = target.first_unfilled(target.value, parameters) is not None
        if takes:
            yield Role.INPUT, "default"
            yield Role.SERVICE, "default"
        yield Role.OUTPUT, "default"
        return
    if target.source_name() is not None:
        yield Role.OUTPUT, "default"
        return
    if target.own("__call__") is not None:
        yield from ((role, "default") for role in (Role.INPUT, Role.SERVICE, Role.OUTPUT))
        return
    for name, _ in inspect.getmembers(target.value, inspect.isfunction):
        if not name.startswith("_"):
            yield Role.INPUT, name


def _described(target: Target, end: Endpoint) -> Description:
    """Return the structures of a port; unknown ones where a hint has none."""
    try:
        return target.describe(end)
    except BridgeError:
        target.require_parameters(end.parameters)
        return Description()
