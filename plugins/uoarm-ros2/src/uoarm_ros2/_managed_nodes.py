"""Which components stand on which node, and what their options ask of it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

from attrs import evolve, frozen

from uoarm.bridge import Channel, reading_endpoint
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Endpoint
from uoarm_ros2._graph import Graph
from uoarm_ros2._managed_node import Hold, ManagedNode, NodeAccess, Wish
from uoarm_ros2._parameters import flattened
from uoarm_ros2._settings import Settings, node_of

__all__ = ["ManagedNodes"]


Open = TypeVar("Open", bound=Channel)


@frozen
class Held:
    """A node as its component wants it; `settings` say how to open something at it."""

    settings: Settings
    _hold: Hold | None

    def until_closed(self, channel: Open) -> Open:
        """Have the node stay so until a channel is closed; returns the channel."""
        if self._hold is not None:
            self._hold.channel = channel
        return channel


class ManagedNodes:
    """All nodes that components of one bridge stand on; thread safe.

    Args:
        access: how they are reached.
        graph: where they are waited for.
        resolve: makes a full name of one that may be relative.
    """

    def __init__(self, access: NodeAccess, graph: Graph, resolve: Callable[[str], str]) -> None:
        self._access = access
        self._graph = graph
        self._resolve = resolve
        self._lock = threading.Lock()
        self._nodes: dict[str, ManagedNode] = {}

    def described(self, endpoint: Endpoint, settings: Settings) -> Settings:
        """Return the settings with which an endpoint is described, once its node is there.

        The topics of a node that is not configured yet are not on the graph.

        Raises:
            BridgeError: the node is not there, or is a lifecycle node that has ended.
        """
        wish = self._wish(endpoint, settings)
        if wish is None:
            return settings
        node = self._there(wish, settings)
        if not wish.activate:
            return settings
        state = node.state()
        if state == "finalized":
            text = f"lifecycle node {wish.node} is finalized, which only a restart of it ends"
            raise BridgeError(text, FailureReason.UNAVAILABLE)
        if state == "unconfigured" and len(endpoint.address) == 1:
            text = (
                f"lifecycle node {wish.node} is unconfigured and shows no topics yet: "
                f"name the type of {endpoint.address[0]} in the address"
            )
            raise BridgeError(text, FailureReason.BAD_ENDPOINT)
        return settings if state == "active" else evolve(settings, peer_required=False)

    @contextmanager
    def held(self, endpoint: Endpoint, settings: Settings) -> Iterator[Held]:
        """Have the node as its component wants it for the length of a block, or longer.

        Raises:
            BridgeError: the node is not there, refuses, or cannot be activated.
        """
        wish = self._wish(endpoint, settings)
        if wish is None:
            yield Held(settings, None)
            return
        node = self._there(wish, settings)
        hold = node.hold(endpoint.component, wish)
        if wish.activate:  # what it makes as it is configured is seen a moment later
            settings = evolve(settings, wait=self._graph.limit(settings))
        try:
            yield Held(settings, hold)
        finally:
            if hold.channel is None:
                node.release(hold)

    def tick(self) -> None:
        """Take note of what was closed; never blocks."""
        for node in list(self._nodes.values()):
            node.tick()

    def close(self, seconds: float) -> None:
        """Leave all nodes as they were found, within so many seconds as far as they let."""
        deadline = time.monotonic() + seconds
        nodes = list(self._nodes.values())
        for node in nodes:
            node.begin_closing()
        for node in nodes:
            node.join(max(0.0, deadline - time.monotonic()))

    def _wish(self, endpoint: Endpoint, settings: Settings) -> Wish | None:
        with reading_endpoint(endpoint):
            name = node_of(endpoint, settings)
            if not name:
                return None
            parameters = flattened(endpoint.parameters)
        return Wish(
            self._resolve(name),
            settings.activate != "false",
            settings.activate == "keep",
            settings.afterwards,
            parameters,
        )

    def _there(self, wish: Wish, settings: Settings) -> ManagedNode:
        """Return a node once it has the services that are needed."""
        with self._lock:
            node = self._nodes.setdefault(wish.node, ManagedNode(wish.node, self._access))
        needed = ["get_state"] if wish.activate else []
        needed += ["set_parameters_atomically"] if wish.parameters else []
        missing: list[str] = []

        def there() -> bool:
            missing[:] = [word for word in needed if not node.serves(word)]
            return not missing

        if not self._graph.settled(f"node {wish.node}", there, settings):
            services = (name.rpartition("/") for name in self._graph.servers_named())
            nodes = {node for node, _, service in services if service == missing[0]}
            what = f"there is no node {wish.node} with a service {missing[0]}"
            text = self._graph.absence(what, wish.node, nodes)
            raise BridgeError(text, FailureReason.NOT_FOUND)
        return node
