"""Who is on the graph now: every node as a component with endpoints and their structures."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping

from uoarm.bridge import Description, Discovered
from uoarm.errors import BridgeError
from uoarm.model import Endpoint, Role
from uoarm_ros1._node import Node

__all__ = ["discovered"]

_EVERYWHERE = frozenset({"/rosout", "/rosout_agg", "/clock"})
_OF_EVERY_NODE = ("/get_loggers", "/set_logger_level", "/tf2_frames")
_STATUS, _GOAL = "/status", "/goal"
_PARTS = ("/goal", "/cancel", "/status", "/feedback", "/result")


def discovered(
    bridge: str, node: Node, describe: Callable[[Endpoint], Description]
) -> tuple[Discovered, ...]:
    """Return every node that answers, but our own, as a component.

    Endpoints whose type is not known have no structures; `detail` says why.
    """
    state, kinds = node.master.state(), node.master.types()
    ports: dict[str, list[tuple[Role, str, str]]] = defaultdict(list)
    actions = _actions(state.publishers, state.subscribers, kinds)
    for role, listing in ((Role.OUTPUT, state.publishers), (Role.INPUT, state.subscribers)):
        for topic, names in listing.items():
            for name in names:
                base = next((part for part in _PARTS if topic.endswith(part)), "")
                is_part = bool(base) and topic.removesuffix(base) in actions
                if topic not in _EVERYWHERE and not is_part:
                    ports[name].append((role, topic, kinds.get(topic, "")))
    for action, (kind, server) in actions.items():
        ports[server].append((Role.SERVICE, action, kind))
    for service, names in state.services.items():
        for name in names:
            if not service.endswith(_OF_EVERY_NODE):
                ports[name].append((Role.SERVICE, service, ""))
    return tuple(
        _component(bridge, name, sorted(ports[name], key=lambda port: port[1]), describe)
        for name in sorted(ports)
        if name != node.name and node.is_alive(name)
    )


def _actions(
    publishers: Mapping[str, tuple[str, ...]],
    subscribers: Mapping[str, tuple[str, ...]],
    kinds: Mapping[str, str],
) -> dict[str, tuple[str, str]]:
    """Return the actions with their types and servers."""
    found = {}
    for topic, names in publishers.items():
        if not topic.endswith(_STATUS):
            continue
        name = topic.removesuffix(_STATUS)
        goal = kinds.get(f"{name}{_GOAL}", "")
        servers = [server for server in names if server in subscribers.get(f"{name}{_GOAL}", ())]
        if servers and goal.endswith("ActionGoal"):
            found[name] = (goal.removesuffix("Goal"), servers[0])
    return found


def _component(
    bridge: str,
    name: str,
    ports: list[tuple[Role, str, str]],
    describe: Callable[[Endpoint], Description],
) -> Discovered:
    endpoints: list[tuple[Endpoint, Description]] = []
    missing: dict[str, None] = {}
    for role, own, kind in ports:
        address = (own, kind) if kind else (own,)
        port = own.strip("/").replace("/", "_")
        endpoint = Endpoint(bridge, name, role, address, port=port)
        try:
            description = describe(endpoint)
        except BridgeError as error:
            description = Description()
            missing[str(error)] = None
        endpoints.append((endpoint, description))
    return Discovered(name, tuple(endpoints), "; ".join(missing))
