"""What can be had now: functions with their candidates, offered functions, and what bridges see."""

from __future__ import annotations

import json
from collections.abc import Mapping
from enum import Enum

from attrs import field, frozen

from uoarm.model._component import Endpoint, Meaning
from uoarm.model._message import MessageStructure, QueuePolicy, exact
from uoarm.model._wire import to_json

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
    mapping: Mapping[str, object] | None = field(default=None, eq=exact, hash=False)
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
    request_mapping: Mapping[str, object] | None = field(default=None, eq=exact, hash=False)
    reply_mapping: Mapping[str, object] | None = field(default=None, eq=exact, hash=False)
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

    @property
    def addresses(self) -> tuple[tuple[str, ...], ...]:
        """The addresses of its endpoints, each once: the parts of an action have one."""
        return tuple(dict.fromkeys(endpoint.address for endpoint in self.endpoints))


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
        endpoints: the addresses where it is found, each once, in the order of the configuration.
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
    """One candidate for a function.

    Attributes:
        component: its name.
        bridge: through which it is reached.
        priority: of it.
        cause: why it cannot be had, empty when it can.
        notes: what a plan with it would say, such as that it is a recording.
    """

    component: str
    bridge: str
    priority: int
    cause: str = ""
    notes: tuple[str, ...] = ()


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
        state = "unavailable" if self.provider is None else f"from {self.provider}"
        lines = [f"{self.name}  {state}"]
        for candidate in self.candidates:
            mark = "*" if candidate.component == self.provider else " "
            text = candidate.cause or "; ".join(("available", *candidate.notes))
            lines.append(
                f"  {mark} {candidate.priority:>4}  {candidate.component}"
                f"  ({candidate.bridge})  {text}"
            )
        if self.provider is None and not any(candidate.cause for candidate in self.candidates):
            lines.append(f"  {self.cause}")
        return "\n".join(lines)


_ONCE = 40
"""Characters of a detail from which on it is said once, and another component refers to it."""


@frozen
class FoundPort:
    """A port that a bridge sees now.

    Attributes:
        endpoint: where it is, as the configuration would name it.
        message: its structure; None where the framework does not know, and for services.
        request: that of a service's request.
        reply: that of its reply.
        used_by: components of the configuration that have this endpoint.
        rate: messages a second that come out of it: as measured while the robot has it open, else
            as the framework states it; None where it is not known. Findings that differ in rates
            only are equal.
        is_measured: whether the rate was.
    """

    endpoint: Endpoint
    message: MessageStructure | None = None
    request: MessageStructure | None = None
    reply: MessageStructure | None = None
    used_by: tuple[str, ...] = ()
    rate: float | None = field(default=None, eq=False)
    is_measured: bool = field(default=False, eq=False)

    def __str__(self) -> str:
        end = self.endpoint
        text = f"{end.role.value:<7} {', '.join(end.address)}"
        if end.parameters:
            text += f"  {json.dumps(to_json(end.parameters))}"
        if self.message is None and self.request is None:
            text += "  (structure unknown)"
        if self.rate is not None:
            text += f"  {self.rate:.3g} a second" + ("" if self.is_measured else ", as stated")
        return text + (f"  used by {', '.join(self.used_by)}" if self.used_by else "")


@frozen
class FoundComponent:
    """A component that a bridge sees now.

    Attributes:
        name: as its framework names it.
        detail: what else the framework says of it.
    """

    name: str
    ports: tuple[FoundPort, ...]
    detail: str = ""


@frozen
class BridgeFindings:
    """What one bridge sees now.

    Attributes:
        bridge: its name.
        plugin: that made it.
        components: what it sees, by name.
        cause: why it sees nothing; empty where it does.
        error_code: of the cause, of `uoarm.error_codes`; empty where there is none.
        left_out: ports beyond the limit, which are not among the components.

    As text (`str`, `print`) it is what `uoarm discover` shows.
    """

    bridge: str
    plugin: str
    components: tuple[FoundComponent, ...] = ()
    cause: str = ""
    left_out: int = 0
    error_code: str = ""

    def __str__(self) -> str:
        if self.cause:
            return f"{self.bridge}  {self.cause}"
        s = "" if len(self.components) == 1 else "s"
        lines = [f"{self.bridge}  {len(self.components)} component{s}"]
        said: dict[str, str] = {}
        for component in self.components:
            detail = component.detail
            if len(detail) > _ONCE and said.setdefault(detail, component.name) != component.name:
                detail = f"the same as {said[detail]}"
            lines.append(f"  {component.name}" + (f"  ({detail})" if detail else ""))
            lines += [f"    {port}" for port in component.ports]
        if self.left_out:
            lines.append(f"  and {self.left_out:,} ports more, beyond the limit")
        return "\n".join(lines)
