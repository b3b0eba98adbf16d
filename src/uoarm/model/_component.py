"""Functions, the components that provide them, and the endpoints where bridges reach these."""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum
from functools import cached_property
from types import MappingProxyType

from attrs import field, frozen

from uoarm.model._command import CommandPolicy
from uoarm.model._message import MessageStructure, Options, QueuePolicy, exact

_NOTHING: Mapping[str, object] = MappingProxyType({})


class Role(Enum):
    """What a component does at an endpoint, seen from the component."""

    INPUT = "input"
    OUTPUT = "output"
    SERVICE = "service"

    __hash__ = object.__hash__  # members are singletons; by name it costs ten times as much


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
        command: how it is kept safe, for an input that moves something; None for any other.
        is_offered: whether a function is offered here: no peer in the framework has to be there.
    """

    bridge: str
    component: str
    role: Role
    address: tuple[str, ...]
    port: str = "default"
    options: Options = field(default=_NOTHING, hash=False)
    parameters: Options = field(default=_NOTHING, eq=exact, hash=False)
    command: CommandPolicy | None = None
    is_offered: bool = False

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


class MeaningLevel(Enum):
    """What must be known of the meaning of what passes between two components."""

    STRICT = "strict"
    STATED = "stated"
    OFF = "off"


@frozen
class Meaning:
    """How the meaning of what passes is judged, after its shape.

    Attributes:
        level: `STATED`: what both sides state must agree; `STRICT`: both must state it, too;
            `OFF`: shape alone.
        alike: names of nominal types that stand for the same, beside those that uoarm knows.
    """

    level: MeaningLevel = MeaningLevel.STATED
    alike: tuple[frozenset[str], ...] = ()


@frozen
class Input:
    """A stream that a component takes, from another function or from the application.

    Attributes:
        source: the output that feeds it; None when the application does, with `send`.
        mapping: the adapter as written in the configuration (`map`), None to pass unchanged.
        allow_loss: fields of the source that may be dropped on the way, by path.
        queue: what to do when the component is slower than its source; None: the default.
        meaning: how the meaning of what its source emits is judged.
    """

    name: str
    endpoint: Endpoint
    source: PortRef | None = None
    mapping: Mapping[str, object] | None = field(default=None, eq=exact, hash=False)
    allow_loss: tuple[str, ...] = ()
    declared: MessageStructure | None = None
    queue: QueuePolicy | None = None
    meaning: Meaning = Meaning()


@frozen
class Service:
    """A request and its reply."""

    endpoint: Endpoint
    request: MessageStructure | None = None
    reply: MessageStructure | None = None


@frozen
class Match:
    """Why a component that the configuration does not name is a candidate.

    Attributes:
        why: the rules by which it is one, and stands where it does.
        structures: fingerprints of its structures when it was matched.
    """

    why: str = field(eq=False)
    structures: tuple[str, ...] = ()


@frozen(slots=False)  # as `Plan`
class Component:
    """One provider of a function in one framework.

    It has inputs and outputs, or a service. Among the candidates of a function the highest
    priority is tried first; equal priorities are tried in the order of the file.

    Attributes:
        match: why it is a candidate, where it was discovered and not named; else None.
    """

    name: str
    function: str
    bridge: str
    priority: int = 0
    inputs: tuple[Input, ...] = ()
    outputs: tuple[Output, ...] = ()
    service: Service | None = None
    parameters: Options = field(default=_NOTHING, eq=exact, hash=False)
    match: Match | None = None

    def output(self, port: str | None) -> Output | None:
        """Return the named output, or the only (else the `default`) one for None."""
        if port is None and len(self.outputs) == 1:
            return self.outputs[0]
        wanted = port or "default"
        for output in self.outputs:
            if output.name == wanted:
                return output
        return None

    def input(self, port: str) -> Input:
        """Return the named input.

        Raises:
            KeyError: there is none.
        """
        for input_ in self.inputs:
            if input_.name == port:
                return input_
        raise KeyError(port)

    @cached_property
    def endpoints(self) -> tuple[Endpoint, ...]:
        """Those of its inputs and its outputs."""
        inputs = (input_.endpoint for input_ in self.inputs)
        return (*inputs, *(output.endpoint for output in self.outputs))


@frozen
class Need:
    """What a function asks of components that bridges discover.

    Patterns are those of `fnmatch`, case counts. An earlier one ranks higher.

    Attributes:
        role: of the port that provides the function.
        structure: its messages fit this one (an input takes all of it).
        request: of a service, every one of which it takes.
        reply: of a service, which every reply of it fits.
        like: in place of `structure`, a function whose messages it has, or a framework's own name
            of their type.
        names: patterns of the component's name, as its framework has it; none: any.
        ports: patterns of the port's name or of a part of its address; none: any.
        labels: patterns of what else the framework says of the component; none: any.
        prefer: plugins or bridges that rank before others, in this order.
        exclude: plugins or bridges that provide nothing here.
        unfed: patterns of inputs that may stay without a feed.
        from_application: patterns of inputs that no function feeds: the application sends to them.
        mapping: where fields of its inputs come from that no proof finds, as in `map`; for inputs
            that have those fields.
        options: settings of its ports, for the bridge, over those that discovery found.
        refuse_ambiguous: whether none is taken of several that differ in nothing but their names.
    """

    role: Role = Role.OUTPUT
    structure: MessageStructure | None = None
    request: MessageStructure | None = None
    reply: MessageStructure | None = None
    like: str = ""
    names: tuple[str, ...] = ()
    ports: tuple[str, ...] = ()
    labels: tuple[str, ...] = ()
    prefer: tuple[str, ...] = ()
    exclude: tuple[str, ...] = ()
    unfed: tuple[str, ...] = ()
    from_application: tuple[str, ...] = ()
    mapping: Options = field(factory=dict, eq=exact, hash=False)
    options: Options = field(factory=dict, hash=False)
    refuse_ambiguous: bool = False


@frozen
class Function:
    """What an application asks for by name.

    Attributes:
        components: in the order in which they are tried.
        needs: what makes a discovered component a candidate too; None: nothing does.
        passed_over: what was discovered and is no candidate, by name, each with the reason.
        approve: whether an agent uses it only with the approval of a person.
    """

    name: str
    components: tuple[Component, ...]
    description: str = ""
    needs: Need | None = None
    passed_over: tuple[tuple[str, str], ...] = ()
    approve: bool = False
