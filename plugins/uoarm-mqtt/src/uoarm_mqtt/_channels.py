"""Channels on topics: sources, sinks, calls and served functions."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from attrs import define, field

from uoarm.bridge import (
    Channel,
    ChannelHealth,
    ChannelMonitor,
    Delivery,
    Handler,
    ReceiveQueue,
    ServiceStructures,
    Sink,
    Source,
    on_failure,
    text_of,
)
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, MessageError
from uoarm.model import Endpoint, Health, Message
from uoarm_mqtt._codec import CONTENT_TYPES, PayloadCodec
from uoarm_mqtt._link import BrokerConnection, PacketOutcome
from uoarm_mqtt._options import TopicOptions, sendable
from uoarm_mqtt._subscriptions import ReceivedMessage, Receiver

Report = Callable[[Channel, Health, str], None]


class _Subscription:
    """What comes on a topic, kept until it is taken in a thread of its own, as options say."""

    def __init__(
        self,
        link: BrokerConnection,
        topic: str,
        options: TopicOptions,
        take: Callable[[ReceivedMessage], None],
        report: Callable[[Health, str], object],
        *,
        is_service: bool = False,
    ) -> None:
        self._link, limits = link, link.options
        monitor = ChannelMonitor(ChannelHealth(topic, time.monotonic()), report)
        self.queue: ReceiveQueue[ReceivedMessage] = ReceiveQueue(
            f"uoarm-mqtt-{topic}",
            take,
            limits.backlog,
            most_size=limits.backlog_octets,
            size=lambda message: len(message.payload),
        )
        self._receiver = Receiver(
            f"$share/{options.share}/{topic}" if options.share else topic,
            self.queue.put,
            max(1, options.qos) if is_service else options.qos,
            options.retain and not is_service,
            lambda cause: monitor.refused(cause, final=True),
        )
        with on_failure(self.queue.close):
            link.subscribe(self._receiver)

    def close(self) -> None:
        self._link.unsubscribe(self._receiver)
        self.queue.close()


class MqttSource(Source):
    """What is published on a topic, or on all that a filter matches.

    Where its last messages stand, the last one of each topic does. An empty payload clears what is
    retained on its topic: nothing stands of it any more.

    Args:
        topic: or a filter.
        latched: whether the last messages stand; None: where the broker retains them.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        topic: str,
        options: TopicOptions,
        codec: PayloadCodec,
        link: BrokerConnection,
        deliver: Delivery,
        report: Report,
        *,
        latched: bool | None = None,
    ) -> None:
        super().__init__(endpoint, latched=options.retain if latched is None else latched)
        self._options, self._codec, self._link = options, codec, link
        self._deliver = deliver
        self._breaks = link.breaks
        self._received = self._cleared = 0
        self._subscription = _Subscription(link, topic, options, self._take, partial(report, self))

    def facts(self) -> Mapping[str, object]:
        """Return counters; `interruptions` says how often the broker was away."""
        return {
            "received": self._received,
            "cleared": self._cleared,
            "under_way": len(self._subscription.queue),
            "lost_on_link": self._subscription.queue.dropped,
            "interruptions": self._link.breaks - self._breaks,
        }

    def _close(self) -> None:
        self._subscription.close()

    def _take(self, incoming: ReceivedMessage) -> None:
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
        if self._options.with_topic:
            message = {"topic": incoming.topic, "message": message}
        self._deliver(message, incoming.topic if self.latched else "")
        if is_cleared:  # an empty text, or no octets: it may be meant, but nothing stands
            self._deliver.let_go(incoming.topic)


class MqttSink(Sink):
    """Publishes on a topic; refuses what would wait, so that sending returns at once."""

    blocking = False

    def __init__(
        self,
        endpoint: Endpoint,
        topic: str,
        options: TopicOptions,
        codec: PayloadCodec,
        link: BrokerConnection,
        report: Report,
    ) -> None:
        super().__init__(endpoint)
        self._options, self._codec, self._link = options, codec, link
        self._topic = topic
        # Guards the counters: any thread sends and drains, paho's reports how it ended. It is not
        # held while the link is called, which may report at once.
        self._changed = threading.Condition()
        self._under_way = self._size = self._lost = self._refused = self._undelivered = 0
        health = ChannelHealth(topic, time.monotonic())
        self._health = ChannelMonitor(health, partial(report, self))
        link.require_taken(options.qos, retain=options.retain)
        link.join(self._health)

    def facts(self) -> Mapping[str, object]:
        """Return counters; `undelivered`: taken by the broker while no client was subscribed."""
        return {
            "under_way": self._under_way,
            "lost_on_link": self._lost,
            "refused": self._refused,
            "undelivered": self._undelivered,
        }

    def drain(self, timeout: float) -> bool:
        """Wait until the broker has taken what was sent."""
        end = time.monotonic() + timeout
        with self._changed:
            if not self._changed.wait_for(lambda: not self._under_way, timeout):
                return False
        # What has QoS 0 is only written to the socket by now.
        return self._link.drain(max(0.0, end - time.monotonic()))

    def _send(self, message: Message) -> None:
        payload = self._codec.encode(message)
        if self._options.retain and not payload:
            text = "an empty payload would delete the retained message instead of replacing it"
            raise MessageError(text)
        options, size, limits = self._options, len(payload), self._link.options
        with self._changed:
            is_full = self._under_way and self._size + size > limits.backlog_octets
            if is_full or self._under_way >= limits.backlog:
                waiting = f"{self._under_way:,} messages of {self._size:,} octets"
                text = f"{self.endpoint}: {waiting} wait for the broker (backlog)"
                raise BridgeError(text, FailureReason.UNAVAILABLE)
            self._under_way += 1
            self._size += size
        more: dict[str, Any] = {"ContentType": CONTENT_TYPES[self._codec.content]}
        if options.expiry:
            more["MessageExpiryInterval"] = options.expiry
        done = partial(self._done, size)
        try:
            self._link.publish(
                self._topic, payload, done, qos=options.qos, retain=options.retain, more=more
            )
        except BaseException:
            with self._changed:
                self._under_way -= 1
                self._size -= size
            raise

    def _close(self) -> None:
        """Nothing is held: what is under way goes its way."""

    def _done(self, size: int, outcome: PacketOutcome) -> None:
        with self._changed:
            self._under_way -= 1
            self._size -= size
            self._undelivered += outcome.no_subscribers
            self._lost += bool(outcome.failure) and not outcome.is_answer
            is_refused = bool(outcome.failure) and outcome.is_answer
            self._refused += is_refused
            self._changed.notify_all()
        if is_refused:
            self._health.refused(outcome.failure)
        elif outcome.is_answer:
            self._health.passed()


def content_type(incoming: ReceivedMessage) -> str:
    """Return the content type that a message says to have, "" where it says nothing."""
    return str(getattr(incoming.properties, "ContentType", ""))


_FAILED = "error"
"""The user property of a reply that says why there is none."""


@define(eq=False)
class _Call:
    ended: threading.Event = field(factory=threading.Event)
    reply: ReceivedMessage | None = None
    failure: str = ""

    def end(self, reply: ReceivedMessage | None, failure: str = "") -> None:
        if not self.ended.is_set():
            self.reply, self.failure = reply, failure
            self.ended.set()


class ServiceCalls:
    """Calls of one connection; their replies come on one topic of its own.

    Correlation data are letters and digits, so that a peer in a shell can give them back.
    """

    def __init__(self, link: BrokerConnection, topic: str) -> None:
        self._link = link
        topic = f"{topic}/{link.options.client_level}"
        self._receiver = Receiver(topic, self._take, refused=self._refused)
        # Of the first callers, in threads of their own, exactly one subscribes to the replies, and
        # none publishes a request before that.
        self._opening = threading.Lock()
        self._is_open = False
        self._waiting: dict[bytes, _Call] = {}
        self._strays = 0
        self._stray = ""  # what came last that answers no call

    def call(
        self,
        endpoint: Endpoint,
        options: TopicOptions,
        structures: ServiceStructures,
        message: Message,
        timeout: float,
    ) -> Message:
        """Publish a request and return the reply to it.

        Raises:
            BridgeError: no client serves it, the server says that it failed, the link is down.
        """
        with self._opening:
            if not self._is_open:
                self._link.subscribe(self._receiver)
                self._is_open = True
        budget, topic = self._link.options.budget, endpoint.address[0]
        payload = PayloadCodec(options.content, budget).encode(message)
        correlation, call = os.urandom(16).hex().encode(), _Call()
        more: dict[str, Any] = {
            "ContentType": CONTENT_TYPES[options.content],
            "ResponseTopic": self._receiver.topic,
            "CorrelationData": correlation,
            "MessageExpiryInterval": max(1, int(timeout)),  # late is never, for a request
        }

        def done(outcome: PacketOutcome) -> None:
            if outcome.failure or outcome.no_subscribers:
                call.end(None, outcome.failure or "no client is subscribed to it")

        strays = self._strays
        self._waiting[correlation] = call
        try:
            self._link.publish(topic, payload, done, qos=max(1, options.qos), more=more)
            if not call.ended.wait(timeout):
                text = f"{endpoint}: no reply within {timeout:g} s"
                if self._strays > strays:
                    text += f"; what came instead answers no call: {self._stray}"
                raise BridgeTimeoutError(text)
        finally:
            del self._waiting[correlation]
        if call.reply is None:
            raise BridgeError(f"{endpoint}: {call.failure}", FailureReason.UNAVAILABLE)
        said = dict(getattr(call.reply.properties, "UserProperty", ()))
        if _FAILED in said:
            raise BridgeError(f"{endpoint}: the service failed: {said[_FAILED][:1000]}")
        codec = PayloadCodec.of(options.content, structures.reply, budget)
        try:
            return codec.decode(call.reply.payload, content_type(call.reply))
        except MessageError as error:
            text = f"{endpoint}: the reply cannot be read: {error}"
            raise BridgeError(text, FailureReason.BAD_MESSAGE) from error

    def close(self) -> None:
        """End the calls that wait for a reply; the connection is closed, so none begins."""
        for call in tuple(self._waiting.values()):
            call.end(None, "the bridge was closed")

    def _refused(self, _: str) -> None:
        """Have the next call subscribe again: it says why no reply can come."""
        self._is_open = False

    def _take(self, incoming: ReceivedMessage) -> None:
        correlation = getattr(incoming.properties, "CorrelationData", b"")
        call = self._waiting.get(correlation)
        if call is not None:
            call.end(incoming)
            return
        self._strays += 1
        octets = f"{len(incoming.payload):,} octets"
        self._stray = f"{octets} with the correlation data {correlation[:40]!r}, as no request had"


class ServedTopic(Channel):
    """A function that answers the requests on a topic, one after the other in its own thread."""

    def __init__(
        self,
        endpoint: Endpoint,
        options: TopicOptions,
        structures: ServiceStructures,
        handler: Handler,
        link: BrokerConnection,
        report: Report,
    ) -> None:
        super().__init__(endpoint)
        self._options, self._handler, self._link = options, handler, link
        self._codec = PayloadCodec.of(options.content, structures.request, link.options.budget)
        self._answered = self._failed = self._unanswerable = 0
        topic = endpoint.address[0]
        self._subscription = _Subscription(
            link, topic, options, self._take, partial(report, self), is_service=True
        )

    def facts(self) -> dict[str, object]:
        """Return counters of requests; `unanswerable`: without a topic for the reply."""
        return {
            "answered": self._answered,
            "failed": self._failed,
            "unanswerable": self._unanswerable,
            "lost_on_link": self._subscription.queue.dropped,
        }

    def _close(self) -> None:
        self._subscription.close()

    def _take(self, request: ReceivedMessage) -> None:
        topic = getattr(request.properties, "ResponseTopic", "")
        if not topic or {"+", "#", "$"} & {topic[:1], *topic.split("/")}:
            self._unanswerable += 1
            return
        more: dict[str, Any] = {"ContentType": CONTENT_TYPES[self._options.content]}
        correlation = getattr(request.properties, "CorrelationData", None)
        if correlation is not None:
            more["CorrelationData"] = correlation
        try:
            message = self._codec.decode(request.payload, content_type(request))
            payload = self._codec.encode(self._handler(message))
            self._answered += 1
        except Exception as error:  # noqa: BLE001 - of the handler: the caller gets its text
            self._failed += 1
            payload = b""
            more["UserProperty"] = (_FAILED, sendable(text_of(error)))
        try:
            self._link.publish(topic, payload, more=more)
        except Exception:  # noqa: BLE001 - not connected any more, or no topic
            self._unanswerable += 1
