"""Health of the link and of components, as events say it: no clock, no socket."""

from __future__ import annotations

import json
from typing import Any

from attrs import frozen

from uoarm.errors import ControlMessageError, MessageError
from uoarm.model import Budget, Health
from uoarm_mqtt._codec import PayloadCodec
from uoarm_mqtt._options import PresenceOptions

__all__ = ["ComponentPresence", "Disconnection", "PresenceStatus"]

_SMALL = Budget(octets=16_384, elements=1000, depth=16)


class Disconnection:
    """The states of a link: not up yet, up, down, given up. Times are in seconds of one clock."""

    def __init__(self, grace: float) -> None:
        self._grace = grace
        self._since: float | None = None  # down since then; None where nothing was reported
        self._was_up = False
        self._reported: Health | None = None

    @property
    def is_over(self) -> bool:
        """Whether the link was given up."""
        return self._reported is Health.LOST

    def up(self) -> Health | None:
        """The link carries messages; returns what to report, None for nothing."""
        self._was_up, self._since = True, None
        return self._report(Health.OK if self._reported is not None else None)

    def down(self, now: float, *, final: bool) -> Health | None:
        """The link broke, or an attempt to mend it failed; `final`: no attempt will do better."""
        if not self._was_up:
            # What no client has relied upon yet is not lost: a client that asks for it is refused.
            # When it comes up later, that is news.
            self._reported = self._reported or Health.DEGRADED
            return None
        self._since = now if self._since is None else self._since
        if final or now - self._since >= self._grace:
            return self._report(Health.LOST)
        return self._report(Health.DEGRADED)

    def _report(self, health: Health | None) -> Health | None:
        if health is self._reported or (self.is_over and health is Health.DEGRADED):
            return None
        self._reported = None if health is Health.OK else health
        return health


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
