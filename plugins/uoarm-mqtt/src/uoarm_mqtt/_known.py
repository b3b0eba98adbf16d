"""What stands on the broker about components: whether they are there, and their structures."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from typing import Any

from jsonschema import Draft202012Validator, SchemaError

from uoarm.errors import BridgeError, ControlMessageError, FailureReason, MessageError
from uoarm.model import Budget, Health
from uoarm_mqtt._codec import Codec
from uoarm_mqtt._link import BrokerConnection
from uoarm_mqtt._options import Presence
from uoarm_mqtt._subscriptions import Incoming, Receiver

__all__ = ["Components", "Watched", "read_schema"]

_SMALL = Budget(octets=16_384, elements=1000, depth=16)
_NOTHING = b""


class Watched:
    """The last message of one topic, kept up to date until the connection is closed."""

    def __init__(
        self, link: BrokerConnection, topic: str, changed: Callable[[bytes], None]
    ) -> None:
        self.payload = _NOTHING
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

    def _take(self, incoming: Incoming) -> None:
        self.payload = incoming.payload
        self._changed(incoming.payload)
        self._came.set()


class Components:
    """Which components are there, by their own word: retained topics, watched once asked for.

    Args:
        link: to the broker.
        wait: seconds that a retained message may take beyond the broker's own answer.
        told: is called with a component's name, health and cause when it comes or goes.
    """

    def __init__(
        self, link: BrokerConnection, wait: float, told: Callable[[str, Health, str], object]
    ) -> None:
        self._link, self._wait, self._told = link, wait, told
        self._lock = threading.Lock()
        self._watched: dict[object, Watched] = {}

    def require(self, component: str, presence: Presence) -> None:
        """Return when a component says that it is there.

        Raises:
            BridgeError: with UNAVAILABLE: it says something else, or nothing.
        """
        before = [Health.LOST]

        def changed(payload: bytes) -> None:
            health, said = _health(presence, payload)
            if health is not before[0] and Health.OK in {health, before[0]}:
                self._told(component, health, f"{presence.topic} says {said}")
            before[0] = health

        health, said = _health(presence, self._read((component, presence), presence.topic, changed))
        if health is not Health.OK:
            text = f"{component} is not there: {presence.topic} says {said}"
            raise BridgeError(text, FailureReason.UNAVAILABLE)

    def retained(self, topic: str) -> bytes:
        """Return what is retained on a topic now, nothing where nothing is."""
        return self._read(topic, topic, lambda _: None)

    def _read(self, key: object, topic: str, changed: Callable[[bytes], None]) -> bytes:
        with self._lock:
            watched = self._watched.get(key)
            if watched is None:
                watched = Watched(self._link, topic, changed)
                watched.open(self._wait)
                self._watched[key] = watched
        return watched.payload


def read_schema(topic: str, payload: bytes, budget: Budget) -> Any:
    """Read a JSON Schema as it stands on a topic, or the two of a service.

    Raises:
        BridgeError: it is none.
    """
    try:
        found = Codec("json", budget).decode(payload)
        is_service = isinstance(found, dict) and {"request", "reply"} >= found.keys() != set()
        for schema in found.values() if is_service else [found]:
            Draft202012Validator.check_schema(schema)
    except (MessageError, SchemaError) as error:
        report = error.message if isinstance(error, SchemaError) else error
        text = f"what is retained on {topic} is no JSON Schema: {report}"
        raise BridgeError(text, FailureReason.BAD_MESSAGE) from error
    return found


def _health(presence: Presence, payload: bytes) -> tuple[Health, str]:
    """Return what a payload says of a component, and how it says it."""
    if not payload:
        return Health.LOST, "nothing"
    try:
        said: Any = Codec("text", _SMALL).decode(payload)
        if presence.member:
            said = Codec("json", _SMALL).decode(payload)[presence.member]
    except (MessageError, ControlMessageError, KeyError, TypeError, IndexError) as error:
        return Health.LOST, f"what cannot be read ({type(error).__name__}: {error})"
    shown = json.dumps(said)[:80]
    if said == presence.online:
        return Health.OK, shown
    return (Health.FINISHED if said == presence.finished else Health.LOST), shown
