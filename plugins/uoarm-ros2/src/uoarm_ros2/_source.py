"""Subscriptions: a topic of a component becomes a source of messages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from attrs import frozen

from uoarm.bridge import Channel
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Endpoint, Health
from uoarm_ros2._graph import Graph, Topic
from uoarm_ros2._middleware import Peer, Station
from uoarm_ros2._pulse import Pulse
from uoarm_ros2._qos import Policies, clashes, for_reading
from uoarm_ros2._settings import Settings

__all__ = ["Place", "Source"]

_ANSWER_TICKS = 5
_DRAIN_SECONDS = 0.05


@frozen
class Place:
    """Everything that one topic channel stands on."""

    station: Station
    graph: Graph
    endpoint: Endpoint
    topic: Topic
    native: type
    settings: Settings
    settle: float
    report: Callable[[Channel, Health, str], None]


class Source(Channel):
    """One subscription; each message goes to `take` in the station's thread.

    With `auto` policies it asks for what the publishers offer, and asks anew when all that are
    left offer something else.

    Args:
        place: where to subscribe.
        take: takes the native object, or its serialised bytes when `raw`.
        raw: leave messages serialised.
    """

    def __init__(self, place: Place, take: Callable[[Any], None], *, raw: bool = False) -> None:
        super().__init__(place.endpoint)
        self._place = place
        self._take = take
        self._raw = raw
        self._busy = False
        self.pulse = Pulse(
            lambda health, cause: place.report(self, health, cause), place.settings.stale_after
        )
        self._unanswered = 0
        self._policies = for_reading(place.settings.qos, self._offers())
        self._subscription = self._subscribe()

    def wait(self) -> None:
        """Wait until a publisher is matched and has had the time to learn of us.

        Raises:
            BridgeError: none was matched within the limit although one is required.
        """
        place = self._place
        limit = place.graph.limit(place.settings)
        if not place.graph.until(self._matched, limit):
            if place.settings.peer_required:
                raise BridgeError(self._why_unmatched(limit), FailureReason.UNAVAILABLE)
            return
        if self._policies.durability != "transient_local":
            place.graph.settle(self._peers(), place.settle, lambda: self.closed)

    def tick(self) -> None:
        """Look after the channel a few times a second, in the station's thread."""
        self.pulse.tick()
        if self._unanswered and not self._closed:
            self._unanswered -= 1
            self._answer_clash()

    def facts(self) -> Mapping[str, object]:
        """Return counters, the matched publishers and the policies in force."""
        return {**self.pulse.facts(), "qos": str(self._policies)}

    def _close(self) -> None:
        self._place.station.discard(self._subscription)
        # A delivery that has just begun ends first, unless it lasts: it may have asked for this.
        self._place.graph.until(lambda: not self._busy, _DRAIN_SECONDS)

    def _receive(self, native: Any) -> None:
        if self._closed:
            return
        self._busy = True
        try:
            self.pulse.beat()
            self._take(native)
        finally:
            self._busy = False

    def _subscribe(self) -> Any:
        place, pulse = self._place, self.pulse
        where = f"topic {place.topic.name}"
        required = place.settings.peer_required
        return place.station.subscribe(
            place.native,
            place.topic.name,
            self._policies,
            self._receive,
            raw=self._raw,
            events={
                "matched": lambda info: pulse.peers(
                    info.current_count, f"publisher of {place.topic.name}", required=required
                ),
                "incompatible_qos": self._clash,
                "message_lost": lambda info: pulse.missed(info.total_count, where),
                **(
                    {"deadline": lambda info: pulse.deadline(info.total_count, where)}
                    if self._policies.deadline is not None
                    else {}
                ),
            },
        )

    def _matched(self) -> bool:
        return self._closed or self._subscription.get_publisher_count() > 0

    def _peers(self) -> list[Peer]:
        place = self._place
        known = place.station.publishers(place.topic.name)
        return [peer for peer in known if peer.type == place.topic.type]

    def _offers(self) -> list[Policies]:
        return [peer.policies for peer in self._peers()]

    def _clash(self, info: Any) -> None:
        """Take note of a publisher that does not fit; in the station's thread, as messages are."""
        self.pulse.incompatible = info.total_count
        self._unanswered = _ANSWER_TICKS
        self._answer_clash()

    def _answer_clash(self) -> None:
        """Adapt while nobody is matched who would lose by it, else say what clashes."""
        alone = self._subscription.get_publisher_count() == 0
        fitting = for_reading(self._place.settings.qos, self._offers())
        if alone and fitting != self._policies and not self._closed:
            before, self._policies = self._subscription, fitting
            self._subscription = self._subscribe()
            self._place.station.discard(before)
            self._unanswered = 0
            return
        text = self._clashes()
        if self._unanswered and (not text or "UNKNOWN" in text):
            return  # the graph learns of a peer, then of its node, a moment after the event
        self._unanswered = 0
        if text:
            lost = alone and self._place.settings.peer_required
            self.pulse.tell(Health.LOST if lost else Health.DEGRADED, text)

    def _clashes(self) -> str:
        sentences = []
        for peer in self._peers():
            found = clashes(peer.policies, self._policies)
            if found:
                sentences.append(
                    f"publisher {peer.node} offers ({peer.policies}), this subscription asks "
                    f"({self._policies}): they clash on {'; '.join(found)}"
                )
        if not sentences:
            return ""
        return f"incompatible QoS on topic {self._place.topic.name}: {' / '.join(sentences)}"

    def _why_unmatched(self, limit: float) -> str:
        name = self._place.topic.name
        return self._clashes() or f"no publisher of {name} was matched within {limit:g} s"
