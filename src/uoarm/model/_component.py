"""Functions, the components that provide them, and the endpoints where bridges reach these."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from types import MappingProxyType

from attrs import field, frozen

from uoarm.model._queue import QueuePolicy
from uoarm.model._structure import MessageStructure
from uoarm.model._values import Options

__all__ = [
    "Component",
    "Endpoint",
    "Expectation",
    "Function",
    "Input",
    "Output",
    "PortRef",
    "Role",
    "Service",
]

_NOTHING: Mapping[str, object] = MappingProxyType({})


class Role(Enum):
    """What a component does at an endpoint, seen from the component."""

    INPUT = "input"
    OUTPUT = "output"
    SERVICE = "service"


@frozen
class Endpoint:
    """Where a bridge finds one port of one component.

    Attributes:
        bridge: name of the bridge instance.
        component: name of the component; ports of one component share it.
        role: whether the component takes messages here, emits them, or answers requests.
        address: the strings that the framework needs (topic and type; port and data type).
        port: name of the port within the component.
        options: settings of this port (QoS, buffer policy), meaning set by the bridge.
        parameters: settings of the whole component, the same on all its endpoints.
    """

    bridge: str
    component: str
    role: Role
    address: tuple[str, ...]
    port: str = "default"
    options: Options = field(default=_NOTHING, hash=False)
    parameters: Options = field(default=_NOTHING, hash=False)

    def __str__(self) -> str:
        return f"{self.role.value} {self.port!r} of {self.component} at {list(self.address)}"


@frozen(order=True)
class PortRef:
    """One output of a function: `camera`, or `camera.depth` where it has several."""

    function: str
    port: str | None = None

    def __str__(self) -> str:
        return self.function if self.port is None else f"{self.function}.{self.port}"


@frozen
class Expectation:
    """How often an output should emit; one that stays under half of it is taken for dead.

    Attributes:
        rate: messages a second.
        patience: seconds over which they are counted.
    """

    rate: float
    patience: float = 3.0


@frozen
class Output:
    """A stream that a component emits.

    `declared`, where given, replaces the structure that the bridge describes; `expect` says how
    often it should emit.
    """

    name: str
    endpoint: Endpoint
    declared: MessageStructure | None = None
    expect: Expectation | None = None


@frozen
class Input:
    """A stream that a component takes, from another function or from the application.

    Attributes:
        source: the output that feeds it; None when the application does, with `send`.
        mapping: the adapter as written in the configuration (`map`), None to pass unchanged.
        allow_loss: fields of the source that may be dropped on the way, by path.
        queue: what to do when the component is slower than its source; None: the default.
    """

    name: str
    endpoint: Endpoint
    source: PortRef | None = None
    mapping: Mapping[str, object] | None = field(default=None, hash=False)
    allow_loss: tuple[str, ...] = ()
    declared: MessageStructure | None = None
    queue: QueuePolicy | None = None


@frozen
class Service:
    """A request and its reply."""

    endpoint: Endpoint
    request: MessageStructure | None = None
    reply: MessageStructure | None = None


@frozen
class Component:
    """One provider of a function in one framework.

    It has inputs and outputs, or a service. Among the candidates of a function the highest
    priority is tried first; equal priorities are tried in the order of the file.
    """

    name: str
    function: str
    bridge: str
    priority: int = 0
    inputs: tuple[Input, ...] = ()
    outputs: tuple[Output, ...] = ()
    service: Service | None = None
    parameters: Options = field(default=_NOTHING, hash=False)

    def output(self, port: str | None) -> Output | None:
        """Return the named output, or the only (else the `default`) one for None."""
        if port is None and len(self.outputs) == 1:
            return self.outputs[0]
        wanted = port or "default"
        return next((output for output in self.outputs if output.name == wanted), None)


@frozen
class Function:
    """What an application asks for by name.

    `components` stand in the order in which they are tried.
    """

    name: str
    components: tuple[Component, ...]
    description: str = ""
