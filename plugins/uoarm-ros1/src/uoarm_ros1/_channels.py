"""Sources and sinks on topics and parameters, and links that move octets as they are."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

from attrs import evolve, frozen

from uoarm.bridge import (
    Channel,
    ChannelHealth,
    ChannelMonitor,
    Delivery,
    ReceiveQueue,
    Sink,
    Source,
    did_you_mean,
    on_failure,
)
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Deliver, Endpoint, Health, Message, MessageStructure
from uoarm_ros1._definitions import RosRecord
from uoarm_ros1._discovery import Graph
from uoarm_ros1._node import Node
from uoarm_ros1._options import Ros1Address, Ros1Options
from uoarm_ros1._subscription import PublisherHeader, SubscriptionOptions, TopicSubscription
from uoarm_ros1._types import framed_writer, reader

_WAIT_SECONDS = 0.2
_LOOK_SECONDS = 0.005
_SHARED_SECONDS = 0.2
_LATELY_SECONDS = 1.0


@frozen
class TopicPlace:
    """What a channel on a topic stands on.

    Attributes:
        node: of the bridge.
        endpoint: where it is.
        topic: its full name.
        port: the endpoint's options.
        wait: seconds to wait for the other end.
        report: has a channel's health reported.
        clock: returns the seconds by which messages are waited for.
    """

    node: Node
    endpoint: Endpoint
    topic: str
    port: Ros1Options
    wait: float
    report: Callable[[Channel, Health, str], None]
    clock: Callable[[], float] = time.monotonic

    def health(self, what: str, report: Callable[[Health, str], None]) -> ChannelMonitor:
        """Return the health of a new channel here."""
        health = ChannelHealth(
            f"{what} of {self.topic}",
            self.clock(),
            stale_after=self.port.stale_after,
            without_peers=Health.LOST if self.port.peer_required else Health.OK,
        )
        return ChannelMonitor(health, report, self.clock)

    def wanted(self, record: RosRecord) -> SubscriptionOptions:
        """Return what a subscription here takes."""
        publisher = self.node.resolve(self.port.node) if self.port.node else ""
        wanted = self.node.wanted(self.topic, record)
        return evolve(wanted, node=publisher, nodelay=self.port.nodelay)


class _Subscribed:
    """A subscription, as one channel holds it, with the health of its publishers."""

    def __init__(
        self,
        place: TopicPlace,
        record: RosRecord,
        take: Callable[[bytes | bytearray, str], object],
        say: Callable[[Health, str], None],
        gone: Callable[[str], object] = lambda _: None,
        *,
        in_runs: bool = False,
    ) -> None:
        self.place = place
        self._gone = gone
        self.health = place.health("publisher", say)
        self.is_latched = False
        self.breaks = 0
        wanted = evolve(place.wanted(record), in_runs=in_runs)
        self.subscription = TopicSubscription(
            wanted, place.node.peers, take, self._came, self._went
        )

    def open(self) -> None:
        """Begin to take messages; what takes them must be whole by then.

        Raises:
            BridgeError: no peer that is required is there, or the master is not.
        """
        self.place.node.subscribe(self.subscription)
        with on_failure(self.close):
            self._wait()

    @property
    def publishers(self) -> list[str]:
        """The nodes that are connected."""
        return sorted(header.node for header in self.subscription.connected)

    def close(self) -> None:
        self.health.close()
        self.place.node.unsubscribe(self.subscription)

    def _wait(self) -> None:
        """Wait until every publisher that is listed is connected, or could not be."""
        place, subscription = self.place, self.subscription

        def is_ready() -> bool:
            has_one = bool(subscription.connected)
            return subscription.is_settled() and (has_one or not place.port.peer_required)

        subscription.wait(is_ready, place.wait)
        if place.port.peer_required and not subscription.connected:
            node = f" by {place.port.node}" if place.port.node else ""
            why = "; ".join(subscription.failures) or f"no node publishes it{node}"
            text = f"{place.endpoint}: no publisher within {place.wait:g} s: {why}"
            raise BridgeError(text, FailureReason.UNAVAILABLE)

    def _came(self, header: PublisherHeader) -> None:
        self.is_latched = self.is_latched or header.latching
        self._count(header.node)

    def _went(self, name: str, cause: str, was_connected: bool) -> None:  # noqa: FBT001 - of the subscription
        if was_connected:
            self.breaks += 1
            self._gone(name)
            self._count(f"{name}: {cause}")
        else:
            self.health.refused(cause)

    def _count(self, cause: str) -> None:
        self.health.connected(len(self.subscription.connected), cause)


class Ros1TopicSource(Source):
    """What is published on a topic; delivered in the thread of each publisher's connection."""

    def __init__(self, place: TopicPlace, record: RosRecord, deliver: Delivery) -> None:
        super().__init__(place.endpoint)
        self._place, self._deliver = place, deliver
        self._read = reader(record, place.node.options.budget)
        self._received = 0
        self._subscribed = _Subscribed(
            place,
            record,
            self._take,
            partial(place.report, self),
            deliver.let_go,  # what it latched went with it, as for a subscriber that comes now
        )
        self._subscribed.open()
        self.latched = self._subscribed.is_latched

    @property
    def is_silent(self) -> bool:
        """Whether it was lost since nothing came."""
        return self._subscribed.health.is_silent

    def facts(self) -> Mapping[str, object]:
        """Return counters, and the publishers that are connected."""
        return {
            "received": self._received,
            "interruptions": self._subscribed.breaks,
            "publishers": self._subscribed.publishers,
        }

    def tick(self, _: Graph) -> None:
        """Look whether messages come."""
        self._subscribed.health.tick()

    def _take(self, frame: bytes | bytearray, writer: str) -> None:
        self._received += 1
        try:
            message = self._read(frame)
        except MessageError as error:
            self._deliver.unreadable(f"{self._place.topic}: {error}")
            return
        self._subscribed.health.passed()
        self._deliver(message, writer)

    def _close(self) -> None:
        self._subscribed.close()


class _Publishing:
    """A publication, as one channel holds it, with the health of its subscribers."""

    def __init__(
        self, place: TopicPlace, record: RosRecord, say: Callable[[Health, str], None]
    ) -> None:
        self.place = place
        self.health = place.health("subscriber", say)
        self._refusal = ""
        port, node = place.port, place.node
        limits = (port.queue, 4 * node.options.budget.octets)
        self.publication = node.advertise(place.topic, record, latch=int(port.latch), limits=limits)
        self._before = self.publication.lost
        self.publication.watchers = (*self.publication.watchers, self._watch)
        with on_failure(self.close):
            self._wait()

    @property
    def lost(self) -> int:
        return self.publication.lost - self._before

    def close(self) -> None:
        self.health.close()
        publication = self.publication
        publication.watchers = tuple(
            watcher for watcher in publication.watchers if watcher != self._watch
        )
        self.place.node.withdraw(publication)

    def _watch(self, what: str, refused: bool) -> None:  # noqa: FBT001 - of the publication
        if refused:
            self._refusal = what
            self.health.refused(what)
        else:
            self.health.connected(len(self.publication.callers), what)

    def _wait(self) -> None:
        """Wait until every subscriber that the master knows, and that lives, is connected."""
        self._watch("it is opened", False)
        place, node = self.place, self.place.node
        deadline = time.monotonic() + place.wait
        wanted = place.port.node and node.resolve(place.port.node)
        rest, asked = threading.Event(), 0.0
        expected: set[str] = set()
        while True:
            if time.monotonic() >= asked + _WAIT_SECONDS:
                asked = time.monotonic()
                expected = {wanted} if wanted else self._expected()
                if not expected and not place.port.peer_required:
                    return
            left = deadline - time.monotonic()
            if self.publication.wait(
                partial(_are_there, expected), min(max(left, 0.0), _WAIT_SECONDS)
            ):
                # One of our own may be given up after it was taken in here: it says itself.
                if wanted or all(node.own_callers(place.topic).values()):
                    return
                rest.wait(_LOOK_SECONDS)
            if left <= 0:
                break
        callers = self.publication.callers
        if place.port.peer_required and not (wanted in callers if wanted else callers):
            who = f"{wanted} does not subscribe" if wanted else "no node subscribes"
            text = f"{place.endpoint}: no subscriber within {place.wait:g} s: {who}"
            if self._refusal:
                text = f"{place.endpoint}: {self._refusal}"
            elif expected and not wanted:
                host = node.identity.host or "its own"
                text = (
                    f"{place.endpoint}: {', '.join(sorted(expected))} did not connect within "
                    f"{place.wait:g} s: set the bridge's option `host`, or ROS_IP, to an address "
                    f"under which that node reaches this one (now {host})"
                )
            raise BridgeError(text, FailureReason.UNAVAILABLE)

    def _expected(self) -> set[str]:
        """Return the nodes that are to connect."""
        node, topic = self.place.node, self.place.topic
        callers = set(self.publication.callers)
        graph = Graph(node, time.monotonic() - _LATELY_SECONDS)
        names = graph.state.subscribers.get(topic, ())
        if len(names) != self.publication.registered:
            graph = Graph(node)
            names = graph.state.subscribers.get(topic, ())
        others = set(names) - {node.name}
        return {*node.own_callers(topic), *(others & callers), *graph.living(others - callers)}


def _are_there(expected: set[str], callers: list[str]) -> bool:
    return bool(expected) and expected <= set(callers)


class Ros1TopicSink(Sink):
    """Publishes on a topic: what a subscriber's connection does not take at once waits for it."""

    blocking = False
    parallel = True

    def __init__(self, place: TopicPlace, record: RosRecord) -> None:
        super().__init__(place.endpoint)
        self._write = framed_writer(record)
        self._publishing = _Publishing(place, record, partial(place.report, self))
        self._publication = self._publishing.publication

    def facts(self) -> Mapping[str, object]:
        """Return counters, and the subscribers that are connected."""
        return {
            "under_way": self._publication.waiting,
            "lost_on_link": self._publishing.lost,
            "sent": self._publication.sent,
            "subscribers": sorted(self._publication.callers),
        }

    def drain(self, timeout: float) -> bool:
        """Wait until every subscriber's machine has what was sent."""
        return self._publication.drain(timeout)

    def _send(self, message: Message) -> None:
        self._publication.send(self._write(message))

    def _close(self) -> None:
        self._publishing.close()


class Relay(Channel):
    """Octets of one topic go out on another of the same type, as they are."""

    def __init__(self, source: TopicPlace, sink: TopicPlace, record: RosRecord) -> None:
        super().__init__(source.endpoint)
        self._moved = 0

        def say(health: Health, cause: str) -> None:
            source.report(self, health, cause)

        self._publishing = _Publishing(sink, record, say)
        self._subscribed = _Subscribed(source, record, self._take, say, in_runs=True)
        with on_failure(self._publishing.close):
            self._subscribed.open()

    @property
    def is_silent(self) -> bool:
        """Whether it was lost since nothing came."""
        return self._subscribed.health.is_silent

    def facts(self) -> Mapping[str, object]:
        """Return counters."""
        publication = self._publishing.publication
        return {
            "moved": self._moved,
            "under_way": publication.waiting,
            "lost_on_link": self._publishing.lost,
        }

    def drain(self, timeout: float) -> bool:
        """Wait until every subscriber's machine has what was moved."""
        return self._publishing.publication.drain(timeout)

    def tick(self, _: Graph) -> None:
        """Look whether messages come."""
        self._subscribed.health.tick()

    def _take(self, run: bytes | bytearray, _: str) -> None:
        self._subscribed.health.passed()
        self._moved += self._publishing.publication.send_run(run)

    def _close(self) -> None:
        self._subscribed.close()
        self._publishing.close()


class SameTopic(Channel):
    """Two nodes that have one topic in common: the master has them connected already.

    It looks now and then whether both live still.
    """

    def __init__(self, source: TopicPlace, sink: TopicPlace) -> None:
        super().__init__(source.endpoint)
        self._source, self._sink = source, sink
        self._is_lost = False
        if cause := self._missing(Graph(source.node, time.monotonic() - _SHARED_SECONDS)):
            raise BridgeError(f"{source.endpoint}: {cause}", FailureReason.UNAVAILABLE)

    def tick(self, graph: Graph) -> None:
        """Look whether both ends are there."""
        if not self._is_lost and not self.closed and (cause := self._missing(graph)):
            self._is_lost = True
            self._source.report(self, Health.LOST, cause)

    def nodes(self, graph: Graph) -> list[str]:
        """Return the nodes of which some must live."""
        return [node for _, nodes in self._required(graph) for node in nodes]

    def _missing(self, graph: Graph) -> str:
        try:
            for what, nodes in self._required(graph):
                if not graph.living(nodes):
                    return f"no node that lives {what} {self._source.topic}"
        except BridgeError:
            pass  # of the master's absence it says nothing
        return ""

    def _required(self, graph: Graph) -> Iterator[tuple[str, tuple[str, ...]]]:
        topic = self._source.topic
        if self._source.port.peer_required:
            yield "publishes", graph.state.publishers.get(topic, ())
        if self._sink.port.peer_required:
            yield "subscribes to", graph.state.subscribers.get(topic, ())

    def _close(self) -> None:
        """Nothing was opened."""


_INTEGER = {"type": "integer", "minimum": -(2**31), "maximum": 2**31 - 1}
_ABSENT: Any = {}
_LOOK: Any = object()
_DEEP = 16


def parameter_structure(
    node: Node, endpoint: Endpoint, address: Ros1Address
) -> MessageStructure | None:
    """Return what the value of a parameter is like now.

    Raises:
        BridgeError: it is not set.
    """
    name = node.resolve(address.name)
    try:
        value = node.master.call("getParam", name)
    except BridgeError as error:
        if error.reason is not FailureReason.REFUSED:
            raise
        names = node.master.call("getParamNames")
        meant = did_you_mean(name, map(str, names)) if isinstance(names, list) else ""
        text = f"{endpoint}: the parameter {name} is not set{meant}"
        raise BridgeError(text, FailureReason.NOT_FOUND) from error
    return MessageStructure(_schema(value, _DEEP), native_type="parameter")


def _schema(value: Any, depth: int) -> Any:
    if isinstance(value, bool):
        return {"type": "boolean"}
    if isinstance(value, int):
        return dict(_INTEGER)
    if isinstance(value, float):
        return {"type": "number"}
    if isinstance(value, str):
        return {"type": "string"}
    if isinstance(value, bytes):
        octet = {"type": "integer", "minimum": 0, "maximum": 255}
        return {"type": "array", "items": octet, "x-octets": True}
    if isinstance(value, list):
        kinds = [_schema(item, depth - 1) for item in value] if depth else []
        same = bool(kinds) and all(kind == kinds[0] for kind in kinds)
        return {"type": "array", "items": kinds[0]} if same else {"type": "array"}
    if isinstance(value, dict) and depth:
        return {
            "type": "object",
            "properties": {key: _schema(item, depth - 1) for key, item in value.items()},
            "required": sorted(value),
        }
    return True


class Ros1ParameterSource(Source):
    """The value of a parameter as it is, and each time that it is set.

    While it is not set any more, since it was deleted or the master was started again without it,
    or has a value that is more than is read, the channel is degraded.
    """

    latched = True

    def __init__(
        self,
        node: Node,
        endpoint: Endpoint,
        address: Ros1Address,
        deliver: Deliver,
        report: Callable[[Channel, Health, str], None],
    ) -> None:
        super().__init__(endpoint)
        self._node, self._deliver, self._report = node, deliver, report
        self._name = node.resolve(address.name)
        self._received = 0
        self._is_gone = self._is_looking = False
        # Guards the last value: what the master answers comes in one thread, changes in the loop's.
        self._lock = threading.Lock()
        self._last: Any = _ABSENT
        # Only the newest matter to who is slow.
        self._queue: ReceiveQueue[Any] = ReceiveQueue(f"uoarm-ros1-{self._name}", self._hand_on, 2)
        with on_failure(self._queue.close):
            value = node.watch_parameter(self._name, self._take)
        if value == _ABSENT:
            self._close()
            text = f"{endpoint}: the parameter {self._name} is not set"
            raise BridgeError(text, FailureReason.NOT_FOUND)
        self._take(self._name, value, is_set=False)

    def facts(self) -> Mapping[str, object]:
        """Return counters."""
        return {"received": self._received, "under_way": len(self._queue)}

    def _take(self, key: str, value: Any, *, is_set: bool) -> None:
        """Take a value that was set, or that is what a registration found, at first or again."""
        with self._lock:
            if key != self._name:  # one within it: the whole is asked for
                value = _ABSENT
            # A new master that has none reports the next one: whether it has come meanwhile is
            # looked at, and not delivered, or both would bring it.
            elif not is_set and value == _ABSENT:
                if not self._is_looking:
                    self._is_looking = True
                    self._queue.put(_LOOK)
                return
            # The bridge's look at the master may register anew between the entry in the node's
            # table and the first registration: both find the same value, which was set once.
            elif not is_set and value == self._last:
                return
            self._last = value
            self._queue.put(value)

    def _hand_on(self, value: Any) -> None:
        is_look = value is _LOOK
        if is_look:
            self._is_looking = False
        if is_look or value == _ABSENT:
            try:
                value = self._node.master.call("getParam", self._name)
            except BridgeError as error:
                if error.reason is FailureReason.REFUSED:
                    self._note_gone("is not set any more")
                elif error.reason is FailureReason.BAD_MESSAGE:
                    self._note_gone(f"cannot be read: {error}")
                return  # or the master is away: it is looked at again when it is back
        if is_look:
            return
        if self._is_gone:
            self._is_gone = False
            self._report(self, Health.OK, f"the parameter {self._name} is set again")
        self._received += 1
        self._deliver(value)

    def _note_gone(self, why: str) -> None:
        with self._lock:
            self._last = _ABSENT  # the value that it had is news when it is found again
        if not self._is_gone:
            self._is_gone = True
            self._report(self, Health.DEGRADED, f"the parameter {self._name} {why}")

    def _close(self) -> None:
        self._queue.close()
        self._node.unwatch_parameter(self._name, self._take)


class Ros1ParameterSink(Sink):
    """Sets a parameter; waits for the master to take it."""

    def __init__(self, node: Node, endpoint: Endpoint, address: Ros1Address) -> None:
        super().__init__(endpoint)
        self._node, self._name = node, node.resolve(address.name)
        self._sent = 0

    def facts(self) -> Mapping[str, object]:
        """Return counters."""
        return {"sent": self._sent}

    def _send(self, message: Message) -> None:
        value = plain(message)
        try:
            self._node.master.call("setParam", self._name, value)
        except ValueError as error:
            raise MessageError(f"{self._name}: {error}") from error
        self._sent += 1
        self._node.parameter_changed(self._name, value)

    def _close(self) -> None:
        """Nothing is held."""


def plain(value: Any) -> Any:
    """Return a message without arrays of numpy, which XML-RPC does not know."""
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if hasattr(value, "tolist") and not isinstance(value, memoryview):
        return value.tolist()
    return value
