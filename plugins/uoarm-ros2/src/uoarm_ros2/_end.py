"""One end of a topic: a publisher or subscription whose policies are kept fitting its peers."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from attrs import frozen

from uoarm.bridge import Channel
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Endpoint, Health
from uoarm_ros2._graph import Graph, Topic
from uoarm_ros2._middleware import Peer, Station
from uoarm_ros2._pulse import Pulse
from uoarm_ros2._qos import Policies
from uoarm_ros2._settings import Settings

__all__ = ["End", "Place"]

_ANSWER_TICKS = 5
_NAME_SECONDS = 0.5
_CLASH_SECONDS = 0.5  # as long as it may take to hear of another peer that has just started
_UNNAMED = "NAME_UNKNOWN"  # what the graph says of an end whose node it has not heard of yet
Events = dict[str, Callable[[Any], None]]


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
    clock: Callable[[], float] = time.monotonic


class End(ABC):
    """A native endpoint, made anew with other policies when all peers that are left ask for such.

    Must implement: the steps below that differ between reading and writing. Everything but
    `close` happens in the opening thread, then in the station's.

    Args:
        place: where it is.
        pulse: told of peers and clashes.

    Attributes:
        policies: in force.
        native: rclpy's end.
        departures: how often peers have gone.
    """

    peer_word: str

    def __init__(self, place: Place, pulse: Pulse) -> None:
        self._place = place
        self._pulse = pulse
        self._unanswered = 0
        self._clashes_since = math.inf
        self._clashing = False
        self._unlooked = False
        self._strange = False
        self._shared = False
        self._shadowed = ""
        self._closed = False
        self.departures = 0
        self.policies = self._fitting(self.peers())
        self.native = self._create()

    @abstractmethod
    def peers_on(self, topic: str) -> tuple[Peer, ...]:
        """Return what is on the other side of a topic, of any type."""

    @abstractmethod
    def count(self) -> int:
        """Return how many peers are matched now."""

    @abstractmethod
    def clashes_with(self, peer: Policies) -> tuple[str, ...]:
        """Return the policies on which this end and a peer cannot meet, in words."""

    @abstractmethod
    def told(self, peer: Peer) -> str:
        """Return the sentence that sets the policies of both sides side by side."""

    @abstractmethod
    def _fitting(self, peers: Iterable[Peer]) -> Policies:
        """Return the policies that the settings and the peers of our type call for."""

    @abstractmethod
    def _create(self) -> Any:
        """Create the native endpoint with the policies of now."""

    def peers(self) -> list[Peer]:
        """Return the peers of our type that are on the graph, matched or not."""
        topic = self._place.topic
        return [peer for peer in self.peers_on(topic.name) if peer.type == topic.type]

    def cannot_match(self) -> bool:
        """Whether whoever is on the graph has clashed for so long that waiting will not help."""
        peers = self.peers()
        if not peers or not all(self.clashes_with(peer.policies) for peer in peers):
            self._clashes_since = math.inf
            return False
        now = time.monotonic()
        self._clashes_since = min(self._clashes_since, now)
        return now - self._clashes_since > _CLASH_SECONDS

    def require(self, limit: float, peers: Sequence[Peer]) -> None:
        """Raise BridgeError when a peer must be there and none is matched or speaks our language.

        The text says what is in the way.

        Args:
            limit: for how many seconds one was waited for.
            peers: those of our type that are on the graph now.
        """
        if not self._place.settings.peer_required:
            return
        name = self._place.topic.name
        if self.count() == 0:
            text = f"no {self.peer_word} of {name} was matched within {limit:g} s"
            raise BridgeError(self._clashes() or text, FailureReason.UNAVAILABLE)
        if self._are_strangers(peers):
            self._place.graph.until(lambda: _UNNAMED not in self._strangeness(), _NAME_SECONDS)
            raise BridgeError(self._strangeness(), FailureReason.UNAVAILABLE)

    def tick(self) -> None:
        """Look after the end a few times a second, in the station's thread."""
        self._pulse.tick()
        if self._closed:
            return
        if self._unanswered:
            self._unanswered -= 1
            self._answer_clash()
        elif self._clashing:
            self._look_for_peace()
        if self._unlooked:
            self._unlooked = False
            peers = self.peers()
            self._look_for_strangers(peers)
            self._pulse.promise(peer.policies.deadline for peer in peers)
            self._look_for_shadows(peers)
        if self._place.graph.has_other_types(self._place.topic) is not self._shared:
            self._look_for_other_types()

    def facts(self) -> Mapping[str, object]:
        """Return counters, the matched peers and the policies in force."""
        return {**self._pulse.facts(), "qos": str(self.policies)}

    def close(self) -> None:
        """Put the native endpoint away."""
        self._closed = True
        self._place.station.discard(self.native)

    def events(self) -> Events:
        """Return the callbacks that both kinds of end have."""
        where, pulse = f"topic {self._place.topic.name}", self._pulse
        common: Events = {
            "matched": lambda info: self._matched(info.current_count, info.current_count_change),
            "incompatible_qos": lambda info: self._clash(info.total_count),
        }
        if self.policies.deadline is not None:
            common["deadline"] = lambda info: pulse.deadline(info.total_count, where)
        return common

    def _matched(self, current: int, change: int) -> None:
        self._unlooked = True
        self.departures += change < 0
        if not current:
            self._unanswered = _ANSWER_TICKS  # those that are left may be the ones that clash
        place = self._place
        self._pulse.peers(
            current,
            f"{self.peer_word} of {place.topic.name}",
            required=place.settings.peer_required,
            offered=place.endpoint.is_offered,
        )

    def _own_definition(self) -> str:
        place = self._place
        return place.station.own_definition(place.topic.name, place.topic.type, place.native)

    def _strangers(self, peers: Iterable[Peer]) -> list[Peer]:
        """Return those whose type has our name and another definition: DDS matches by name."""
        own = self._own_definition()
        return [peer for peer in peers if own and peer.definition not in {"", own}]

    def _are_strangers(self, peers: Sequence[Peer]) -> bool:
        return 0 < len(self._strangers(peers)) == len(peers)

    def _strangeness(self) -> str:
        topic = self._place.topic
        strangers = self._strangers(self.peers())
        theirs = "; ".join(f"{peer.node} has {peer.definition}" for peer in strangers)
        return (
            f"topic {topic.name}: {topic.type} is defined otherwise there than here: {theirs}, "
            f"this process has {self._own_definition()}"
        )

    def _look_for_strangers(self, peers: Sequence[Peer]) -> None:
        before, self._strange = self._strange, bool(self._strangers(peers))
        if self._strange:
            text = self._strangeness()
            lost = self._are_strangers(peers) and self._place.settings.peer_required
            self._pulse.tell(Health.LOST if lost else Health.DEGRADED, text)
            self._unlooked = _UNNAMED in text  # the graph learns of an end, then of its node
        elif before and self.count():
            self._pulse.tell(Health.OK, "every peer has our definition of the type")

    def shadowed(self, peers: Sequence[Peer]) -> str:
        """Return what of the peers is not reached although all fit, in words; mostly nothing."""
        del peers
        return ""

    def _look_for_shadows(self, peers: Sequence[Peer]) -> None:
        before, self._shadowed = self._shadowed, self.shadowed(peers)
        if _UNNAMED in self._shadowed:
            self._shadowed, self._unlooked = before, True
        elif self._shadowed and self._shadowed != before:
            self._pulse.tell(Health.DEGRADED, self._shadowed)
        elif before and not self._shadowed and self.count():
            self._pulse.tell(Health.OK, "all that the peers offer is reached")

    def _look_for_other_types(self) -> None:
        """Tell of a node that talks another type on our topic: ROS 2 itself is silent about it."""
        topic = self._place.topic
        others = self._place.graph.other_types(topic)
        if _UNNAMED in others:
            return  # its node is heard of a moment later
        self._shared = bool(others)
        if others:
            text = f"topic {topic.name} carries other types than {topic.type} too: {others}"
            self._pulse.tell(Health.DEGRADED, text)
        elif self.count():
            self._pulse.tell(Health.OK, f"topic {topic.name} carries {topic.type} only")

    def _clash(self, total: int) -> None:
        """Take note of a peer that does not fit; in the station's thread, as messages are."""
        self._pulse.incompatible = total
        self._unanswered = _ANSWER_TICKS
        self._answer_clash()

    def _answer_clash(self) -> None:
        """Adapt while nobody is matched who would lose by it, else say what clashes."""
        alone = self.count() == 0
        peers = self.peers()
        fitting = self._fitting(peers)
        if alone and peers and fitting != self.policies and not self._closed:
            before, self.policies = self.native, fitting
            self.native = self._create()
            self._place.station.discard(before)
            self._unanswered = 0
            return
        text = self._clashes()
        if self._unanswered and (not text or _UNNAMED in text):
            return  # the graph learns of a peer, then of its node, a moment after the event
        self._unanswered = 0
        if text:
            self._clashing = True
            lost = alone and self._place.settings.peer_required
            self._pulse.tell(Health.LOST if lost else Health.DEGRADED, text)

    def _look_for_peace(self) -> None:
        """Tell when the last peer that did not fit is gone and others are there."""
        if self.count() and not self._clashes():
            self._clashing = False
            what = f"{self.peer_word} of {self._place.topic.name}"
            self._pulse.tell(Health.OK, f"every {what} fits")

    def _clashes(self) -> str:
        clashing = ((peer, self.clashes_with(peer.policies)) for peer in self.peers())
        sentences = [
            f"{self.told(peer)}: they clash on {'; '.join(found)}"
            for peer, found in clashing
            if found
        ]
        if not sentences:
            return ""
        return f"incompatible QoS on topic {self._place.topic.name}: {' / '.join(sentences)}"
