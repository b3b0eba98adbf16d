"""Who is on the graph now, each asked once; every node as a component with its endpoints."""

from __future__ import annotations

import math
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from functools import cached_property

from uoarm.bridge import Description, Discovered, WorkerExecutor, did_you_mean
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Endpoint, Role
from uoarm_ros1._master import GraphState
from uoarm_ros1._node import Node
from uoarm_ros1._subscription import PublisherHeader, SubscriptionOptions, read_publisher_header
from uoarm_ros1._tcpros import ProtocolError

_HEADER_SECONDS = 2.0
_AT_ONCE = 32

_EVERYWHERE = frozenset({"/rosout", "/rosout_agg", "/clock"})
_OF_EVERY_NODE = ("/get_loggers", "/set_logger_level", "/tf2_frames")
_STATUS, _GOAL = "/status", "/goal"
_PARTS = ("/goal", "/cancel", "/status", "/feedback", "/result")


class Graph:
    """What the master and the nodes answer, each question asked once: for one step of a bridge.

    Args:
        since: what the master was asked since then it is not asked again; None: the time of each
            question.
    """

    def __init__(self, node: Node, since: float | None = None) -> None:
        self._node = node
        self._since = since
        self._oldest = math.inf
        self._addresses: dict[str, str] = {}
        self._alive: dict[str, bool] = {}
        self._headers: dict[tuple[str, str, str], PublisherHeader | str] = {}

    @cached_property
    def state(self) -> GraphState:
        """Who publishes, subscribes and serves what."""
        state = self._node.master.state(self._since)
        self._oldest = min(self._oldest, state.asked)
        return state

    @cached_property
    def types(self) -> Mapping[str, str]:
        """The types of topics."""
        types = self._node.master.types(self._since)
        self._oldest = min(self._oldest, types.asked)
        return types.by_topic

    def is_since(self, moment: float) -> bool:
        """Say whether all of this that was used was asked for since then."""
        return self._oldest >= moment

    def seen_as(self, topic: str, wanted: str, known: Iterable[str]) -> str:
        """Say with which other type than wanted a topic is known, or what may be meant instead."""
        if topic in self.state.services:
            return "; there is a service of that name"
        kind = self.types.get(topic, "")
        if kind and wanted not in {"", kind}:
            return f"; it is known as {kind}, not {wanted}"
        return did_you_mean(topic, known)

    def address(self, name: str) -> str:
        """Return the address that the master has for a node, nothing where it has none."""
        if name not in self._addresses:
            self._addresses[name] = self._node.address(name)
        return self._addresses[name]

    def is_alive(self, name: str) -> bool:
        """Whether a node answers: one that was killed is known to the master still."""
        if name not in self._alive:
            node = self._node  # which need not ask the master where it is itself
            self._alive[name] = name == node.name or node.answers(self.address(name))
        return self._alive[name]

    def living(self, names: Iterable[str]) -> list[str]:
        """Return those of some nodes that answer; one that hangs holds up no other's answer.

        Raises:
            BridgeError: this process is ending.
        """
        wanted = dict.fromkeys(names)
        unknown = [name for name in wanted if name not in self._alive]
        if len(unknown) > 1:
            try:
                with WorkerExecutor("uoarm-ros1-ask", _AT_ONCE) as pool:
                    tuple(pool.map(self.is_alive, unknown))
            except RuntimeError as error:  # no thread can begin any more
                raise BridgeError("this process is ending", FailureReason.CLOSED) from error
        return [name for name in wanted if self.is_alive(name)]

    def header(self, name: str, topic: str, kind: str) -> PublisherHeader | str:
        """Return what a node says of a topic that it publishes, or why it does not."""
        key = (name, topic, kind)
        if key not in self._headers:
            node = self._node
            wanted = SubscriptionOptions(node.another_name(), topic, kind)
            try:
                uri = node.uri if name == node.name else node.master.node_uri(name)
                until = time.monotonic() + _HEADER_SECONDS
                self._headers[key] = read_publisher_header(uri, wanted, until)
            except (BridgeError, OSError, ProtocolError) as error:
                self._headers[key] = str(error)
        return self._headers[key]


def discovered(
    bridge: str, node: Node, describe: Callable[[Endpoint, Graph], Description]
) -> tuple[Discovered, ...]:
    """Return every node that answers, but our own, as a component.

    Endpoints whose type is not known have no structures; `detail` says why.
    """
    graph = Graph(node)
    state, kinds = graph.state, graph.types
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
        _component(bridge, name, sorted(ports[name], key=lambda port: port[1]), describe, graph)
        for name in graph.living(sorted(ports.keys() - {node.name}))
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
    describe: Callable[[Endpoint, Graph], Description],
    graph: Graph,
) -> Discovered:
    endpoints: list[tuple[Endpoint, Description]] = []
    missing: dict[str, None] = {}
    for role, own, kind in ports:
        address = (own, kind) if kind else (own,)
        port = own.strip("/").replace("/", "_")
        endpoint = Endpoint(bridge, name, role, address, port=port)
        try:
            description = describe(endpoint, graph)
        except BridgeError as error:
            description = Description()
            missing[str(error)] = None
        endpoints.append((endpoint, description))
    return Discovered(name, tuple(endpoints), "; ".join(missing))
