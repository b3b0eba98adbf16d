"""The pool: components and edges that are open, each opened once and counted by its users."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from attrs import define, field

from uoarm.adapt import transfer
from uoarm.bridge import Bridge, Channel
from uoarm.errors import BridgeError, ConnectionClosedError, ResolutionError
from uoarm.flow import Clock, Route, make_check
from uoarm.manager._live import LiveComponent, facts_of
from uoarm.model import Edge, QueuePolicy, RouteStatus, Step, ValidationMode

__all__ = ["LiveEdge", "Pool"]

_STRICTNESS = (ValidationMode.OFF, ValidationMode.SAMPLED, ValidationMode.ALWAYS)
_log = logging.getLogger("uoarm")


@define(eq=False)
class LiveEdge:
    """An open edge: a route of ours, or a native link of the bridge.

    Its messages are checked as the strictest of its users wishes; a native link's never are.
    """

    edge: Edge
    users: dict[str, ValidationMode] = field(factory=dict)
    route: Route | None = None
    link: Channel | None = None
    ready: threading.Lock = field(factory=threading.Lock)
    checking: threading.Lock = field(factory=threading.Lock)

    def renew_check(self) -> None:
        """Check messages as the users of this moment wish."""
        if self.route is None:
            return
        with self.checking:
            wished = list(self.users.values())
            mode = max(wished, key=_STRICTNESS.index, default=ValidationMode.OFF)
            name = producer_name(self.edge)
            self.route.check = make_check(self.edge.producer_structure, mode, name)

    def status(self) -> RouteStatus | None:
        """Return what the status map shows; None while the edge is being opened."""
        if self.route is not None:
            return self.route.status()
        if self.link is None:
            return None
        ends = producer_name(self.edge), consumer_name(self.edge)
        return RouteStatus(*ends, 0, 0, native=True, facts=facts_of(self.link))


class Pool:
    """What is open now, shared between connections.

    Args:
        bridge: gives the bridge instance of a name.
        clock: seconds.
    """

    def __init__(self, bridge: Callable[[str], Bridge], clock: Clock) -> None:
        self._bridge = bridge
        self._clock = clock
        self._lock = threading.Lock()
        self._components: dict[str, LiveComponent] = {}
        self._edges: dict[tuple[str, str], LiveEdge] = {}

    def enter(self, step: Step, user: str) -> LiveComponent:
        """Count a user of a component; nothing is opened yet."""
        bridge = self._bridge(step.component.bridge)
        with self._lock:
            live = self._components.get(step.component.name)
            if live is None:
                live = self._components[step.component.name] = LiveComponent(step, bridge)
            live.users.append(user)
            return live

    def leave(self, live: LiveComponent, user: str) -> None:
        """Take one user back; the last one closes the component."""
        with self._lock:
            live.users.remove(user)
            if live.users:
                return
            if self._components.get(live.component.name) is live:
                del self._components[live.component.name]
        live.close()

    def join(
        self,
        edge: Edge,
        user: str,
        *,
        producer: LiveComponent,
        consumer: LiveComponent,
        validate: ValidationMode,
    ) -> LiveEdge:
        """Count a user of an edge, and open it when there was none.

        Raises:
            ResolutionError: the input is in use, fed by another component.
            BridgeError: a bridge could not open the input.
        """
        key = edge.consumer, edge.input
        with self._lock:
            joined = self._edges.get(key)
            if joined is None:
                joined = self._edges[key] = LiveEdge(edge)
            elif (joined.edge.producer, joined.edge.output) != (edge.producer, edge.output):
                raise ResolutionError(
                    f"component {edge.consumer!r} is in use with its input {edge.input!r} fed by "
                    f"{joined.edge.producer!r}; this plan feeds it from {edge.producer!r}"
                )
            joined.users[user] = validate
        try:
            with joined.ready:
                if joined.route is None and joined.link is None:
                    self._open(joined, producer, consumer)
                joined.renew_check()
        except BaseException:
            self.part(joined, user, producer)
            raise
        if user not in joined.users:
            _shut(joined, producer)
            raise ConnectionClosedError(f"{user} was given up while {key[0]!r} was being opened")
        return joined

    def part(self, joined: LiveEdge, user: str, producer: LiveComponent) -> None:
        """Take one user of an edge back; the last one closes it."""
        with self._lock:
            joined.users.pop(user, None)
            key = joined.edge.consumer, joined.edge.input
            if not joined.users and self._edges.get(key) is joined:
                del self._edges[key]
        if joined.users:
            joined.renew_check()
        else:
            _shut(joined, producer)

    def bury(self, live: LiveComponent) -> None:
        """Share a dead component no more, nor its edges; its users still leave it as ever."""
        with self._lock:
            if self._components.get(live.component.name) is live:
                del self._components[live.component.name]
                name = live.component.name
                self._edges = {
                    key: joined
                    for key, joined in self._edges.items()
                    if name not in {joined.edge.producer, joined.edge.consumer}
                }

    def components(self) -> tuple[LiveComponent, ...]:
        """Return the components open now."""
        with self._lock:
            return tuple(self._components.values())

    def edges(self) -> tuple[LiveEdge, ...]:
        """Return the edges open now."""
        with self._lock:
            return tuple(self._edges.values())

    def _open(self, joined: LiveEdge, producer: LiveComponent, consumer: LiveComponent) -> None:
        edge = joined.edge
        joined.link = _native_link(edge, producer, consumer)
        if joined.link is not None:
            return
        sink = consumer.open_input(edge.input)
        queue = next(i.queue for i in consumer.component.inputs if i.name == edge.input)
        if queue is None and sink.blocking:
            queue = QueuePolicy()
        route = Route(
            producer_name(edge),
            consumer_name(edge),
            sink.send,
            clock=self._clock,
            transfer=transfer(edge),
            queue=queue,
        )
        joined.route = route
        producer.outlets[edge.output].attach(route)


def _shut(joined: LiveEdge, producer: LiveComponent) -> None:
    """Close an edge, also for the second time."""
    if joined.route is not None:
        producer.outlets[joined.edge.output].detach(joined.route)
        joined.route.close()
    if joined.link is not None:
        try:
            joined.link.close()
        except BridgeError as error:
            _log.warning("%s", error)


def producer_name(edge: Edge) -> str:
    """Name the output of an edge as the status map does."""
    return f"{edge.producer}.{edge.output}"


def consumer_name(edge: Edge) -> str:
    """Name the input of an edge as the status map does."""
    return f"{edge.consumer}.{edge.input}"


def _native_link(edge: Edge, producer: LiveComponent, consumer: LiveComponent) -> Channel | None:
    """Let the bridge connect both ends itself where they are its own and of one structure."""
    if producer.bridge is not consumer.bridge or edge.mapping is not None:
        return None
    if edge.producer_structure != edge.consumer_structure:
        return None
    if not producer.bridge.capabilities.link:
        return None
    output = producer.component.output(edge.output)
    assert output is not None, "the resolver checked every output"
    sink = next(i.endpoint for i in consumer.component.inputs if i.name == edge.input)
    return producer.bridge.link(output.endpoint, sink)
