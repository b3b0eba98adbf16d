"""Sources and sinks on topics."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from uoarm.bridge import Channel, Delivery, Sink, Source
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Endpoint, Health, Message
from uoarm_mqtt._codec import CONTENT_TYPES, Codec
from uoarm_mqtt._link import BrokerConnection, Outcome
from uoarm_mqtt._options import Port
from uoarm_mqtt._subscriptions import Incoming, Receiver

__all__ = ["Backlog", "TopicSink", "TopicSource", "content_type"]

Report = Callable[[Channel, Health, str], None]


class Backlog:
    """What came and was not taken yet, and the one thread that takes it.

    The thread of the network only appends, so that a receiver that is stuck holds up nobody else.
    When it is full, the oldest are dropped and counted. The thread ends when it is closed, or with
    the `take` under way.
    """

    def __init__(self, name: str, take: Callable[[Incoming], None], most: int, octets: int) -> None:
        self._take = take
        self._most, self._most_octets = most, octets
        self._waiting: deque[Incoming] = deque()
        self._octets = 0
        self._changed = threading.Condition()
        self._closed = False
        self.dropped = 0
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, message: Incoming) -> None:
        """Append a message; returns at once."""
        with self._changed:
            if self._closed:
                return
            self._waiting.append(message)
            self._octets += len(message.payload)
            # The newest is always kept, however large: no payload is larger than the budget.
            while len(self._waiting) > 1 and (
                len(self._waiting) > self._most or self._octets > self._most_octets
            ):
                self._octets -= len(self._waiting.popleft().payload)
                self.dropped += 1
            self._changed.notify()

    def close(self) -> None:
        """Take nothing more; does not wait for what is being taken."""
        with self._changed:
            self._closed = True
            self._waiting.clear()
            self._changed.notify()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._waiting)
                if self._closed:
                    return
                message = self._waiting.popleft()
                self._octets -= len(message.payload)
            self._take(message)


class TopicSource(Source):
    """What is published on a topic, or on all that a filter matches.

    Where its last messages stand, the last one of each topic does. An empty payload clears what is
    retained on its topic: nothing stands of it any more.

    Args:
        endpoint: where it is open.
        topic: or a filter.
        port: options.
        codec: reads what comes.
        link: to the broker.
        deliver: takes the messages.
        report: takes how the source is.
        latched: whether the last messages stand; None: where the broker retains them.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        topic: str,
        port: Port,
        codec: Codec,
        link: BrokerConnection,
        deliver: Delivery,
        report: Report,
        *,
        latched: bool | None = None,
    ) -> None:
        super().__init__(endpoint, latched=port.retain if latched is None else latched)
        self._port, self._codec, self._link = port, codec, link
        self._deliver = deliver
        self._breaks = link.breaks
        self._received = self._cleared = 0
        budget = codec.budget
        most, octets = link.settings.backlog, 8 * budget.octets
        self._backlog = Backlog(f"uoarm-mqtt-{topic}", self._take, most, octets)
        self._receiver = Receiver(
            f"$share/{port.share}/{topic}" if port.share else topic,
            self._backlog.put,
            port.qos,
            port.retain,
            lambda cause: report(self, Health.LOST, cause),
        )
        try:
            link.subscribe(self._receiver)
        except BaseException:
            self._backlog.close()
            raise

    def facts(self) -> Mapping[str, object]:
        """Return counters; `interruptions` says how often the broker was away."""
        return {
            "received": self._received,
            "cleared": self._cleared,
            "under_way": len(self._backlog),
            "lost_on_link": self._backlog.dropped,
            "interruptions": self._link.breaks - self._breaks,
        }

    def _close(self) -> None:
        self._link.unsubscribe(self._receiver)
        self._backlog.close()

    def _take(self, incoming: Incoming) -> None:
        self._received += 1
        is_cleared = not incoming.payload
        self._cleared += is_cleared
        if is_cleared and self._codec.content == "json":
            self._deliver.let_go(incoming.topic)
            return
        try:
            message = self._codec.decode(incoming.payload, content_type(incoming))
        except MessageError as error:
            self._deliver.unreadable(f"{incoming.topic}: {error}")
            return
        if self._port.with_topic:
            message = {"topic": incoming.topic, "message": message}
        self._deliver(message, incoming.topic if self.latched else "")
        if is_cleared:  # an empty text, or no octets: it may be meant, but nothing stands
            self._deliver.let_go(incoming.topic)


class TopicSink(Sink):
    """Publishes on a topic; refuses what would wait, so that sending returns at once."""

    blocking = False

    def __init__(
        self,
        endpoint: Endpoint,
        topic: str,
        port: Port,
        codec: Codec,
        link: BrokerConnection,
        report: Report,
    ) -> None:
        super().__init__(endpoint)
        self._port, self._codec, self._link, self._report = port, codec, link, report
        self._topic = topic
        self._changed = threading.Condition()
        self._under_way = self._lost = self._refused = self._unheard = 0
        self._is_degraded = False
        link.require_up()

    def facts(self) -> Mapping[str, object]:
        """Return counters: `unheard` were taken by the broker while nobody was subscribed."""
        return {
            "under_way": self._under_way,
            "lost_on_link": self._lost,
            "refused": self._refused,
            "unheard": self._unheard,
        }

    def drain(self, timeout: float) -> bool:
        """Wait until the broker has taken what was sent."""
        with self._changed:
            if not self._changed.wait_for(lambda: not self._under_way, timeout):
                return False
        self._link.barrier()  # what has QoS 0 is only written to the socket by now
        return True

    def _send(self, message: Message) -> None:
        payload = self._codec.encode(message)
        if self._port.retain and not payload:
            text = "an empty payload would delete the retained message instead of replacing it"
            raise MessageError(text)
        with self._changed:
            if self._under_way >= self._link.settings.backlog:
                text = f"{self.endpoint}: {self._under_way} messages wait for the broker (backlog)"
                raise BridgeError(text, FailureReason.UNAVAILABLE)
            self._under_way += 1
        more: dict[str, Any] = {"ContentType": CONTENT_TYPES[self._codec.content]}
        if self._port.expiry:
            more["MessageExpiryInterval"] = self._port.expiry
        try:
            port = self._port
            self._link.publish(
                self._topic, payload, self._done, qos=port.qos, retain=port.retain, more=more
            )
        except BaseException:
            with self._changed:
                self._under_way -= 1
            raise

    def _close(self) -> None:
        """Nothing is held: what is under way goes its way."""

    def _done(self, outcome: Outcome) -> None:
        with self._changed:
            self._under_way -= 1
            self._unheard += outcome.nobody
            self._lost += bool(outcome.failure) and not outcome.is_answer
            is_refused = bool(outcome.failure) and outcome.is_answer
            self._refused += is_refused
            is_news = outcome.is_answer and is_refused is not self._is_degraded
            if outcome.is_answer:
                self._is_degraded = is_refused
            self._changed.notify_all()
        if is_news:
            health = Health.DEGRADED if is_refused else Health.OK
            self._report(self, health, outcome.failure or "the broker takes messages again")


def content_type(incoming: Incoming) -> str:
    """Return the content type that a message says to have, "" where it says nothing."""
    return str(getattr(incoming.properties, "ContentType", ""))
