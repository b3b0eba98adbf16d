"""Sources and sinks on topics, and links that move octets as they are."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import partial

from attrs import evolve, frozen

from uoarm.bridge import (
    Channel,
    ChannelHealth,
    ChannelMonitor,
    Delivery,
    HealthReason,
    NativeLink,
    Sink,
    Source,
    on_failure,
)
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Endpoint, Health, Message, Role
from uoarm_ros1._definitions import RosRecord
from uoarm_ros1._discovery import Graph
from uoarm_ros1._node import Node
from uoarm_ros1._options import Ros1Options
from uoarm_ros1._subscription import PublisherHeader, SubscriptionOptions, TopicSubscription
from uoarm_ros1._types import framed_writer, reader

_WAIT_SECONDS = 0.2
_LOOK_SECONDS = 0.005
_SHARED_SECONDS = 0.2
_LATELY_SECONDS = 1.0
_MOST_REFUSED = 16
# For a subscriber that closes its connection to be back: rospy does so to replace it by another.
_RETURN_SECONDS = 1.0


@frozen
class TopicPlace:
    """What a channel on a topic stands on.

    Attributes:
        topic: its full name.
        wait: seconds to wait for the other end.
        clock: returns the seconds by which messages are waited for.
    """

    node: Node
    endpoint: Endpoint
    topic: str
    port: Ros1Options
    wait: float
    report: Callable[[Channel, Health, str], None]
    clock: Callable[[], float] = time.monotonic

    @property
    def node_meant(self) -> str:
        """The full name of the one node that is meant; empty: any."""
        return self.node.resolve(self.port.node) if self.port.node else ""

    @property
    def without_peers(self) -> Health:
        """How a channel here is whose last peer has gone."""
        return Health.LOST if self.port.peer_required else Health.OK

    def wanted(self, record: RosRecord) -> SubscriptionOptions:
        """Return what a subscription here takes."""
        wanted = self.node.wanted(self.topic, record)
        return evolve(wanted, node=self.node_meant, nodelay=self.port.nodelay)


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
        health = ChannelHealth(
            f"publisher of {place.topic}",
            place.clock(),
            stale_after=place.port.stale_after,
            without_peers=place.without_peers,
        )
        self.health = ChannelMonitor(health, say, place.clock)
        self.is_latched = False
        self.breaks = 0
        # Addresses of publishers that are not reached; in the threads of all publishers.
        self._unreached: set[str] = set()
        wanted = evolve(place.wanted(record), in_runs=in_runs)
        self.subscription = TopicSubscription(
            wanted, place.node.peers, take, self._came, self._went, self._settled
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

    def passed(self) -> None:
        """A message came."""
        self.health.passed()
        self._miss_no_more()

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
        self._miss_no_more()
        self._count(header.node)

    def _went(self, name: str, cause: str, was_connected: bool, is_refusal: bool) -> None:  # noqa: FBT001 - of the subscription
        if was_connected:
            self.breaks += 1
            self._gone(name)
            self._count(f"{name}: {cause}")
        else:
            if not is_refusal:
                self._unreached.add(name)
            self.health.judged(HealthReason.REFUSED, Health.DEGRADED, cause, name)

    def _miss_no_more(self) -> None:
        """Another is there: who was killed stays listed, and is not missed."""
        for uri in tuple(self._unreached):
            self._settled(uri)

    def _settled(self, uri: str) -> None:
        self._unreached.discard(uri)
        why = f"{uri} is connected, or publishes no more"
        self.health.judged(HealthReason.REFUSED, Health.OK, why, uri)

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
        self._subscribed.passed()
        self._deliver(message, writer)

    def _close(self) -> None:
        self._subscribed.close()


class _Publishing:
    """A publication, as one channel holds it, with the health of its subscribers."""

    def __init__(
        self, place: TopicPlace, record: RosRecord, say: Callable[[Health, str], None]
    ) -> None:
        self.place = place
        health = ChannelHealth(
            f"subscriber of {place.topic}",
            time.monotonic(),
            without_peers=place.without_peers,
            grace=_RETURN_SECONDS,
        )
        self.health = ChannelMonitor(health, say)
        self._refusal = ""
        # When they were: added to in the loop's thread, taken from by the watch.
        self._refused: dict[str, float] = {}
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

    def tick(self, graph: Graph) -> None:
        """Look whether the last subscriber is back, and who was refused there or gone."""
        self.health.tick()
        before = dict(self._refused)
        if not before:
            return
        try:
            state = graph.state
            subscribing = set(state.subscribers.get(self.place.topic, ()))
            away = graph.living((before.keys() & subscribing).difference(self.publication.callers))
        except BridgeError:
            return  # of the master's absence it says nothing
        for caller, when in before.items():
            if caller not in away and state.asked > when:
                self._refused.pop(caller, None)
                why = f"{caller} is connected, or subscribes no more"
                self.health.judged(HealthReason.REFUSED, Health.OK, why, caller)

    def _watch(self, what: str, refused: str) -> None:
        if not refused:
            callers, wanted = self.publication.callers, self.place.node_meant
            self.health.connected(callers.count(wanted) if wanted else len(callers), what)
            return
        self._refusal = what
        if refused in self._refused or len(self._refused) < _MOST_REFUSED:
            self._refused[refused] = time.monotonic()
            self.health.judged(HealthReason.REFUSED, Health.DEGRADED, what, refused)

    def _wait(self) -> None:
        """Wait until every subscriber that the master knows, and that lives, is connected."""
        self._watch("it is opened", "")
        place, node = self.place, self.place.node
        deadline = time.monotonic() + place.wait
        wanted = place.node_meant
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

    def tick(self, graph: Graph) -> None:
        """Look whether the last subscriber is back, and those that were refused still are."""
        self._publishing.tick(graph)

    def _send(self, message: Message) -> None:
        self._publication.send(self._write(message))

    def _close(self) -> None:
        self._publishing.close()


class Relay(NativeLink):
    """Octets of one topic go out on another of the same type, as they are."""

    def __init__(self, source: TopicPlace, sink: TopicPlace, record: RosRecord) -> None:
        super().__init__(source.endpoint, sink.endpoint)
        self._moved = 0
        self._publishing = _Publishing(sink, record, partial(sink.report, self))
        self._subscribed = _Subscribed(
            source, record, self._take, partial(source.report, self), in_runs=True
        )
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

    def tick(self, graph: Graph) -> None:
        """Look whether messages come, and how the subscribers are."""
        self._subscribed.health.tick()
        self._publishing.tick(graph)

    def _take(self, run: bytes | bytearray, _: str) -> None:
        self._subscribed.passed()
        self._moved += self._publishing.publication.send_run(run)

    def _close(self) -> None:
        self._subscribed.close()
        self._publishing.close()


class SameTopic(NativeLink):
    """Two nodes that have one topic in common: the master has them connected already.

    It looks now and then whether both live still.
    """

    def __init__(self, source: TopicPlace, sink: TopicPlace) -> None:
        super().__init__(source.endpoint, sink.endpoint)
        self._source, self._sink = source, sink
        self._lost: set[Role] = set()  # of the ends
        for end, cause in self._missing(Graph(source.node, time.monotonic() - _SHARED_SECONDS)):
            raise BridgeError(f"{end.endpoint}: {cause}", FailureReason.UNAVAILABLE)

    def tick(self, graph: Graph) -> None:
        """Look whether both ends are there."""
        for end, cause in self._missing(graph):
            if end.endpoint.role not in self._lost and not self.closed:
                self._lost.add(end.endpoint.role)
                end.report(self, Health.LOST, cause)

    def nodes(self, graph: Graph) -> list[str]:
        """Return the nodes of which some must live."""
        return [node for _, _, nodes in self._required(graph) for node in nodes]

    def _missing(self, graph: Graph) -> Iterator[tuple[TopicPlace, str]]:
        with suppress(BridgeError):  # of the master's absence it says nothing
            for end, what, nodes in self._required(graph):
                if not graph.living(nodes):
                    yield end, f"no node that lives {what} {end.topic}"

    def _required(self, graph: Graph) -> Iterator[tuple[TopicPlace, str, tuple[str, ...]]]:
        source, sink, topic = self._source, self._sink, self._source.topic
        if source.port.peer_required:
            yield source, "publishes", graph.state.publishers.get(topic, ())
        if sink.port.peer_required:
            yield sink, "subscribes to", graph.state.subscribers.get(topic, ())

    def _close(self) -> None:
        """Nothing was opened."""
