"""What the other manager exports to this one, and what the messages of each function are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from uoarm.bridge import MOST_HOPS, Description, Discovered, Log, text_of
from uoarm.errors import BridgeError, FailureReason, UoarmError
from uoarm.model import Endpoint, MessageStructure, Role, Schema, message_octets
from uoarm_remote._link import ManagerLink

_MOST_OCTETS = 4_194_304
_MOST_IDENTITY = 64
_log = Log("uoarm")
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
    return read_plan(found, endpoint, link.place)


def read_plan(found: Mapping[str, Any], endpoint: Endpoint, place: str) -> Description:
    """Return the structures of a port as a plan of the other manager has them; raises as above."""
    with _reading_plan(place, endpoint.address[0]):
        managers, structures = _managers(found), _structures(found)
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
        Discovered(name, _ports_of(found, bridge, name, link.place), detail=link.url)
        for name, found in zip(names, plans, strict=True)
    )


def _ports_of(
    found: Mapping[str, Any] | UoarmError, bridge: str, name: str, place: str
) -> tuple[tuple[Endpoint, Description], ...]:
    """Return the ports of a function; none of one that cannot be had now."""
    if isinstance(found, UoarmError):
        return ()
    try:
        with _reading_plan(place, name):
            return tuple(_endpoints(found, bridge, name))
    except BridgeError as error:  # the others of this manager are right
        _log.warning("%s", error)
        return ()


def _endpoints(
    found: Mapping[str, Any], bridge: str, name: str
) -> Iterator[tuple[Endpoint, Description]]:
    structures, managers = _structures(found), _managers(found)
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


@contextmanager
def _reading_plan(place: str, function: str) -> Iterator[None]:
    """Turn what reading a plan of another manager raises into an error that names that manager."""
    try:
        yield
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        text = f"{place}: its plan of {function!r} cannot be read: {text_of(error)}"
        raise BridgeError(text, FailureReason.BAD_MESSAGE) from error


def _managers(found: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the identities of the managers through which messages pass."""
    way = found.get("managers", [])
    if not isinstance(way, list) or len(way) > MOST_HOPS:
        raise ValueError(f"expected {MOST_HOPS} managers at most on the way, got {way!r:.100}")
    return tuple(str(identity)[:_MOST_IDENTITY] for identity in way)


def _structures(found: Mapping[str, Any]) -> dict[str, MessageStructure]:
    """Return the structures of what provides a function, without inputs that are fed there."""
    provider = found["plan"]["steps"][-1]
    if message_octets(provider, most=_MOST_OCTETS) > _MOST_OCTETS:
        raise ValueError(f"what provides it is described in more than {_MOST_OCTETS:,} octets")
    fed = {
        f"input.{port['name']}" for port in provider["component"]["inputs"] if port.get("source")
    }
    return {
        str(name): MessageStructure(
            _schema(structure["schema"]), native_type=str(structure.get("native_type", ""))
        )
        for name, structure in provider["structures"].items()
        if name not in fed
    }


def _schema(given: Any) -> Schema:
    if not isinstance(given, dict | bool):
        raise TypeError(f"expected a schema, got {type(given).__name__}")
    return given


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
