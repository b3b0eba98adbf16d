"""What a bridge knows of an endpoint, of itself, and of what happens to it: plain values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from attrs import evolve, field, frozen

from uoarm.bridge._channel import Channel
from uoarm.model import Endpoint, Health, MessageStructure

__all__ = ["Capabilities", "Description", "Discovered", "HealthEvent", "ServiceStructures"]


_ANYTHING = MessageStructure(schema=True)


@frozen
class Description:
    """The message structures of one endpoint.

    A stream has `message`; a service has `request` and `reply`. None where the framework does
    not know: the configuration must then declare the structure, unless what `hint` says is done.

    Attributes:
        hint: what would have the framework know what it does not: a sentence without a full stop.
        note: what a careful reader of a plan should know of the endpoint, such as what is lost
            there without a word: a sentence without a full stop.
        managers: identities of the managers through which its messages pass, the nearest first.
        limits: keywords that hold of whatever is sent there, also where the configuration declares
            another structure: `x-max-json`, `x-max-octets` and `x-nonfinite: false`.
    """

    message: MessageStructure | None = None
    request: MessageStructure | None = None
    reply: MessageStructure | None = None
    hint: str = ""
    note: str = ""
    limits: Mapping[str, object] = field(factory=dict, hash=False)
    managers: tuple[str, ...] = ()

    def limited(self, structure: MessageStructure) -> MessageStructure:
        """Return a structure of what is sent there, with the limits that hold of it."""
        if not self.limits or structure.schema is False:
            return structure
        own: Any = {} if structure.schema is True else structure.schema
        return evolve(structure, schema={**own, **self.limits})


@frozen
class ServiceStructures:
    """What a service takes and answers, as the plan was proven with; anything where not said."""

    request: MessageStructure = _ANYTHING
    reply: MessageStructure = _ANYTHING


@frozen
class Discovered:
    """A component that is visible now, without having been configured.

    Attributes:
        name: as the framework names it.
        endpoints: what can be opened of it.
        detail: what else the framework says of it.
        rates: messages a second that outputs give at most or as promised, by port; only what
            the framework itself states.
    """

    name: str
    endpoints: tuple[tuple[Endpoint, Description], ...]
    detail: str = ""
    rates: Mapping[str, float] = field(factory=dict, hash=False, eq=False)


@frozen
class Capabilities:
    """What a bridge can do, checked when a plan is made and never found out in motion.

    Attributes:
        discover: lists components by itself.
        call: reaches services of components.
        serve: offers a function to the framework as a service.
        link: connects two of its own endpoints without the manager in between.
        stop: an emergency stop here stops everything behind it that moves, by any client.
    """

    discover: bool = False
    call: bool = False
    serve: bool = False
    link: bool = False
    stop: bool = False


@frozen(eq=False)
class HealthEvent:
    """A change for the better or the worse that a bridge noticed by itself.

    Attributes:
        bridge: name of the instance.
        health: what it is now; `Bridge.report` says what the manager does on each.
        cause: why, in one sentence.
        channel: the channel concerned; None when it is the whole bridge or `component`.
        component: the component concerned; None when it is the channel or the whole bridge.
    """

    bridge: str
    health: Health
    cause: str
    channel: Channel | None = None
    component: str | None = None
