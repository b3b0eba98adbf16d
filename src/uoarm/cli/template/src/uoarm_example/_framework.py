"""A stand-in for the framework: topics in this process. Put the real middleware here."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

__all__ = ["TOPICS", "Bus"]

TOPICS: dict[str, dict[str, Any]] = {
    "temperature": {
        "type": "object",
        "properties": {"celsius": {"type": "number", "minimum": -273.15}},
        "required": ["celsius"],
        "additionalProperties": False,
    },
    "text": {"type": "string"},
}
"""The message structure of each topic, as JSON Schema."""


class Bus:
    """Hands what is published on a topic to its subscribers, in the publisher's thread."""

    def __init__(self) -> None:
        self._subscribers: dict[str, list[Callable[[Any], None]]] = {}
        self._lock = threading.Lock()

    def publish(self, topic: str, message: Any) -> None:
        """Hand a message to every subscriber of a topic."""
        with self._lock:
            subscribers = list(self._subscribers.get(topic, ()))
        for subscriber in subscribers:
            subscriber(message)

    def subscribe(self, topic: str, subscriber: Callable[[Any], None]) -> Callable[[], None]:
        """Add a subscriber; returns what takes it away again."""
        with self._lock:
            self._subscribers.setdefault(topic, []).append(subscriber)

        def leave() -> None:
            with self._lock:
                self._subscribers[topic].remove(subscriber)

        return leave
