"""What is behind a server, as rosapi lists it: nodes, with topics, services and actions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from uoarm.bridge import Description, Discovered
from uoarm.errors import BridgeError
from uoarm.model import Endpoint, Role
from uoarm_rosbridge.client._connection import Fields
from uoarm_rosbridge.client._options import is_type

_EVERYWHERE = frozenset({"/rosout", "/rosout_agg", "/parameter_events", "/clock"})
_OF_THE_SERVER = ("rosapi", "rosbridge_websocket")
_OF_EVERY_NODE = (
    "/get_loggers", "/set_logger_level", "/describe_parameters", "/get_parameter_types",
    "/get_parameters", "/list_parameters", "/set_parameters", "/set_parameters_atomically",
    "/get_type_description",
)  # fmt: skip
_ROLES = ((Role.OUTPUT, "publishing"), (Role.INPUT, "subscribing"), (Role.SERVICE, "services"))
_GOAL, _STATUS = "/goal", "/status"
_PARTS = (_GOAL, "/cancel", "/feedback", "/result", _STATUS)

Ports = list[tuple[Role, str, str]]


def discovered(
    bridge: str, ask: Callable[..., Fields], describe: Callable[[Endpoint], Description]
) -> tuple[Discovered, ...]:
    """Return every node but the server's own as a component.

    The five topics of an action of ROS 1 are one endpoint. Endpoints of which the server does not
    say the type have no structures; `detail` says why.
    """
    topics = ask("topics")
    kinds = dict(zip(topics.get("topics", ()), topics.get("types", ()), strict=False))
    found = []
    for node in ask("nodes").get("nodes", ()):
        if str(node).rpartition("/")[2].startswith(_OF_THE_SERVER):
            continue
        details = ask("node_details", node=str(node))
        component = _component(bridge, str(node), _ports(details, kinds), describe)
        if component.endpoints:
            found.append(component)
    return tuple(found)


def _ports(details: Fields, kinds: Mapping[str, Any]) -> Ports:
    named = {role: [str(name) for name in details.get(part, ())] for role, part in _ROLES}
    actions = {
        name.removesuffix(_GOAL): kinds[name].removesuffix("Goal")
        for name in named[Role.INPUT]
        if name.endswith(_GOAL)
        and str(kinds.get(name)).endswith("ActionGoal")
        and f"{name.removesuffix(_GOAL)}{_STATUS}" in named[Role.OUTPUT]
    }
    ports: Ports = [(Role.SERVICE, name, kind) for name, kind in actions.items()]
    for role, names in named.items():
        for name in names:
            base = next((name.removesuffix(part) for part in _PARTS if name.endswith(part)), "")
            is_part = role is not Role.SERVICE and base in actions
            if name in _EVERYWHERE or name.endswith(_OF_EVERY_NODE) or is_part:
                continue
            kind = "" if role is Role.SERVICE else str(kinds.get(name, ""))
            ports.append((role, name, kind))
    return ports


def _component(
    bridge: str, node: str, ports: Ports, describe: Callable[[Endpoint], Description]
) -> Discovered:
    endpoints, missing = [], dict[str, None]()
    for role, name, kind in ports:
        address = (name, kind) if is_type(kind) else (name,)
        endpoint = Endpoint(bridge, node, role, address, port=name.strip("/").replace("/", "_"))
        try:
            description = describe(endpoint)
        except BridgeError as error:
            description = Description()
            missing[str(error)] = None
        endpoints.append((endpoint, description))
    return Discovered(node, tuple(endpoints), "; ".join(missing))
