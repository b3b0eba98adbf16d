"""What a bridge delivers or reports, collected and waited for."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from uoarm.bridge import Bridge, HealthEvent
from uoarm.model import Health
from uoarm.testing import patience, wait


class Inbox:
    """Collects messages or events, and waits for a number of them, or for one.

    Args:
        bridge: whose events it collects, if any.
    """

    def __init__(self, bridge: Bridge | None = None) -> None:
        self.messages: list[Any] = []
        self._changed = threading.Condition()
        if bridge is not None:
            bridge.watch(self)

    def __call__(self, message: Any) -> None:
        with self._changed:
            self.messages.append(message)
            self._changed.notify_all()

    def numbers(self) -> list[int]:
        return [message["data"] for message in self.messages]

    def wait_for(self, count: int) -> list[Any]:
        """Wait for so many, as long as within `patience` some more come."""
        with self._changed:
            while len(self.messages) < count:
                before = len(self.messages)
                self._changed.wait_for(lambda: len(self.messages) >= count, patience())
                assert len(self.messages) > before, f"{before} of {count} messages"
            return list(self.messages)

    def wait_until(self, wanted: Callable[[Any], bool]) -> Any:
        """Wait for a message of which `wanted` is true."""

        def found() -> Any:
            return next((message for message in self.messages if wanted(message)), None)

        with self._changed:
            assert self._changed.wait_for(lambda: found() is not None, patience()), self.messages
            return found()

    def event(self, health: Health, words: str = "") -> HealthEvent:
        """Wait for a health event with these words in its cause."""
        event: HealthEvent = self.wait_until(
            lambda item: item.health is health and words in item.cause
        )
        return event


def health_events(bridge: Bridge) -> list[HealthEvent]:
    """Return what a bridge reports from now on."""
    events: list[HealthEvent] = []
    bridge.watch(events.append)
    return events


def until(events: list[HealthEvent], health: Health) -> HealthEvent:
    """Wait for an event of this health, and return the first."""
    wait(
        lambda: any(event.health is health for event in events),
        lambda: f"{health}: {events}",
        patience(),
    )
    return next(event for event in events if event.health is health)
