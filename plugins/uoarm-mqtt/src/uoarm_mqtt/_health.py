"""Health of components, as their retained topics say it."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from typing import Any

from attrs import frozen

from uoarm.bridge import text_of
from uoarm.errors import BridgeError, ControlMessageError, FailureReason, MessageError
from uoarm.model import Budget, Health
from uoarm_mqtt._codec import PayloadCodec
from uoarm_mqtt._link import BrokerConnection
from uoarm_mqtt._options import PresenceOptions
from uoarm_mqtt._subscriptions import ReceivedMessage, Receiver

_SMALL = Budget(octets=16_384, elements=1000, depth=16)


@frozen
class PresenceStatus:
    """What a component's topic says of it.

    Attributes:
        health: OK while it is there, FINISHED after an orderly end, else LOST.
        cause: the topic, and what stands on it.
    """

    health: Health
    cause: str

    @classmethod
    def read(cls, options: PresenceOptions, payload: bytes) -> PresenceStatus:
        """Read the last payload of the topic, b"" where none stands there."""
        if not payload:
            return cls(Health.LOST, f"{options.topic} says nothing")
        try:
            value: Any = PayloadCodec("text", _SMALL).decode(payload)
            if options.member:
                value = PayloadCodec("json", _SMALL).decode(payload)[options.member]
        except (MessageError, ControlMessageError, KeyError, TypeError, IndexError) as error:
            text = f"what cannot be read ({text_of(error)})"
            return cls(Health.LOST, f"{options.topic} says {text}")
        cause = f"{options.topic} says {json.dumps(value)[:80]}"
        if value == options.online:
            return cls(Health.OK, cause)
        return cls(Health.FINISHED if value == options.finished else Health.LOST, cause)


class RetainedTopic:
    """The last message of one topic, kept up to date until the connection is closed.

    With `changed`, which takes each, it lapses where it is not said again after a break.
    """

    def __init__(
        self, link: BrokerConnection, topic: str, changed: Callable[[bytes], None] | None
    ) -> None:
        self.payload = b""
        self._changed = changed
        self._came = threading.Event()
        self._link = link
        self._receiver = Receiver(topic, self._take, retained=True, lapses=changed is not None)
        # Held until what is retained has come, so that no caller reads a topic that is only being
        # opened, and callers in several threads open it once.
        self._opening = threading.Lock()
        self._is_open = False

    def open(self, wait: float) -> None:
        """Subscribe, once; returns when what is retained has come, or nothing is."""
        with self._opening:
            if self._is_open:
                return
            self._link.subscribe(self._receiver, settled=True)
            # Mosquitto sends what is retained before it answers; others may be later.
            self._came.wait(wait)
            self._is_open = True

    def _take(self, incoming: ReceivedMessage) -> None:
        self.payload = incoming.payload
        if self._changed is not None:
            self._changed(incoming.payload)
        self._came.set()


class Components:
    """Which components are there, by their own word: retained topics, watched once asked for.

    Args:
        wait: seconds that a retained message may take beyond the broker's own answer.
        report: is called with a component's name, health and cause when it comes or goes.
    """

    def __init__(
        self, link: BrokerConnection, wait: float, report: Callable[[str, Health, str], object]
    ) -> None:
        self._link, self._wait, self._report = link, wait, report
        self._watched: dict[object, RetainedTopic] = {}

    def require(self, component: str, presence: PresenceOptions) -> None:
        """Return when a component says that it is there.

        Raises:
            BridgeError: with UNAVAILABLE: it says something else, or nothing.
        """
        health = Health.LOST

        def changed(payload: bytes) -> None:
            """Report that it comes, or that it goes."""
            nonlocal health
            status = PresenceStatus.read(presence, payload)
            before, health = health, status.health
            if health is not before and Health.OK in {health, before}:
                self._report(component, health, status.cause)

        payload = self._read((component, presence), presence.topic, changed)
        status = PresenceStatus.read(presence, payload)
        if status.health is not Health.OK:
            text = f"{component} is not there: {status.cause}"
            raise BridgeError(text, FailureReason.UNAVAILABLE)

    def retained(self, topic: str) -> bytes:
        """Return what is retained on a topic now, nothing where nothing is."""
        return self._read(topic, topic, None)

    def _read(self, key: object, topic: str, changed: Callable[[bytes], None] | None) -> bytes:
        watched = self._watched.get(key)
        if watched is None:  # of several callers at once, all get the same one
            made = RetainedTopic(self._link, topic, changed)
            watched = self._watched.setdefault(key, made)
        watched.open(self._wait)
        return watched.payload
