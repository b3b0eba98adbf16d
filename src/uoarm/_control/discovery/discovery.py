"""Discovery: every bridge is asked what it sees, several at once, each within a limit."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeAlias

from uoarm import _bounded
from uoarm.bridge import Bridge, Description, Discovered
from uoarm.errors import UoarmError
from uoarm.model import (
    BridgeFindings,
    Endpoint,
    FoundComponent,
    FoundPort,
    Robot,
    Role,
    message_octets,
)

__all__ = ["discover"]

_AT_ONCE = 8
_MOST_PORTS = 10_000
_MOST_OCTETS = 2_000_000

_Place: TypeAlias = tuple[str, Role, tuple[str, ...]]


def discover(
    robot: Robot, get: Callable[[str], Bridge], timeout: float
) -> tuple[BridgeFindings, ...]:
    """Return what each bridge of the configuration sees, in its order.

    Args:
        robot: the configuration.
        get: gives a bridge, starting it where it must.
        timeout: seconds for each bridge, its start included.
    """
    users: dict[_Place, list[str]] = {}
    for one in robot.components():
        services = () if one.service is None else (one.service,)
        for port in (*one.inputs, *one.outputs, *services):
            users.setdefault(_place(port.endpoint), []).append(one.name)

    def ask(name: str) -> BridgeFindings:
        plugin = robot.bridges[name].plugin
        try:
            found = _bounded.run(
                f"discovery by bridge {name!r}", timeout, lambda: _seen_by(get(name), timeout)
            )
        except UoarmError as error:
            return BridgeFindings(name, plugin, cause=str(error))
        if found is None:
            return BridgeFindings(name, plugin, cause="cannot list components")
        return _findings(name, plugin, found, users)

    with ThreadPoolExecutor(_AT_ONCE, thread_name_prefix="uoarm-discovery") as pool:
        return tuple(pool.map(ask, robot.bridges))


def _seen_by(bridge: Bridge, timeout: float) -> tuple[Discovered, ...] | None:
    if not bridge.capabilities.discover:
        return None
    return bridge.discover(timeout=timeout)


def _findings(
    bridge: str,
    plugin: str,
    found: tuple[Discovered, ...],
    users: dict[_Place, list[str]],
) -> BridgeFindings:
    components: list[FoundComponent] = []
    left, too_large = _MOST_PORTS, 0
    for one in sorted(found, key=lambda each: each.name):
        taken = one.endpoints[: max(0, left)]
        left -= len(one.endpoints)
        bounded = [(end, said) for end, said in taken if not _is_too_large(said)]
        too_large += len(taken) - len(bounded)
        ports = tuple(
            FoundPort(
                endpoint,
                said.message,
                said.request,
                said.reply,
                tuple(dict.fromkeys(users.get(_place(endpoint), ()))),
            )
            for endpoint, said in bounded
        )
        if ports or not one.endpoints:
            components.append(FoundComponent(one.name, ports, one.detail))
    return BridgeFindings(bridge, plugin, tuple(components), left_out=max(0, -left) + too_large)


def _is_too_large(said: Description) -> bool:
    """Say whether a port's structures are more than a robot's configuration may be made of."""
    told = [one.schema for one in (said.message, said.request, said.reply) if one is not None]
    return message_octets(told, most=_MOST_OCTETS) > _MOST_OCTETS


def _place(endpoint: Endpoint) -> _Place:
    return endpoint.bridge, endpoint.role, endpoint.address
