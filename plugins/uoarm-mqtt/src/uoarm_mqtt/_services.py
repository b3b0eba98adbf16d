"""Requests and replies: response topic and correlation data of MQTT 5."""

from __future__ import annotations

import os
import threading
from typing import Any

from attrs import define, field

from uoarm.bridge import Channel, Handler, ServiceStructures
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, MessageError
from uoarm.model import Endpoint, Message
from uoarm_mqtt._channels import Backlog, content_type
from uoarm_mqtt._codec import CONTENT_TYPES, Codec
from uoarm_mqtt._link import BrokerConnection, Outcome
from uoarm_mqtt._options import Port
from uoarm_mqtt._subscriptions import Incoming, Receiver

__all__ = ["Calls", "ServedTopic"]

_FAILED = "error"
"""The user property of a reply that says why there is none."""


@define(eq=False)
class _Call:
    ended: threading.Event = field(factory=threading.Event)
    reply: Incoming | None = None
    failure: str = ""

    def end(self, reply: Incoming | None, failure: str = "") -> None:
        if not self.ended.is_set():
            self.reply, self.failure = reply, failure
            self.ended.set()


class Calls:
    """Calls of one connection; their replies come on one topic of its own.

    Correlation data are letters and digits, so that a peer in a shell can give them back.
    """

    def __init__(self, link: BrokerConnection, topic: str) -> None:
        self._link = link
        self._receiver = Receiver(f"{topic}/{link.settings.client_id}", self._take)
        self._opening = threading.Lock()
        self._is_open = False
        self._waiting: dict[bytes, _Call] = {}
        self._strays = 0
        self._stray = ""  # what came last that answers no call

    def call(
        self,
        endpoint: Endpoint,
        port: Port,
        structures: ServiceStructures,
        message: Message,
        timeout: float,
    ) -> Message:
        """Publish a request and return the reply to it.

        Raises:
            BridgeError: nobody serves it, the server says that it failed, the link is down.
        """
        with self._opening:
            if not self._is_open:
                self._link.subscribe(self._receiver)
                self._is_open = True
        budget, topic = self._link.settings.budget, endpoint.address[0]
        payload = Codec(port.content, budget).encode(message)
        correlation, call = os.urandom(16).hex().encode(), _Call()
        more: dict[str, Any] = {
            "ContentType": CONTENT_TYPES[port.content],
            "ResponseTopic": self._receiver.topic,
            "CorrelationData": correlation,
            "MessageExpiryInterval": max(1, int(timeout)),  # late is never, for a request
        }

        def done(outcome: Outcome) -> None:
            if outcome.failure or outcome.nobody:
                call.end(None, outcome.failure or "nobody is subscribed to it")

        strays = self._strays
        self._waiting[correlation] = call
        try:
            self._link.publish(topic, payload, done, qos=max(1, port.qos), more=more)
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
        codec = Codec.of(port.content, structures.reply, budget)
        try:
            return codec.decode(call.reply.payload, content_type(call.reply))
        except MessageError as error:
            text = f"{endpoint}: the reply cannot be read: {error}"
            raise BridgeError(text, FailureReason.BAD_MESSAGE) from error

    def _take(self, incoming: Incoming) -> None:
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
        port: Port,
        structures: ServiceStructures,
        handler: Handler,
        link: BrokerConnection,
    ) -> None:
        super().__init__(endpoint)
        self._port, self._handler, self._link = port, handler, link
        self._codec = Codec.of(port.content, structures.request, link.settings.budget)
        self._answered = self._failed = self._unanswerable = 0
        topic, settings = endpoint.address[0], link.settings
        self._backlog = Backlog(
            f"uoarm-mqtt-{topic}", self._take, settings.backlog, 8 * settings.budget.octets
        )
        shared = f"$share/{port.share}/{topic}" if port.share else topic
        self._receiver = Receiver(shared, self._backlog.put, max(1, port.qos))
        try:
            link.subscribe(self._receiver)
        except BaseException:
            self._backlog.close()
            raise

    def facts(self) -> dict[str, object]:
        """Return counters of requests; `unanswerable`: without a topic for the reply."""
        return {
            "answered": self._answered,
            "failed": self._failed,
            "unanswerable": self._unanswerable,
            "lost_on_link": self._backlog.dropped,
        }

    def _close(self) -> None:
        self._link.unsubscribe(self._receiver)
        self._backlog.close()

    def _take(self, request: Incoming) -> None:
        topic = getattr(request.properties, "ResponseTopic", "")
        if not topic or {"+", "#", "$"} & {topic[:1], *topic.split("/")}:
            self._unanswerable += 1
            return
        more: dict[str, Any] = {"ContentType": CONTENT_TYPES[self._port.content]}
        correlation = getattr(request.properties, "CorrelationData", None)
        if correlation is not None:
            more["CorrelationData"] = correlation
        try:
            message = self._codec.decode(request.payload, content_type(request))
            payload = self._codec.encode(self._handler(message))
            self._answered += 1
        except Exception as error:  # noqa: BLE001 - of the handler: the caller is told
            self._failed += 1
            payload = b""
            more["UserProperty"] = (_FAILED, f"{type(error).__name__}: {error}"[:1000])
        try:
            self._link.publish(topic, payload, _ignore, qos=1, more=more)
        except Exception:  # noqa: BLE001 - not connected any more, or no topic: nobody to tell
            self._unanswerable += 1


def _ignore(_: Outcome) -> None:
    """Whether the reply was taken matters to the caller alone."""
