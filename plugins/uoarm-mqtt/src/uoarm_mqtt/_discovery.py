"""What the broker and the options say of components: which topics, structures and presence."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any

from jsonschema import Draft202012Validator, SchemaError
from paho.mqtt.client import topic_matches_sub

from uoarm.bridge import Description
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Budget, Endpoint, MessageStructure, Role
from uoarm.schema import newest
from uoarm_mqtt._codec import STRUCTURES, PayloadCodec
from uoarm_mqtt._link import BrokerConnection
from uoarm_mqtt._options import MqttOptions, TopicOptions
from uoarm_mqtt._subscriptions import ReceivedMessage, Receiver

STRUCTURE_HINTS = {
    False: "say by topic, under `structures` of the bridge's options, what its messages are like",
    True: "say by topic, under `services` of the bridge's options, what it takes and answers",
}
"""What to write where MQTT does not know a structure, by whether it is a service's."""


def read_schema(topic: str, payload: bytes, budget: Budget) -> Any:
    """Read a JSON Schema as it stands on a topic, or the two of a service.

    Raises:
        BridgeError: it is none.
    """
    try:
        found = PayloadCodec("json", budget).decode(payload)
        sides = found if _is_of_service(found) else {"": found}
        sides = {name: newest(schema) for name, schema in sides.items()}
        for schema in sides.values():
            Draft202012Validator.check_schema(schema)
    except (MessageError, SchemaError, ValueError) as error:
        report = error.message if isinstance(error, SchemaError) else error
        text = f"what is retained on {topic} is no JSON Schema: {report}"
        raise BridgeError(text, FailureReason.BAD_MESSAGE) from error
    return sides.get("", sides)


def _is_of_service(schema: Any) -> bool:
    """Say whether it is a mapping of the schemas of a request, a reply or both."""
    return isinstance(schema, dict) and {"request", "reply"} >= schema.keys() != set()


def topics_on(
    link: BrokerConnection, filters: Sequence[str], seconds: float, most: int
) -> list[str]:
    """Return topics on which something comes or is retained, in order, at most so many."""
    found: dict[str, None] = {}
    enough = threading.Event()

    def take(incoming: ReceivedMessage) -> None:
        if len(found) < most:
            found[incoming.topic] = None
        else:
            enough.set()

    opened: list[Receiver] = []
    try:
        for topic in filters:
            receiver = Receiver(topic, take, qos=0, retained=True)
            link.subscribe(receiver)
            opened.append(receiver)
        link.barrier()
        enough.wait(seconds)
    finally:
        for receiver in opened:
            link.unsubscribe(receiver)
    return sorted(found)


def configured(
    bridge_options: MqttOptions, endpoint: Endpoint, options: TopicOptions
) -> Description | None:
    """Return what options say of an endpoint's structures, None where they say nothing."""
    topic = endpoint.address[0]
    if endpoint.role is Role.SERVICE:
        return described(bridge_options.services.get(topic))
    for pattern, schema in bridge_options.structures.items():
        if pattern == topic or topic_matches_sub(pattern, topic):
            return described(schema)
    known = STRUCTURES.get(options.content)
    return None if known is None else Description(known)


def describe_offline(endpoint: Endpoint, options: MqttOptions) -> Description:
    """Return what a bridge would describe, as far as that is known without its broker."""
    found = configured(options, endpoint, TopicOptions.of(endpoint.options))
    if found is None and not options.schemas:
        return Description(hint=STRUCTURE_HINTS[endpoint.role is Role.SERVICE])
    return found or Description()


def described(schema: Any) -> Description | None:
    """Return a description of a schema, or of a mapping of two."""
    if schema is None:
        return None
    if _is_of_service(schema):
        sides = {name: MessageStructure(side) for name, side in schema.items()}
        return Description(request=sides.get("request"), reply=sides.get("reply"))
    return Description(MessageStructure(schema))
