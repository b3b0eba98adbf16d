"""What the broker and the options say of components: which topics, structures and presence."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import Any

from jsonschema import Draft202012Validator, SchemaError
from paho.mqtt.client import topic_matches_sub

from uoarm.bridge import Description
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Budget, Endpoint, Health, MessageStructure, Role
from uoarm_mqtt._codec import STRUCTURES, PayloadCodec
from uoarm_mqtt._health import ComponentPresence, PresenceStatus
from uoarm_mqtt._link import BrokerConnection
from uoarm_mqtt._options import MqttOptions, PresenceOptions, TopicOptions
from uoarm_mqtt._subscriptions import ReceivedMessage, Receiver

__all__ = [
    "STRUCTURE_HINTS",
    "Components",
    "RetainedTopic",
    "configured",
    "describe_offline",
    "described",
    "read_schema",
    "topics_on",
]

STRUCTURE_HINTS = {
    False: "say by topic, under `structures` of the bridge's options, what its messages are like",
    True: "say by topic, under `services` of the bridge's options, what it takes and answers",
}
"""What to write where MQTT does not know a structure, by whether it is a service's."""


class RetainedTopic:
    """The last message of one topic, kept up to date until the connection is closed."""

    def __init__(
        self, link: BrokerConnection, topic: str, changed: Callable[[bytes], None]
    ) -> None:
        self.payload = b""
        self._changed = changed
        self._came = threading.Event()
        self._link, self._receiver = link, Receiver(topic, self._take, retained=True)

    def open(self, wait: float) -> None:
        """Subscribe; returns when what is retained has come, or nothing is."""
        self._link.subscribe(self._receiver)
        try:
            self._link.barrier()
        except BridgeError:
            self._link.unsubscribe(self._receiver)
            raise
        # Mosquitto sends what is retained before it answers; others may be later.
        self._came.wait(wait)

    def _take(self, incoming: ReceivedMessage) -> None:
        self.payload = incoming.payload
        self._changed(incoming.payload)
        self._came.set()


class Components:
    """Which components are there, by their own word: retained topics, watched once asked for.

    Args:
        link: to the broker.
        wait: seconds that a retained message may take beyond the broker's own answer.
        report: is called with a component's name, health and cause when it comes or goes.
    """

    def __init__(
        self, link: BrokerConnection, wait: float, report: Callable[[str, Health, str], object]
    ) -> None:
        self._link, self._wait, self._report = link, wait, report
        # Callers in several threads watch a topic once; held until what is retained has come, so
        # that none reads a topic that is only being opened.
        self._lock = threading.Lock()
        self._watched: dict[object, RetainedTopic] = {}

    def require(self, component: str, presence: PresenceOptions) -> None:
        """Return when a component says that it is there.

        Raises:
            BridgeError: with UNAVAILABLE: it says something else, or nothing.
        """
        known = ComponentPresence(presence)

        def changed(payload: bytes) -> None:
            if (status := known.changed(payload)) is not None:
                self._report(component, status.health, status.cause)

        payload = self._read((component, presence), presence.topic, changed)
        status = PresenceStatus.read(presence, payload)
        if status.health is not Health.OK:
            text = f"{component} is not there: {status.cause}"
            raise BridgeError(text, FailureReason.UNAVAILABLE)

    def retained(self, topic: str) -> bytes:
        """Return what is retained on a topic now, nothing where nothing is."""
        return self._read(topic, topic, lambda _: None)

    def _read(self, key: object, topic: str, changed: Callable[[bytes], None]) -> bytes:
        with self._lock:
            watched = self._watched.get(key)
            if watched is None:
                watched = RetainedTopic(self._link, topic, changed)
                watched.open(self._wait)
                self._watched[key] = watched
        return watched.payload


def read_schema(topic: str, payload: bytes, budget: Budget) -> Any:
    """Read a JSON Schema as it stands on a topic, or the two of a service.

    Raises:
        BridgeError: it is none.
    """
    try:
        found = PayloadCodec("json", budget).decode(payload)
        is_service = isinstance(found, dict) and {"request", "reply"} >= found.keys() != set()
        for schema in found.values() if is_service else [found]:
            Draft202012Validator.check_schema(schema)
    except (MessageError, SchemaError) as error:
        report = error.message if isinstance(error, SchemaError) else error
        text = f"what is retained on {topic} is no JSON Schema: {report}"
        raise BridgeError(text, FailureReason.BAD_MESSAGE) from error
    return found


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
    if isinstance(schema, dict) and schema.keys() and schema.keys() <= {"request", "reply"}:
        sides = {name: MessageStructure(side) for name, side in schema.items()}
        return Description(request=sides.get("request"), reply=sides.get("reply"))
    return Description(MessageStructure(schema))
