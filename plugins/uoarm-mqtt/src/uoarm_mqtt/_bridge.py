"""The bridge: raw steps only; the base class keeps time limits, errors and the list of channels."""

from __future__ import annotations

from contextlib import suppress
from typing import Any, NoReturn

from attrs import evolve

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
from uoarm.model import Endpoint, Message, MessageStructure, Role
from uoarm.schema import property_of
from uoarm_mqtt._channels import MqttSink, MqttSource, ServedTopic, ServiceCalls
from uoarm_mqtt._codec import PayloadCodec, limits_of, with_topic
from uoarm_mqtt._discovery import (
    STRUCTURE_HINTS,
    configured,
    described,
    read_schema,
    topics_on,
)
from uoarm_mqtt._health import Components
from uoarm_mqtt._link import BrokerConnection
from uoarm_mqtt._options import MqttOptions, TopicOptions, announcement, connection_options, mistake


class MqttBridge(Bridge):
    """An endpoint's address is one topic; an output's may be a filter with wildcards."""

    capabilities = Capabilities(discover=True, call=True, serve=True)

    def __init__(self, name: str, options: MqttOptions) -> None:
        super().__init__(name, options)
        self._options = options
        connection = connection_options(name, options, announcement(options.presence))
        self._broker = BrokerConnection(name, connection, self.report)
        self._components = Components(
            self._broker,
            options.retained_wait,
            lambda component, health, cause: self.report(health, cause, component=component),
        )
        self._calls = ServiceCalls(self._broker, options.replies)

    @property
    def process_id(self) -> int | None:
        """Return None: the broker and its clients are anywhere."""
        return None

    def _describe(self, endpoint: Endpoint) -> Description:
        options = self._options_of(endpoint)
        self._broker.require_up()
        self._require_present(endpoint, options)
        return self._description(endpoint, options)

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Delivery
    ) -> Source:
        options = self._options_of(endpoint)
        self._require_there(endpoint, options)
        schema: Any = structure.schema
        inner = MessageStructure(property_of(schema, "message") if options.with_topic else schema)
        codec = PayloadCodec.of(options.content, inner, self._broker.options.budget)
        topic = endpoint.address[0]
        return MqttSource(
            endpoint, topic, options, codec, self._broker, deliver, self.report_channel
        )

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        del structure
        options = self._options_of(endpoint)
        self._require_there(endpoint, options)
        codec = PayloadCodec(options.content, self._broker.options.budget)
        return MqttSink(
            endpoint, endpoint.address[0], options, codec, self._broker, self.report_channel
        )

    def _call(
        self, endpoint: Endpoint, structures: ServiceStructures, message: Message, timeout: float
    ) -> Message:
        options = self._options_of(endpoint)
        self._require_there(endpoint, options)
        return self._calls.call(endpoint, options, structures, message, timeout)

    def _serve(
        self, endpoint: Endpoint, structures: ServiceStructures, handler: Handler
    ) -> Channel:
        options = self._options_of(endpoint)
        return ServedTopic(
            endpoint, options, structures, handler, self._broker, self.report_channel
        )

    def _discover(self) -> tuple[Discovered, ...]:
        wanted, pattern = self._options.discover, self._options.schemas
        before, _, after = pattern.partition("{topic}")
        filters = (f"{before}#",) if pattern else wanted.topics
        # Schemas are retained, and so are there at once; others have to be waited for.
        seconds = self._options.retained_wait if pattern else wanted.seconds
        topics = topics_on(self._broker, filters, seconds, wanted.most)
        if pattern:
            topics = [
                topic[len(before) : len(topic) - len(after)]
                for topic in topics
                if topic.endswith(after)
            ]
        discovered = map(self._discover_topic, topics)
        return tuple(component for component in discovered if component is not None)

    def _close(self) -> None:
        self._broker.close()
        self._calls.close()

    def _options_of(self, endpoint: Endpoint) -> TopicOptions:
        with reading_endpoint(endpoint):
            options = TopicOptions.of(endpoint.options)
            if wrong := mistake(endpoint.address, endpoint.options):
                raise ValueError(wrong)
            is_wide = {"+", "#"} & set(endpoint.address[0].split("/"))
            if endpoint.role is not Role.OUTPUT and (is_wide or options.with_topic):
                raise ValueError("wildcards and `with_topic` are for outputs")
            if endpoint.role is Role.INPUT and options.share:
                raise ValueError("`share` is for what is subscribed to: outputs and services")
        return options

    def _require_present(self, endpoint: Endpoint, options: TopicOptions) -> None:
        if options.presence is not None:
            self._components.require(endpoint.component, options.presence)

    def _require_there(self, endpoint: Endpoint, options: TopicOptions) -> None:
        """Refuse what is not there, by the presence or by the schema that it should have."""
        self._broker.require_up()
        self._require_present(endpoint, options)
        if configured(self._options, endpoint, options) is None and self._options.schemas:
            self._description(endpoint, options)

    def _description(self, endpoint: Endpoint, options: TopicOptions) -> Description:
        found = configured(self._options, endpoint, options)
        if found is None and (pattern := self._options.schemas):
            topic = endpoint.address[0]
            place = pattern.replace("{topic}", topic)
            payload = (
                b"" if {"+", "#"} & set(topic.split("/")) else self._components.retained(place)
            )
            if not payload:
                self._refuse(endpoint, f"no schema of {topic} is retained on {place}")
            schema = read_schema(place, payload, self._broker.options.budget)
            if ("request" in schema) is not (endpoint.role is Role.SERVICE):
                self._refuse(endpoint, f"what {place} describes is no {endpoint.role.value}")
            found = described(schema)
        found = found or Description(hint=STRUCTURE_HINTS[endpoint.role is Role.SERVICE])
        if options.with_topic and found.message is not None:
            return Description(with_topic(found.message))
        if endpoint.role is Role.OUTPUT:
            return found
        most = self._broker.largest_payload(endpoint.address[0])
        return evolve(found, limits=limits_of(options.content, most))

    def _refuse(self, endpoint: Endpoint, why: str) -> NoReturn:
        raise BridgeError(f"bridge {self.name!r}: {endpoint}: {why}", FailureReason.NOT_FOUND)

    def _discover_topic(self, topic: str) -> Discovered | None:
        if topic.startswith(("$", self._options.replies)):
            return None
        for role in (Role.OUTPUT, Role.SERVICE):
            endpoint = Endpoint(self.name, topic, role, (topic,))
            with suppress(BridgeError):
                return Discovered(topic, ((endpoint, self._description(endpoint, TopicOptions())),))
        return None
