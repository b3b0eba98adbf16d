"""Publishers: messages go to a topic that a component subscribes to."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

from uoarm.bridge import Sink
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Health, Message
from uoarm_ros2._middleware import Peer
from uoarm_ros2._pulse import Pulse
from uoarm_ros2._qos import Policies, clashes, for_writing
from uoarm_ros2._source import Place

__all__ = ["TopicSink"]

_ANSWER_TICKS = 5
_BLOCK_SECONDS = 10.0
_FULL = "cannot publish data"


class TopicSink(Sink):
    """One publisher.

    With `auto` policies it offers what the subscriptions ask, and offers anew when all that are
    left ask for something else. `send` blocks only with `history: keep_all`, while slow readers
    catch up.

    Args:
        place: where to publish.
        write: makes what is published (a native object or serialised bytes) of a message.
    """

    def __init__(self, place: Place, write: Callable[[Message], Any]) -> None:
        super().__init__(place.endpoint)
        self._place = place
        self._write = write
        self.pulse = Pulse(lambda health, cause: place.report(self, health, cause))
        self._unanswered = 0
        self._policies = for_writing(place.settings.qos, self._requests())
        self.blocking = self._policies.history == "keep_all"
        self._publisher = self._advertise()

    def send(self, message: Message) -> None:
        """Publish one message.

        Raises:
            MessageError: it does not fit the native type; the text names the field.
            BridgeError: the channel is closed.
        """
        if self._closed:
            text = f"bridge {self.endpoint.bridge!r}: {self.endpoint} is closed"
            raise BridgeError(text, FailureReason.CLOSED)
        native = self._write(message)
        if self.blocking:
            self._publish_patiently(native)
        else:
            self._publisher.publish(native)
        self.pulse.count += 1

    def wait(self) -> None:
        """Wait until every fitting subscription on the graph is matched.

        Raises:
            BridgeError: none was matched within the limit although one is required.
        """
        place = self._place
        limit = place.graph.limit(place.settings) if self._expects_peers() else 0.0
        place.graph.until(self._matched, limit)
        if self._publisher.get_subscription_count() == 0:
            if place.settings.peer_required:
                raise BridgeError(self._why_unmatched(limit), FailureReason.UNAVAILABLE)
        elif any(asked.reliability == "best_effort" for asked in self._requests()):
            # A reader that does not ask for repeats must have matched us before the first message.
            place.graph.settle(self._peers(), place.settle, lambda: self.closed)

    def tick(self) -> None:
        """Look after the channel a few times a second, in the station's thread."""
        self.pulse.tick()
        if self._unanswered and not self._closed:
            self._unanswered -= 1
            self._answer_clash()

    def facts(self) -> Mapping[str, object]:
        """Return counters, the matched subscriptions and the policies in force."""
        return {**self.pulse.facts(), "qos": str(self._policies)}

    def _publish_patiently(self, native: Any) -> None:
        """Publish once the history has room; the rmw itself waits a tenth of a second only."""
        deadline = time.monotonic() + _BLOCK_SECONDS
        while not self._closed:
            try:
                self._publisher.publish(native)
            except Exception as error:
                if _FULL not in str(error) or time.monotonic() > deadline:
                    raise
            else:
                return

    def _close(self) -> None:
        self._place.station.discard(self._publisher)

    def _advertise(self) -> Any:
        place, pulse = self._place, self.pulse
        required = place.settings.peer_required
        return place.station.advertise(
            place.native,
            place.topic.name,
            self._policies,
            events={
                "matched": lambda info: pulse.peers(
                    info.current_count, f"subscription of {place.topic.name}", required=required
                ),
                "incompatible_qos": self._clash,
                **(
                    {
                        "deadline": lambda info: pulse.deadline(
                            info.total_count, f"topic {place.topic.name}"
                        )
                    }
                    if self._policies.deadline is not None
                    else {}
                ),
            },
        )

    def _expects_peers(self) -> bool:
        return self._place.settings.peer_required or bool(self._peers())

    def _matched(self) -> bool:
        fitting = [each for each in self._requests() if not clashes(self._policies, each)]
        return self._closed or self._publisher.get_subscription_count() >= max(1, len(fitting))

    def _peers(self) -> list[Peer]:
        place = self._place
        known = place.station.subscriptions(place.topic.name)
        return [peer for peer in known if peer.type == place.topic.type]

    def _requests(self) -> list[Policies]:
        return [peer.policies for peer in self._peers()]

    def _clash(self, info: Any) -> None:
        """Take note of a subscription that does not fit; in the station's thread."""
        self.pulse.incompatible = info.total_count
        self._unanswered = _ANSWER_TICKS
        self._answer_clash()

    def _answer_clash(self) -> None:
        """Adapt while nobody is matched who would lose by it, else say what clashes."""
        alone = self._publisher.get_subscription_count() == 0
        fitting = for_writing(self._place.settings.qos, self._requests())
        if alone and fitting != self._policies and not self._closed:
            before, self._policies = self._publisher, fitting
            self._publisher = self._advertise()
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
            found = clashes(self._policies, peer.policies)
            if found:
                sentences.append(
                    f"subscription {peer.node} asks ({peer.policies}), this publisher offers "
                    f"({self._policies}): they clash on {'; '.join(found)}"
                )
        if not sentences:
            return ""
        return f"incompatible QoS on topic {self._place.topic.name}: {' / '.join(sentences)}"

    def _why_unmatched(self, limit: float) -> str:
        name = self._place.topic.name
        return self._clashes() or f"no subscription of {name} was matched within {limit:g} s"
