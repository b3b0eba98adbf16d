"""Publishers: messages go to a topic that a component subscribes to."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from uoarm.bridge import Sink
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Message, OverflowPolicy, QueuePolicy
from uoarm_ros2._end import End, Place
from uoarm_ros2._middleware import Peer
from uoarm_ros2._pulse import Pulse
from uoarm_ros2._qos import KEEP_ALL_SECONDS, Policies, clashes, for_writing

__all__ = ["TopicSink"]

_FULL = "cannot publish data"
_LOSSLESS = QueuePolicy(policy=OverflowPolicy.BLOCK, timeout=KEEP_ALL_SECONDS)


class _Publisher(End):
    """The writing end of a topic."""

    peer_word = "subscription"

    def peers_on(self, topic: str) -> tuple[Peer, ...]:
        return self._place.station.subscriptions(topic)

    def count(self) -> int:
        return int(self.native.get_subscription_count())

    def clashes_with(self, peer: Policies) -> tuple[str, ...]:
        return clashes(self.policies, peer)

    def told(self, peer: Peer) -> str:
        return (
            f"subscription {peer.node} asks ({peer.policies}), "
            f"this publisher offers ({self.policies})"
        )

    def all_matched(self) -> bool:
        """Whether every subscription on the graph that fits is matched, and one at least."""
        fitting = [peer for peer in self.peers() if not self.clashes_with(peer.policies)]
        return self.count() >= max(1, len(fitting))

    def _fitting(self, peers: Iterable[Peer]) -> Policies:
        return for_writing(self._place.settings.qos, [peer.policies for peer in peers])

    def _create(self) -> Any:
        place = self._place
        return place.station.advertise(
            place.native, place.topic.name, self.policies, events=self.events()
        )


class TopicSink(Sink):
    """One publisher.

    With `auto` policies it offers what the subscriptions ask, and offers anew when all that are
    left ask for something else. `send` blocks only with `history: keep_all`, while slow readers
    catch up.

    A publisher takes messages from several threads at once: so ROS 2 promises of `rmw_publish`, and
    rclpy keeps one that is being destroyed until no call uses it.

    Args:
        place: where to publish.
        write: makes what is published (a native object or serialised bytes) of a message.
    """

    parallel = True

    def __init__(self, place: Place, write: Callable[[Message], Any]) -> None:
        super().__init__(place.endpoint)
        self._counting = threading.Lock()
        self._place = place
        self._write = write
        self.pulse = Pulse(lambda health, cause: place.report(self, health, cause))
        self._end = _Publisher(place, self.pulse)
        self.blocking = self._end.policies.history == "keep_all"
        self.default_queue = _LOSSLESS

    def _send(self, message: Message) -> None:
        """Publish one message.

        Raises:
            MessageError: it does not fit the native type; the text names the field.
            BridgeError: the channel was closed while it sends, or the middleware took nothing.
        """
        native = self._write(message)
        publisher = self._end.native
        try:
            self._publish(publisher, native)
        except Exception as error:  # noqa: BLE001 - raised again there, unless it can be helped
            self._publish_anyway(native, publisher, error)
        with self._counting:  # the stop message is sent beside a command
            self.pulse.count += 1

    def wait(self) -> None:
        """Wait until every fitting subscription on the graph is matched.

        Raises:
            BridgeError: none was matched within the limit although one is required.
        """
        place, end = self._place, self._end
        expects_peers = place.settings.peer_required or bool(end.peers())
        limit = place.graph.limit(place.settings) if expects_peers else 0.0
        place.graph.until(lambda: self.closed or end.all_matched() or end.cannot_match(), limit)
        peers = end.peers()
        end.require(limit, peers)
        if end.count() and any(peer.policies.reliability == "best_effort" for peer in peers):
            # A reader that does not ask for repeats must have matched us before the first message.
            place.graph.settle(peers, place.settle, lambda: self.closed)

    def tick(self) -> None:
        """Look after the channel a few times a second, in the station's thread."""
        self._end.tick()

    def drain(self, timeout: float) -> bool:
        """Wait until every reliable subscription has acknowledged what was published.

        One that is matched may not have matched this publisher yet, since discovery goes both ways
        on its own, and then gets what was sent only as long as the publisher is there. Fast DDS
        asks for acknowledgements every three seconds.
        """
        place, end = self._place, self._end
        return place.graph.until(lambda: place.station.is_acknowledged(end.native), timeout)

    def facts(self) -> Mapping[str, object]:
        """Return counters, the matched subscriptions and the policies in force."""
        return self._end.facts()

    def _publish(self, publisher: Any, native: Any) -> None:
        """Publish; what waits for room in a full history must not keep the interpreter's lock."""
        if self.blocking:
            self._place.station.publish_released(publisher, native)
        else:
            publisher.publish(native)

    def _publish_anyway(self, native: Any, publisher: Any, error: Exception) -> None:
        """Publish with the publisher that took the place of one, or once the history has room.

        The rmw itself waits for room a tenth of a second only.
        """
        deadline = time.monotonic() + KEEP_ALL_SECONDS
        while True:
            if self._closed:
                raise self._gone() from error
            if self._place.station.is_cut_off:
                self._publish_last(native, publisher)
                return
            waits = self.blocking and _FULL in str(error) and time.monotonic() < deadline
            if publisher is self._end.native and not waits:
                text = f"topic {self._place.topic.name} takes no message: {error}"
                raise BridgeError(text, FailureReason.UNAVAILABLE) from error
            publisher = self._end.native
            try:
                self._publish(publisher, native)
            except Exception as another:  # noqa: BLE001 - looked at in the next round
                error = another
            else:
                return

    def _publish_last(self, native: Any, publisher: Any) -> None:
        try:
            self._place.station.publish_released(publisher, native)
        except OSError as error:
            text = f"topic {self._place.topic.name} takes no message: {error}"
            raise BridgeError(text, FailureReason.UNAVAILABLE) from error

    def _gone(self) -> BridgeError:
        text = f"bridge {self.endpoint.bridge!r}: {self.endpoint} is closed"
        return BridgeError(text, FailureReason.CLOSED)

    def _close(self) -> None:
        self._end.close()
