"""What the other manager exports to this one, and what the messages of each function are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from uoarm.bridge import Description, Discovered
from uoarm.errors import BridgeError, FailureReason, UoarmError
from uoarm.model import Endpoint, MessageStructure, Role
from uoarm_remote._link import ManagerLink

__all__ = ["described", "discovered", "wanted_name"]

_MOST = 200
"""Functions that are looked at when one discovers: each costs a question."""


def wanted_name(endpoint: Endpoint) -> str:
    """Return what is asked for: the function, or one of its outputs."""
    function, *port = endpoint.address
    return f"{function}.{port[0]}" if port and endpoint.role is Role.OUTPUT else function


def described(link: ManagerLink, endpoint: Endpoint, timeout: float) -> Description:
    """Ask for the plan of a function, and return the structures of its port.

    Raises:
        BridgeError: it is not exported to this manager, cannot be had now, or has no such port.
    """
    found = link.ask("Resolve", endpoint.address[0], timeout)
    managers = tuple(map(str, found.get("managers", ())))
    structures = _structures(found)
    if endpoint.role is Role.SERVICE:
        request, reply = structures.get("request"), structures.get("reply")
        if request is None or reply is None:
            raise _no_port(endpoint, "it is no service", structures)
        return Description(request=request, reply=reply, managers=managers)
    name = _port(endpoint, structures)
    return Description(structures[name], managers=managers)


def discovered(link: ManagerLink, bridge: str, timeout: float) -> tuple[Discovered, ...]:
    """List the functions that are exported to this manager, each as a component of its name."""
    functions = link.ask("List", "", timeout)["functions"][:_MOST]
    names = [str(function["name"]) for function in functions]
    plans = link.ask_each("Resolve", names, timeout)
    return tuple(
        Discovered(name, tuple(_endpoints(found, bridge, name)), detail=link.url)
        for name, found in zip(names, plans, strict=True)
    )


def _endpoints(
    found: Mapping[str, Any] | UoarmError, bridge: str, name: str
) -> Iterator[tuple[Endpoint, Description]]:
    if isinstance(found, UoarmError):
        return  # it cannot be had now: shown without ports
    structures = _structures(found)
    managers = tuple(map(str, found.get("managers", ())))
    if "request" in structures:
        description = Description(
            request=structures["request"], reply=structures["reply"], managers=managers
        )
        yield Endpoint(bridge, name, Role.SERVICE, (name,)), description
    for kind, role in (("output", Role.OUTPUT), ("input", Role.INPUT)):
        ports = _ports(kind, structures)
        for port in ports:
            address = (name,) if len(ports) == 1 else (name, port)
            description = Description(structures[f"{kind}.{port}"], managers=managers)
            yield Endpoint(bridge, name, role, address), description


def _structures(found: Mapping[str, Any]) -> dict[str, MessageStructure]:
    """Return the structures of what provides a function, without inputs that are fed there."""
    provider = found["plan"]["steps"][-1]
    fed = {
        f"input.{port['name']}" for port in provider["component"]["inputs"] if port.get("source")
    }
    return {
        str(name): MessageStructure(
            structure["schema"], native_type=str(structure.get("native_type", ""))
        )
        for name, structure in provider["structures"].items()
        if name not in fed
    }


def _ports(kind: str, structures: Mapping[str, object]) -> list[str]:
    return [name.partition(".")[2] for name in structures if name.startswith(f"{kind}.")]


def _port(endpoint: Endpoint, structures: Mapping[str, object]) -> str:
    kind = "input" if endpoint.role is Role.INPUT else "output"
    ports = _ports(kind, structures)
    wanted = endpoint.address[1] if len(endpoint.address) > 1 else ""
    if not wanted and len(ports) == 1:
        return f"{kind}.{ports[0]}"
    name = wanted or "default"
    if name not in ports:
        raise _no_port(endpoint, f"it has no {kind} {name!r}", structures)
    return f"{kind}.{name}"


def _no_port(endpoint: Endpoint, what: str, structures: Mapping[str, object]) -> BridgeError:
    has = ", ".join(structures) or "nothing that one may use"
    text = f"{endpoint}: {what}; it has {has}"
    return BridgeError(text, FailureReason.NOT_FOUND)
