"""What can be had now: functions and their candidates, and functions offered in a framework."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum

from attrs import field, frozen

from uoarm.model._component import Endpoint, Meaning
from uoarm.model._message import MessageStructure, QueuePolicy

__all__ = [
    "Availability",
    "FunctionStatus",
    "Offer",
    "OfferState",
    "OfferStatus",
    "OfferedPort",
    "OfferedService",
]

_STATED = Meaning()


@frozen
class OfferedPort:
    """One output or input of a function, and where a framework finds it.

    An output is a sink of the bridge, whose endpoint has the role `input`; an input is a source.

    Attributes:
        name: of the function's port; `default` is the only one, or the one of that name.
        endpoint: where the bridge opens it.
        mapping: the adapter, for messages as they leave or enter; None to pass them unchanged.
        allow_loss: fields that may be dropped on the way, by path.
        declared: the structure in the framework, where the configuration says it.
        queue: of an output, what to do when the framework is slower; None: the default.
        meaning: how the meaning of what passes is judged.
    """

    name: str
    endpoint: Endpoint
    mapping: Mapping[str, object] | None = field(default=None, hash=False)
    allow_loss: tuple[str, ...] = ()
    declared: MessageStructure | None = None
    queue: QueuePolicy | None = None
    meaning: Meaning = _STATED


@frozen
class OfferedService:
    """The service of a function, and where a framework finds it.

    Attributes:
        endpoint: where the bridge serves it.
        request: structure of what callers send, where the configuration says it.
        reply: structure of what they get, where the configuration says it.
        request_mapping: the adapter from a caller's request to the function's.
        reply_mapping: the adapter from the function's reply to what callers get.
        request_losses: fields of a caller's request that may be dropped, by path.
        reply_losses: fields of the function's reply that may be dropped, by path.
        timeout: seconds that one call may take.
        meaning: how the meaning of both messages is judged.
    """

    endpoint: Endpoint
    request: MessageStructure | None = None
    reply: MessageStructure | None = None
    request_mapping: Mapping[str, object] | None = field(default=None, hash=False)
    reply_mapping: Mapping[str, object] | None = field(default=None, hash=False)
    request_losses: tuple[str, ...] = ()
    reply_losses: tuple[str, ...] = ()
    timeout: float = 10.0
    meaning: Meaning = _STATED


@frozen
class Offer:
    """One function in one framework: some of its outputs and inputs, or its service."""

    bridge: str
    function: str
    outputs: tuple[OfferedPort, ...] = ()
    inputs: tuple[OfferedPort, ...] = ()
    service: OfferedService | None = None

    @property
    def name(self) -> str:
        """What the status and events show: no component can have this name."""
        return f"{self.bridge}:{self.function}"

    @property
    def endpoints(self) -> tuple[Endpoint, ...]:
        """Where the bridge opens it."""
        ports = (output.endpoint for output in (*self.outputs, *self.inputs))
        return (*ports, *(() if self.service is None else (self.service.endpoint,)))


class OfferState(Enum):
    """Whether a function is there for a framework; one that failed is tried again.

    FINISHED is an orderly end: its source has nothing more to say, and is not played again.
    """

    OPENING = "opening"
    OPEN = "open"
    FAILED = "failed"
    FINISHED = "finished"
    CLOSED = "closed"


@frozen
class OfferStatus:
    """One offer, as it is now.

    Attributes:
        name: `BRIDGE:FUNCTION`.
        endpoints: the addresses where it is found, in the order of the configuration.
        connections: ids of the connections behind it; services have none.
        calls: of a service, calls that were answered.
        failed: of a service, calls that were not.
        cause: why it is not open, or what its bridge says is wrong with it.
    """

    name: str
    function: str
    bridge: str
    state: OfferState
    endpoints: tuple[tuple[str, ...], ...] = ()
    connections: tuple[str, ...] = ()
    calls: int = 0
    failed: int = 0
    cause: str = ""


@frozen
class Availability:
    """One candidate for a function; `cause` says why it cannot be had, empty when it can."""

    component: str
    bridge: str
    priority: int
    cause: str = ""


@frozen
class FunctionStatus:
    """One function as a request would find it now.

    Attributes:
        name: the function.
        provider: the component that a request would get, None when no plan fits.
        candidates: its components in the order in which they are tried.
        cause: why no plan fits, empty when one does.

    As text (`str`, `print`) it is what `uoarm status` shows.
    """

    name: str
    provider: str | None
    candidates: tuple[Availability, ...]
    cause: str = ""

    def __str__(self) -> str:
        state = "cannot be had" if self.provider is None else f"from {self.provider}"
        lines = [f"{self.name}  {state}"]
        for candidate in self.candidates:
            mark = "*" if candidate.component == self.provider else " "
            text = candidate.cause or "available"
            lines.append(
                f"  {mark} {candidate.priority:>4}  {candidate.component}"
                f"  ({candidate.bridge})  {text}"
            )
        if self.provider is None and not any(candidate.cause for candidate in self.candidates):
            lines.append(f"  {self.cause}")
        return "\n".join(lines)
