"""What the framework says that there is, and what each is described by."""

from __future__ import annotations

from typing import Any

from uoarm.bridge import Description, Discovered
from uoarm.errors import BridgeError
from uoarm.model import Endpoint, MessageStructure, Role
from uoarm_example._connection import ExampleConnection


def described(connection: ExampleConnection, endpoint: Endpoint) -> Description:
    """Ask what messages an endpoint has.

    Raises:
        BridgeError: it is not there and not offered either.
    """
    is_service = endpoint.role is Role.SERVICE
    try:
        found = connection.ask("describe", name=endpoint.address[0], is_service=is_service)
    except BridgeError:
        if endpoint.is_offered:
            return Description()  # others are to find it: its structure is the function's own
        raise
    return _description(found)


def is_retained(connection: ExampleConnection, endpoint: Endpoint) -> bool:
    """Ask whether the last message of a topic stands."""
    found = connection.ask("describe", name=endpoint.address[0], is_service=False)
    return found.get("retained") is True


def discovered(connection: ExampleConnection, bridge: str) -> tuple[Discovered, ...]:
    """List topics and services, each as a component of its own name."""
    listing: dict[str, dict[str, Any]] = connection.ask("list")
    return tuple(
        Discovered(
            name,
            tuple(
                (Endpoint(bridge, name, role, (name,)), _description(found))
                for role in ((Role.SERVICE,) if "request" in found else (Role.OUTPUT, Role.INPUT))
            ),
        )
        for name, found in listing.items()
    )


def _description(found: dict[str, Any]) -> Description:
    if "message" in found:
        return Description(MessageStructure(found["message"]))
    request, reply = (MessageStructure(found[part]) for part in ("request", "reply"))
    return Description(request=request, reply=reply)
