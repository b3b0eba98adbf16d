"""Channels of topics: publishers as sinks, subscriptions as sources, links between topics."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any

from attrs import evolve

from uoarm.bridge import ChannelMonitor, Delivery, NativeLink, Sink, Source, on_failure
from uoarm.cdr import forget_octets, note_octets
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Deliver, Health, Message, OverflowPolicy, QueuePolicy
from uoarm_ros2._health import monitored
from uoarm_ros2._middleware import Peer, publish_released, rclpy_errors
from uoarm_ros2._qos import KEEP_ALL_SECONDS, Policies, clashes, for_reading, for_writing
from uoarm_ros2._topic_endpoint import TopicContext, TopicEndpoint, judge_by_entry

_LARGE_OCTETS = 65_536
_FULL = "cannot publish data"
_LOSSLESS = QueuePolicy(policy=OverflowPolicy.BLOCK, timeout=KEEP_ALL_SECONDS)


class _Publisher(TopicEndpoint):
    """The writing end of a topic."""

    peer_word = "subscription"

    def graph_peers(self, topic: str) -> tuple[Peer, ...]:
        return self._context.runner.subscriptions(topic)

    def count(self) -> int:
        return int(self.native.get_subscription_count())

    def clashes_with(self, peer: Policies) -> tuple[str, ...]:
        return clashes(self.policies, peer)

    def comparison(self, peer: Peer) -> str:
        return (
            f"subscription {peer.node} asks ({peer.policies}), "
            f"this publisher offers ({self.policies})"
        )

    def all_matched(self) -> bool:
        """Whether every subscription on the graph that fits is matched, and one at least."""
        fitting = [peer for peer in self.peers() if not self.clashes_with(peer.policies)]
        return self.count() >= max(1, len(fitting))

    def reaches_none(self) -> bool:
        """Whether a message is lost: a subscription is required, none is matched, none may come.

        The event of the first match comes a moment after it, so that none is not taken for granted.
        """
        is_kept = self.policies.durability == "transient_local"
        if self._health.peers or is_kept or not self._context.options.peer_required:
            return False
        with suppress(BridgeError), rclpy_errors(f"topic {self._context.topic.name}"):
            return not self.count()
        return False

    def _fitting(self, peers: Iterable[Peer]) -> Policies:
        return for_writing(self._context.qos, [peer.policies for peer in peers])

    def _create(self) -> Any:
        context = self._context
        return context.runner.advertise(
            context.native, context.topic.name, self.policies, events=self.events()
        )


class PublisherSink(Sink):
    """One publisher.

    With `auto` policies it offers what the subscriptions ask, and offers anew when all that are
    left ask for something else. `send` blocks only with `history: keep_all`, while slow readers
    catch up.

    A publisher takes messages from several threads at once: so ROS 2 promises of `rmw_publish`, and
    rclpy keeps one that is being destroyed until no call uses it.

    Args:
        write: makes the octets that are published of a message.
    """

    parallel = True

    def __init__(self, context: TopicContext, write: Callable[[Message], bytes]) -> None:
        super().__init__(context.endpoint)
        # Guards the count: a stop message is sent from another thread than commands.
        self._counting = threading.Lock()
        self._lost = 0
        self._context = context
        self._write = write
        self._health = context.health(self)
        self._publisher = _Publisher(context, self._health)
        self.blocking = self._publisher.policies.history == "keep_all"
        self.default_queue = _LOSSLESS

    def _send(self, message: Message) -> None:
        """Publish one message.

        Raises:
            MessageError: it does not fit the native type; the text names the field.
            BridgeError: the channel was closed while it sends, or the middleware took nothing.
        """
        octets = self._write(message)
        native_publisher = self._publisher.native
        try:
            self._publish(native_publisher, octets)
        except Exception as error:  # noqa: BLE001 - raised again there, unless it can be helped
            self._publish_anyway(octets, native_publisher, error)
        self._health.passed()
        if self._publisher.reaches_none():
            with self._counting:
                self._lost += 1

    def wait(self) -> None:
        """Wait until every fitting subscription on the graph is matched.

        Raises:
            BridgeError: none was matched within the limit although one is required.
        """
        context, publisher = self._context, self._publisher
        expects_peers = context.options.peer_required or bool(publisher.peers())
        limit = context.graph.limit(context.options) if expects_peers else 0.0
        context.graph.until(
            lambda: self.closed or publisher.all_matched() or publisher.cannot_match(), limit
        )
        peers = publisher.peers()
        publisher.require(limit, peers)
        if publisher.count() and any(peer.policies.reliability == "best_effort" for peer in peers):
            # A reader that does not ask for repeats must have matched us before the first message.
            context.graph.settle(peers, context.settle, lambda: self.closed)

    def tick(self) -> None:
        """Look after the channel a few times a second, in the runner's thread."""
        self._publisher.tick()

    def drain(self, timeout: float) -> bool:
        """Wait until every reliable subscription has acknowledged what was published.

        One that is matched may not have matched this publisher yet, since discovery goes both ways
        on its own, and then gets what was sent only as long as the publisher is there. Fast DDS
        asks for acknowledgements every three seconds.
        """
        context, publisher = self._context, self._publisher
        return context.graph.until(
            lambda: context.runner.is_acknowledged(publisher.native), timeout
        )

    def facts(self) -> Mapping[str, object]:
        """Return counters, the matched subscriptions and the policies in force."""
        return {**self._publisher.facts(), "lost_on_link": self._lost}

    def _publish(self, native_publisher: Any, octets: bytes) -> None:
        """Publish; what waits for room in a full history must not keep the interpreter's lock.

        rclpy copies octets into memory that is new each time: half a millisecond of a picture.
        """
        if self.blocking or len(octets) >= _LARGE_OCTETS:
            publish_released(native_publisher, octets)
        else:
            native_publisher.publish(octets)

    def _publish_anyway(self, octets: bytes, native_publisher: Any, error: Exception) -> None:
        """Publish with the publisher that took the place of one, or once the history has room.

        The rmw itself waits for room a tenth of a second only.
        """
        deadline = time.monotonic() + KEEP_ALL_SECONDS
        while True:
            if self._closed:
                text = f"bridge {self.endpoint.bridge!r}: {self.endpoint} is closed"
                raise BridgeError(text, FailureReason.CLOSED) from error
            if self._context.runner.is_cut_off:
                self._publish_last(octets, native_publisher)
                return
            waits = self.blocking and _FULL in str(error) and time.monotonic() < deadline
            if native_publisher is self._publisher.native and not waits:
                text = f"topic {self._context.topic.name} takes no message: {error}"
                raise BridgeError(text, FailureReason.UNAVAILABLE) from error
            native_publisher = self._publisher.native
            try:
                self._publish(native_publisher, octets)
            except Exception as another:  # noqa: BLE001 - looked at in the next round
                error = another
            else:
                return

    def _publish_last(self, octets: bytes, native_publisher: Any) -> None:
        try:
            publish_released(native_publisher, octets)
        except OSError as error:
            text = f"topic {self._context.topic.name} takes no message: {error}"
            raise BridgeError(text, FailureReason.UNAVAILABLE) from error

    def _close(self) -> None:
        self._publisher.close()


_LOOKS = 10  # ticks within which the graph knows that a publisher has gone


class _Subscription(TopicEndpoint):
    """The reading end of a topic."""

    peer_word = "publisher"

    def __init__(
        self, context: TopicContext, health: ChannelMonitor, take: Callable[..., None]
    ) -> None:
        self._take = take
        super().__init__(context, health, receives=True)

    def graph_peers(self, topic: str) -> tuple[Peer, ...]:
        return self._context.runner.publishers(topic)

    def count(self) -> int:
        return int(self.native.get_publisher_count())

    def clashes_with(self, peer: Policies) -> tuple[str, ...]:
        return clashes(peer, self.policies)

    def comparison(self, peer: Peer) -> str:
        return (
            f"publisher {peer.node} offers ({peer.policies}), "
            f"this subscription asks ({self.policies})"
        )

    def unreached(self, peers: Sequence[Peer]) -> str:
        """Name publishers whose latched messages do not come since other publishers latch none."""
        context = self._context
        latched = [peer for peer in peers if peer.policies.durability == "transient_local"]
        if not latched or self.policies.durability == "transient_local":
            return ""
        if context.qos.durability != "auto":
            return ""
        volatile = [peer.node for peer in peers if peer not in latched]
        return (
            f"{', '.join(peer.node for peer in latched)} latched what they published, which does "
            f"not come since {', '.join(volatile)} latch nothing; with qos: {{durability: "
            "transient_local} it comes, and nothing of those that latch nothing"
        )

    def _fitting(self, peers: Iterable[Peer]) -> Policies:
        return for_reading(self._context.qos, [peer.policies for peer in peers])

    def _create(self) -> Any:
        context, health = self._context, self._health
        events = self.events()
        dead = Health.LOST if context.options.peer_required else Health.DEGRADED

        def note_liveliness(info: Any) -> None:
            if info.alive_count:
                health.peer_reported(Health.OK, "the publisher says again that it is alive")
            elif info.not_alive_count:
                text = "the publisher no longer says that it is alive (liveliness)"
                health.peer_reported(dead, text)

        events["liveliness"] = note_liveliness
        events["message_lost"] = lambda info: self.note_lost(info.total_count)
        return context.runner.subscribe(
            context.native,
            context.topic.name,
            self.policies,
            self._take,
            events=events,
            names_writers=self.policies.durability == "transient_local",
        )


class SubscriptionSource(Source):
    """One subscription; each message goes to `deliver` in the runner's thread.

    With `auto` policies it asks for what the publishers offer, and asks anew when all that are
    left offer something else.

    What was latched stands as for a subscription of its own: the last messages of each publisher,
    as long as the publisher is there.

    Args:
        read: makes what is delivered of the serialised form; raises MessageError.
        definition: of the type, where what is delivered is a message of it.
    """

    def __init__(
        self,
        context: TopicContext,
        read: Callable[[bytes], Message],
        deliver: Deliver,
        definition: str = "",
    ) -> None:
        super().__init__(context.endpoint)
        self._context = context
        self._read, self._definition = read, definition
        self._deliver = deliver
        self._delivery = deliver if isinstance(deliver, Delivery) else None
        self._health = context.health(self, receives=True)
        self._writers: set[bytes] = set()  # whose messages stand; in the runner's thread
        self._departures = self._looks = 0
        self._subscription = _Subscription(context, self._health, self._receive)

    def wait(self) -> None:
        """Wait until a publisher is matched and has had the time to learn of us.

        Raises:
            BridgeError: none was matched within the limit although one is required.
        """
        context = self._context
        limit = context.graph.limit(context.options)
        subscription = self._subscription
        context.graph.until(
            lambda: self.closed or subscription.count() > 0 or subscription.cannot_match(), limit
        )
        matched = subscription.count() > 0
        peers = subscription.peers()
        subscription.require(limit, peers)
        self.latched = subscription.policies.durability == "transient_local"
        self.depth = subscription.policies.depth
        if subscription.policies.history == "keep_all":
            self.patience = KEEP_ALL_SECONDS
        if matched and not self.latched:
            context.graph.settle(peers, context.settle, lambda: self.closed)

    def tick(self) -> None:
        """Look after the channel a few times a second, in the runner's thread."""
        self._subscription.tick()
        self._look_for_departures()

    def facts(self) -> Mapping[str, object]:
        """Return counters, the matched publishers and the policies in force."""
        return self._subscription.facts()

    def _close(self) -> None:
        self._subscription.close()

    def _look_for_departures(self) -> None:
        """Withdraw what publishers latched that have gone, as DDS does."""
        if not self._writers or self._delivery is None:
            return
        if self._subscription.departures != self._departures:
            self._departures, self._looks = self._subscription.departures, _LOOKS
        if not self._looks and len(self._writers) <= self._subscription.count():
            return
        self._looks = max(0, self._looks - 1)
        there = {peer.identity for peer in self._subscription.peers()}
        for writer in self._writers - there:
            self._writers.discard(writer)
            self._delivery.let_go(writer.hex())

    def _receive(self, octets: bytes, writer: bytes = b"") -> None:
        if self._closed:
            return
        try:
            message = self._read(octets)
        except MessageError as error:
            if self._delivery is not None:
                self._delivery.unreadable(f"topic {self._context.topic.name}: {error}")
            return
        self._health.passed()
        if self._definition:
            note_octets(message, octets, self._definition)
        try:
            if writer and self._delivery is not None:
                self._writers.add(writer)
                self._delivery(message, writer.hex())
            else:
                self._deliver(message)
        finally:
            forget_octets()


class SerialisedRelay(NativeLink):
    """Passes serialised bytes from one topic to another of the same type."""

    def __init__(self, source: TopicContext, sink: TopicContext) -> None:
        super().__init__(source.endpoint, sink.endpoint)

        def of_link(end: TopicContext) -> TopicContext:
            """Return the context of a half, which is ours alone: the link is what reports."""
            return evolve(end, report=lambda _, *event: end.report(self, *event))

        self._out = PublisherSink(of_link(sink), bytes)
        with on_failure(self._out.close):
            self._into = SubscriptionSource(of_link(source), bytes, self._out.send)

    def wait(self) -> None:
        """Wait for the peers of both halves, for readers first so that no first message is lost.

        Raises:
            BridgeError: one is missing although it is required.
        """
        self._out.wait()
        self._into.wait()

    def tick(self) -> None:
        """Look after both halves."""
        self._into.tick()
        self._out.tick()

    def facts(self) -> Mapping[str, object]:
        """Return the facts of both halves, by side."""
        halves = (("from", self._into), ("to", self._out))
        return {
            f"{side} {name}": fact for side, half in halves for name, fact in half.facts().items()
        }

    def _close(self) -> None:
        self._into.close()
        self._out.close()


class _WatchedEnd:
    """What has a topic in common with others that ROS 2 connects by itself."""

    def __init__(
        self,
        link: NativeLink,
        context: TopicContext,
        peers: Callable[[str], tuple[Peer, ...]],
        peer_word: str,
    ) -> None:
        self._context, self._peers = context, peers
        self._missing = f"it has no {peer_word}"
        self._health = monitored(f"topic {context.topic.name}", link, context.report)
        self._health.connected()
        self._entry = context.entry()

    def tick(self) -> None:
        """Look at the graph, and at what the end says of itself."""
        context = self._context
        if context.options.peer_required and not self._peers(context.topic.name):
            self._health.connected(0, self._missing)
        else:
            self._health.connected()
        if self._entry is not None:
            judge_by_entry(self._health, self._entry)

    def close(self) -> None:
        if self._entry is not None:
            self._entry.close()


class SameTopicLink(NativeLink):
    """Two endpoints on one topic, which ROS 2 connects by itself: only watched.

    An end is lost when no publisher, or no subscription, is left.
    """

    def __init__(self, source: TopicContext, sink: TopicContext) -> None:
        super().__init__(source.endpoint, sink.endpoint)
        self._source = source
        runner = source.runner
        begin = _WatchedEnd(self, source, runner.publishers, "publisher")
        with on_failure(begin.close):
            end = _WatchedEnd(self, sink, runner.subscriptions, "subscription")
        self._ends = begin, end

    def tick(self) -> None:
        """Look after both ends."""
        for end in self._ends:
            end.tick()

    def facts(self) -> Mapping[str, object]:
        """Return how many publishers and subscriptions the topic has; nothing after the end."""
        runner, name = self._source.runner, self._source.topic.name
        with suppress(BridgeError):  # the bridge was closed
            return {
                "publishers": len(runner.publishers(name)),
                "subscriptions": len(runner.subscriptions(name)),
            }
        return {}

    def _close(self) -> None:
        for end in self._ends:
            end.close()
