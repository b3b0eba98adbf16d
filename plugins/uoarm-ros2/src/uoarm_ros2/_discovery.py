"""Who is on the graph now: every node as a component with endpoints, and who came or went."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

from attrs import frozen

from uoarm.bridge import Description, Discovered
from uoarm.errors import BridgeError
from uoarm.model import Endpoint, Health, MessageStructure, Role
from uoarm_ros2 import _action_types, _services
from uoarm_ros2._middleware import rclpy_errors
from uoarm_ros2._types import of_type

__all__ = ["Attendance", "discovered"]

_HIDDEN = "/_action/"
_OF_EVERY_NODE = ("rcl_interfaces/srv/", "type_description_interfaces/srv/")
_FEEDBACK = "/_action/feedback"
_EVERYWHERE = {"/parameter_events", "/rosout"}


@frozen
class _Node:
    """The public topics, services and actions of one node: (name, type) each."""

    publishes: tuple[tuple[str, str], ...]
    subscribes: tuple[tuple[str, str], ...]
    serves: tuple[tuple[str, str], ...]
    acts: tuple[tuple[str, str], ...]


def discovered(
    bridge: str,
    node: Any,
    own: frozenset[str],
    structure: Callable[[str, str], MessageStructure],
) -> tuple[Discovered, ...]:
    """Return every node that is not our own as a component.

    `structure` is given a message type and a topic that carries it. Endpoints whose type is not
    known have no structures; `detail` says why, once for all types of a package.
    """
    found = []
    with rclpy_errors("looking for nodes"):
        names = sorted(set(node.get_node_names_and_namespaces()))
    for name, namespace in names:
        full = f"{namespace.rstrip('/')}/{name}"
        if full in own:
            continue
        try:
            seen = _look(node, name, namespace)
        except Exception:  # noqa: BLE001, S112 - rclpy's NodeNameNonExistentError: it has just left
            continue
        found.append(_component(bridge, full, seen, structure))
    return tuple(found)


def _look(node: Any, name: str, namespace: str) -> _Node:
    publishes = node.get_publisher_names_and_types_by_node(name, namespace)
    subscribes = node.get_subscriber_names_and_types_by_node(name, namespace)
    serves = node.get_service_names_and_types_by_node(name, namespace)
    actions = [
        (topic.removesuffix(_FEEDBACK), [kind.removesuffix("_FeedbackMessage") for kind in kinds])
        for topic, kinds in publishes
        if topic.endswith(_FEEDBACK)
    ]
    return _Node(_pairs(publishes), _pairs(subscribes), _pairs(serves), _pairs(actions))


def _pairs(listing: Iterable[tuple[str, list[str]]]) -> tuple[tuple[str, str], ...]:
    return tuple(
        (name, kind)
        for name, kinds in listing
        for kind in kinds
        if _HIDDEN not in name and name not in _EVERYWHERE and not kind.startswith(_OF_EVERY_NODE)
    )


def _component(
    bridge: str, name: str, seen: _Node, structure: Callable[[str, str], MessageStructure]
) -> Discovered:
    endpoints: list[tuple[Endpoint, Description]] = []
    missing: dict[str, None] = {}

    def message(kind: str, topic: str) -> Description:
        return Description(message=structure(kind, topic))

    def add(
        role: Role, address: tuple[str, str], describe: Callable[[str, str], Description]
    ) -> None:
        try:
            description = describe(address[1], address[0])
        except BridgeError as error:
            description = Description()
            # Without the type: its port has that, and one package lacks many of them.
            told = str(error).removeprefix(of_type(address[1]))
            missing.update(dict.fromkeys(told.split("; ")))
        port = address[0].strip("/").replace("/", "_")
        endpoints.append((Endpoint(bridge, name, role, address, port=port), description))

    for address in seen.publishes:
        add(Role.OUTPUT, address, message)
    for address in seen.subscribes:
        add(Role.INPUT, address, message)
    for address in seen.serves:
        add(Role.SERVICE, address, lambda kind, _: _services.described(kind))
    for address in seen.acts:
        add(Role.SERVICE, address, lambda kind, _: _action_types.described(kind))
    return Discovered(name, tuple(endpoints), "; ".join(missing))


class Attendance:
    """Which nodes are on the graph, compared with the last look."""

    def __init__(
        self,
        node: Any,
        own: Callable[[], frozenset[str]],
        report: Callable[[Health, str, str], None],
    ) -> None:
        self._node = node
        self._own = own
        self._report = report
        self._present: set[str] | None = None

    def tick(self) -> None:
        """Report the nodes that came or went since the last look; the first look reports none."""
        now = set(self._node.get_fully_qualified_node_names()) - self._own()
        before, self._present = self._present, now
        if before is None:
            return
        for name in sorted(before - now):
            self._report(Health.LOST, f"node {name} left the graph", name)
        for name in sorted(now - before):
            self._report(Health.OK, f"node {name} appeared on the graph", name)
