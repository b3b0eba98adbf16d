"""The bridge: raw steps only; the base class keeps time limits, errors and the list of channels."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any, NoReturn

from attrs import evolve
from paho.mqtt.client import topic_matches_sub

from uoarm.bridge import (
    Bridge,
    Capabilities,
    Channel,
    Delivery,
    Description,
    Discovered,
    Handler,
    ServiceStructures,
    Sink,
    Source,
    reading_endpoint,
)
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Endpoint, Message, MessageStructure, Options, Role
from uoarm_mqtt._channels import TopicSink, TopicSource
from uoarm_mqtt._codec import STRUCTURES, Codec, limits_of, with_topic
from uoarm_mqtt._known import Components, read_schema
from uoarm_mqtt._link import BrokerConnection
from uoarm_mqtt._options import Port, mistake, settings_of
from uoarm_mqtt._services import Calls, ServedTopic
from uoarm_mqtt._subscriptions import Incoming, Receiver

__all__ = ["MqttBridge", "describe_offline"]

_HINTS = {
    False: "say by topic, under `structures` of the bridge's options, what its messages are like",
    True: "say by topic, under `services` of the bridge's options, what it takes and answers",
}
"""What to write where MQTT does not know a structure, by whether it is a service's."""


class MqttBridge(Bridge):
    """An endpoint's address is one topic; an output's may be a filter with wildcards."""

    capabilities = Capabilities(discover=True, call=True, serve=True)

    def __init__(self, name: str, options: Options) -> None:
        super().__init__(name, options)
        self._given: dict[str, Any] = dict(options)
        self._broker = BrokerConnection(name, settings_of(name, options), self.report)
        self._components = Components(
            self._broker,
            self._given.get("retained_wait", 0.2),
            lambda component, health, cause: self.report(health, cause, component=component),
        )
        self._calls = Calls(self._broker, self._given.get("replies", "uoarm/replies"))

    @property
    def process_id(self) -> int | None:
        """Return None: the broker and who speaks through it are anywhere."""
        return None

    def _describe(self, endpoint: Endpoint) -> Description:
        port = self._port(endpoint)
        self._broker.require_up()
        self._require_present(endpoint, port)
        return self._description(endpoint, port)

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Delivery
    ) -> Source:
        port = self._port(endpoint)
        self._require_there(endpoint, port)
        schema: Any = structure.schema
        inner = MessageStructure(schema) if not port.with_topic else _inner(schema)
        codec = Codec.of(port.content, inner, self._broker.settings.budget)
        topic = endpoint.address[0]
        return TopicSource(endpoint, topic, port, codec, self._broker, deliver, self._tell)

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        del structure
        port = self._port(endpoint)
        self._require_there(endpoint, port)
        codec = Codec(port.content, self._broker.settings.budget)
        return TopicSink(endpoint, endpoint.address[0], port, codec, self._broker, self._tell)

    def _call(
        self, endpoint: Endpoint, structures: ServiceStructures, message: Message, timeout: float
    ) -> Message:
        port = self._port(endpoint)
        self._require_there(endpoint, port)
        return self._calls.call(endpoint, port, structures, message, timeout)

    def _serve(
        self, endpoint: Endpoint, structures: ServiceStructures, handler: Handler
    ) -> Channel:
        return ServedTopic(endpoint, self._port(endpoint), structures, handler, self._broker)

    def _discover(self) -> tuple[Discovered, ...]:
        wanted = self._given.get("discover", {})
        pattern = self._given.get("schemas", "")
        before, _, after = pattern.partition("{topic}")
        filters = [f"{before}#"] if pattern else wanted.get("topics", ["#"])
        # Schemas are retained, and so are there at once; others have to be waited for.
        seconds = self._given.get("retained_wait", 0.2) if pattern else wanted.get("seconds", 1.0)
        topics = self._topics_on(filters, seconds, wanted.get("most", 200))
        if pattern:
            topics = [
                one[len(before) : len(one) - len(after)] for one in topics if one.endswith(after)
            ]
        return tuple(one for topic in topics if (one := self._discovered(topic)) is not None)

    def _close(self) -> None:
        self._broker.close()

    def _port(self, endpoint: Endpoint) -> Port:
        with reading_endpoint(endpoint):
            if wrong := mistake(endpoint.address, endpoint.options):
                raise ValueError(wrong)
            port = Port.of(endpoint.options)
            is_wide = {"+", "#"} & set(endpoint.address[0].split("/"))
            if endpoint.role is not Role.OUTPUT and (is_wide or port.with_topic):
                raise ValueError("wildcards and `with_topic` are for outputs")
            if endpoint.role is Role.INPUT and port.share:
                raise ValueError("`share` is for what is subscribed to: outputs and services")
        return port

    def _require_present(self, endpoint: Endpoint, port: Port) -> None:
        if port.presence is not None:
            self._components.require(endpoint.component, port.presence)

    def _require_there(self, endpoint: Endpoint, port: Port) -> None:
        """Refuse what is not there, by the presence or by the schema that it should have."""
        self._broker.require_up()
        self._require_present(endpoint, port)
        if configured(self._given, endpoint, port) is None and "schemas" in self._given:
            self._description(endpoint, port)

    def _description(self, endpoint: Endpoint, port: Port) -> Description:
        found = configured(self._given, endpoint, port)
        if found is None and (pattern := self._given.get("schemas")):
            topic = endpoint.address[0]
            place = pattern.replace("{topic}", topic)
            payload = (
                b"" if {"+", "#"} & set(topic.split("/")) else self._components.retained(place)
            )
            if not payload:
                self._refuse(endpoint, f"no schema of {topic} is retained on {place}")
            schema = read_schema(place, payload, self._broker.settings.budget)
            if ("request" in schema) is not (endpoint.role is Role.SERVICE):
                self._refuse(endpoint, f"what {place} describes is no {endpoint.role.value}")
            found = _described(schema)
        found = found or Description(hint=_HINTS[endpoint.role is Role.SERVICE])
        if port.with_topic and found.message is not None:
            return Description(with_topic(found.message))
        if endpoint.role is Role.OUTPUT:
            return found
        most = self._broker.largest_payload(endpoint.address[0])
        return evolve(found, limits=limits_of(port.content, most))

    def _refuse(self, endpoint: Endpoint, why: str) -> NoReturn:
        raise BridgeError(f"bridge {self.name!r}: {endpoint}: {why}", FailureReason.NOT_FOUND)

    def _topics_on(self, filters: list[str], seconds: float, most: int) -> list[str]:
        """Return topics on which something comes or is retained, in order, at most so many."""
        found: dict[str, None] = {}
        enough = threading.Event()

        def take(incoming: Incoming) -> None:
            if len(found) < most:
                found[incoming.topic] = None
            else:
                enough.set()

        receivers = [Receiver(one, take, qos=0, retained=True) for one in filters]
        opened: list[Receiver] = []
        try:
            for one in receivers:
                self._broker.subscribe(one)
                opened.append(one)
            self._broker.barrier()
            enough.wait(seconds)
        finally:
            for one in opened:
                self._broker.unsubscribe(one)
        return sorted(found)

    def _discovered(self, topic: str) -> Discovered | None:
        if topic.startswith(("$", self._given.get("replies", "uoarm/replies"))):
            return None
        for role in (Role.OUTPUT, Role.SERVICE):
            endpoint = Endpoint(self.name, topic, role, (topic,))
            try:
                return Discovered(topic, ((endpoint, self._description(endpoint, Port())),))
            except BridgeError:
                continue
        return None

    def _tell(self, channel: Channel, health: Any, cause: str) -> None:
        self.report(health, cause, channel=channel)


def configured(given: Mapping[str, Any], endpoint: Endpoint, port: Port) -> Description | None:
    """Return what options say of an endpoint's structures, None where they say nothing."""
    topic = endpoint.address[0]
    if endpoint.role is Role.SERVICE:
        return _described(given.get("services", {}).get(topic))
    for pattern, schema in given.get("structures", {}).items():
        if pattern == topic or topic_matches_sub(pattern, topic):
            return _described(schema)
    known = STRUCTURES.get(port.content)
    return None if known is None else Description(known)


def describe_offline(endpoint: Endpoint, options: Options) -> Description:
    """Return what a bridge would describe, as far as that is known without its broker."""
    found = configured(options, endpoint, Port.of(endpoint.options))
    if found is None and "schemas" not in options:
        return Description(hint=_HINTS[endpoint.role is Role.SERVICE])
    return found or Description()


def _described(schema: Any) -> Description | None:
    """Return a description of a schema, or of a mapping of two."""
    if schema is None:
        return None
    if isinstance(schema, dict) and schema.keys() and schema.keys() <= {"request", "reply"}:
        sides = {name: MessageStructure(side) for name, side in schema.items()}
        return Description(request=sides.get("request"), reply=sides.get("reply"))
    return Description(MessageStructure(schema))


def _inner(schema: Any) -> MessageStructure:
    """Return the structure within one that says the topic; references are seen from the root."""
    if not isinstance(schema, dict):
        return MessageStructure(True)
    inner = schema.get("properties", {}).get("message", True)
    named = {one: schema[one] for one in ("$defs", "definitions") if one in schema}
    return MessageStructure({**inner, **named} if isinstance(inner, dict) else inner)
