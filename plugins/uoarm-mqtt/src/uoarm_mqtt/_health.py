"""Health of components, as their topics say it: no clock, no socket."""

from __future__ import annotations

import json
from typing import Any

from attrs import frozen

from uoarm.errors import ControlMessageError, MessageError
from uoarm.model import Budget, Health
from uoarm_mqtt._codec import PayloadCodec
from uoarm_mqtt._options import PresenceOptions

__all__ = ["ComponentPresence", "PresenceStatus"]

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
            text = f"what cannot be read ({type(error).__name__}: {error})"
            return cls(Health.LOST, f"{options.topic} says {text}")
        cause = f"{options.topic} says {json.dumps(value)[:80]}"
        if value == options.online:
            return cls(Health.OK, cause)
        return cls(Health.FINISHED if value == options.finished else Health.LOST, cause)


class ComponentPresence:
    """Which changes of a component's presence are reported: that it comes, and that it goes."""

    def __init__(self, options: PresenceOptions) -> None:
        self._options = options
        self._health = Health.LOST

    def changed(self, payload: bytes) -> PresenceStatus | None:
        """Take what stands on the topic now; returns what to report, None for nothing."""
        status = PresenceStatus.read(self._options, payload)
        before, self._health = self._health, status.health
        is_news = status.health is not before and Health.OK in {status.health, before}
        return status if is_news else None
