"""Subscriptions: a topic of a component becomes a source of messages."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from uoarm.bridge import Delivery, Source
from uoarm.errors import MessageError
from uoarm.model import Deliver, Message
from uoarm_ros2._end import End, Place
from uoarm_ros2._middleware import Peer
from uoarm_ros2._pulse import Pulse
from uoarm_ros2._qos import KEEP_ALL_SECONDS, Policies, clashes, for_reading

__all__ = ["TopicSource"]

_LOOKS = 10  # ticks within which the graph knows that a publisher has gone


class _Subscription(End):
    """The reading end of a topic."""

    peer_word = "publisher"

    def __init__(self, place: Place, pulse: Pulse, take: Callable[..., None]) -> None:
        self._take = take
        super().__init__(place, pulse)

    def peers_on(self, topic: str) -> tuple[Peer, ...]:
        return self._place.station.publishers(topic)

    def count(self) -> int:
        return int(self.native.get_publisher_count())

    def clashes_with(self, peer: Policies) -> tuple[str, ...]:
        return clashes(peer, self.policies)

    def told(self, peer: Peer) -> str:
        return (
            f"publisher {peer.node} offers ({peer.policies}), "
            f"this subscription asks ({self.policies})"
        )

    def shadowed(self, peers: Sequence[Peer]) -> str:
        """Return whose latched messages of the past do not come since others latch none."""
        place = self._place
        latched = [peer for peer in peers if peer.policies.durability == "transient_local"]
        if not latched or self.policies.durability == "transient_local":
            return ""
        if place.settings.qos.durability != "auto":
            return ""
        volatile = [peer.node for peer in peers if peer not in latched]
        return (
            f"topic {place.topic.name}: {', '.join(peer.node for peer in latched)} latched what "
            f"they published, which does not come since {', '.join(volatile)} latch nothing; with "
            "qos: {durability: transient_local} it comes, and nothing of those that latch nothing"
        )

    def _fitting(self, peers: Iterable[Peer]) -> Policies:
        return for_reading(self._place.settings.qos, [peer.policies for peer in peers])

    def _create(self) -> Any:
        place, pulse = self._place, self._pulse
        where = f"topic {place.topic.name}"
        events = self.events()
        required = place.settings.peer_required
        events["liveliness"] = lambda info: pulse.liveliness(
            info.alive_count, info.not_alive_count, where, required=required
        )
        events["message_lost"] = lambda info: pulse.missed(info.total_count, where)
        return place.station.subscribe(
            place.native,
            place.topic.name,
            self.policies,
            self._take,
            events=events,
            names_writers=self.policies.durability == "transient_local",
        )


class TopicSource(Source):
    """One subscription; each message goes to `deliver` in the station's thread.

    With `auto` policies it asks for what the publishers offer, and asks anew when all that are
    left offer something else.

    What was latched stands as for a subscription of its own: the last messages of each publisher,
    as long as the publisher is there.

    Args:
        place: where to subscribe.
        read: makes what is delivered of the serialised form; raises MessageError.
        deliver: takes it.
    """

    def __init__(self, place: Place, read: Callable[[bytes], Message], deliver: Deliver) -> None:
        super().__init__(place.endpoint)
        self._place = place
        self._read = read
        self._deliver = deliver
        self._delivery = deliver if isinstance(deliver, Delivery) else None
        self.pulse = Pulse(
            lambda health, cause: place.report(self, health, cause),
            place.settings.stale_after,
            place.clock,
            hears=True,
        )
        self._writers: set[bytes] = set()  # whose messages stand; in the station's thread
        self._departures = self._looks = 0
        self._end = _Subscription(place, self.pulse, self._receive)

    def wait(self) -> None:
        """Wait until a publisher is matched and has had the time to learn of us.

        Raises:
            BridgeError: none was matched within the limit although one is required.
        """
        place = self._place
        limit = place.graph.limit(place.settings)
        end = self._end
        place.graph.until(lambda: self.closed or end.count() > 0 or end.cannot_match(), limit)
        matched = end.count() > 0
        peers = end.peers()
        end.require(limit, peers)
        self.latched = end.policies.durability == "transient_local"
        self.depth = end.policies.depth
        if end.policies.history == "keep_all":
            self.patience = KEEP_ALL_SECONDS
        if matched and not self.latched:
            place.graph.settle(peers, place.settle, lambda: self.closed)

    def tick(self) -> None:
        """Look after the channel a few times a second, in the station's thread."""
        self._end.tick()
        self._look_for_departures()

    def facts(self) -> Mapping[str, object]:
        """Return counters, the matched publishers and the policies in force."""
        return self._end.facts()

    def _close(self) -> None:
        self._end.close()

    def _look_for_departures(self) -> None:
        """Let what publishers latched that have gone stand no more, as DDS does."""
        if not self._writers or self._delivery is None:
            return
        if self._end.departures != self._departures:
            self._departures, self._looks = self._end.departures, _LOOKS
        if not self._looks and len(self._writers) <= self._end.count():
            return
        self._looks = max(0, self._looks - 1)
        there = {peer.identity for peer in self._end.peers()}
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
                self._delivery.unreadable(f"topic {self._place.topic.name}: {error}")
            return
        self.pulse.beat()
        if writer and self._delivery is not None:
            self._writers.add(writer)
            self._delivery(message, writer.hex())
        else:
            self._deliver(message)
