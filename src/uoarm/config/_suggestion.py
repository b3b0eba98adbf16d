"""Configuration for what bridges see: the lines that would name it, each feed with its proof."""

from __future__ import annotations

import glob
import re
import time
from collections.abc import Callable, Container, Iterable, Iterator

from attrs import define, evolve, field, frozen

from uoarm._support.yaml import write_flow
from uoarm.model import (
    BridgeFindings,
    FoundComponent,
    FoundPort,
    Function,
    MessageStructure,
    Need,
    Robot,
    Role,
    to_json,
)
from uoarm.schema import CheckBudget, SchemaError, check

_MOST_COMPONENTS = 500
_SHOWN = 5
_PAIR_SECONDS = 0.5
_HEAD = """\
# What bridges see and the configuration does not name yet. Read it before you use it: each `from`
# was proven to fit by the structures of the messages, which say nothing of what they mean.
"""
_PART = """\
# It is a part of that configuration and no file of its own. To add it: uoarm suggest --merge FILE
"""
_OWN_BRIDGES = "# bridges: those of the configuration"


@frozen
class _Output:
    """What can feed an input.

    Attributes:
        reference: what `from` says.
        owner: the bridge and the component, as its framework names it.
        address: within that bridge.
    """

    reference: str
    port: str
    owner: tuple[str, str]
    address: tuple[str, ...]
    structure: MessageStructure


@define
class _Proposal:
    """A component that the configuration could have, as a function of its own."""

    name: str
    bridge: str
    found: FoundComponent
    ports: list[FoundPort] = field(factory=list)

    def of(self, role: Role) -> list[FoundPort]:
        return [port for port in self.ports if port.endpoint.role is role]

    @property
    def owner(self) -> tuple[str, str]:
        return self.bridge, self.found.name


def suggest(
    robot: Robot,
    findings: Iterable[BridgeFindings],
    *,
    configured: Container[str] = (),
    only: tuple[str, str] | None = None,
    seconds: float = 10.0,
) -> str:
    """Return YAML with a function for each component that is seen and not configured.

    An input gets its `from` where exactly one output has its structure, or exactly one fits it.
    Several are listed beside it, and it is left to be fed by the application.

    Args:
        robot: the configuration so far; its names are not given again.
        findings: what the bridges see.
        configured: bridges that need no line of their own.
        only: the bridge and the component, by its framework's name, that alone is written; others
            may still feed it where the configuration has them.
        seconds: for comparing structures; what was not compared is said.
    """
    findings = [finding for finding in findings if finding.components]
    proposals = [
        proposal for proposal in _proposals(robot, findings) if only in {None, proposal.owner}
    ]
    left_out = proposals[_MOST_COMPONENTS:]
    proposals = proposals[:_MOST_COMPONENTS]
    outputs = [*_configured(robot, findings), *_proposed(proposals)]
    deadline = time.monotonic() + seconds
    new = [finding for finding in findings if finding.bridge not in configured]
    is_part = any(finding.bridge in configured for finding in findings)
    head = _HEAD + (_PART if is_part else "")
    bridges = "bridges:" if new else "bridges: {}" if not robot.bridges else _OWN_BRIDGES
    lines = [head + "version: 1", bridges]
    lines += [f"  {finding.bridge}: {{plugin: {finding.plugin}}}" for finding in new]
    lines.append("functions:" if proposals else "functions: {}  # bridges see nothing else")
    for proposal in proposals:
        lines += _lines(proposal, outputs, lambda: time.monotonic() > deadline)
    if left_out:
        lines.append(f"# and {len(left_out):,} components more, beyond the limit")
    return "\n".join(lines) + "\n"


def _proposals(robot: Robot, findings: Iterable[BridgeFindings]) -> Iterator[_Proposal]:
    """Yield components that have a port which the configuration does not name.

    What it names is not offered in another role: a function that is called as a service could be
    a consumer, too, and what publishes on a topic may subscribe to it.
    """
    taken = _names(robot)
    for finding in findings:
        for found in finding.components:
            named = {port.endpoint.address for port in found.ports if port.used_by}
            ports = [port for port in found.ports if port.endpoint.address not in named]
            streams = [port for port in ports if port.endpoint.role is not Role.SERVICE]
            if streams:
                yield _Proposal(new_name(found.name, taken), finding.bridge, found, streams)
            for service in (port for port in ports if port.endpoint.role is Role.SERVICE):
                name = new_name(f"{found.name}_{service.endpoint.port}", taken)
                yield _Proposal(name, finding.bridge, found, [service])


def _names(robot: Robot) -> dict[str, int]:
    names = (*robot.functions, *(component.name for component in robot.components()))
    return dict.fromkeys(names, 1)


def new_name(wanted: str, taken: dict[str, int]) -> str:
    """Return a name that the configuration takes and nothing has yet, and take it.

    Args:
        wanted: what it is made of.
        taken: the number of the last that was made of each name.
    """
    plain = re.sub(r"[^A-Za-z0-9_]+", "_", wanted).strip("_") or "component"
    plain = plain if plain[0].isalpha() else f"c_{plain}"
    name, number = plain, taken.get(plain, 1)
    while name in taken:
        number += 1
        name = f"{plain}_{number}"
    taken[plain] = number
    taken[name] = 1
    return name


def _configured(robot: Robot, findings: Iterable[BridgeFindings]) -> Iterator[_Output]:
    """Yield the outputs that the configuration names and a bridge sees."""
    by_name = {component.name: component for component in robot.components()}
    for finding in findings:
        for found in finding.components:
            for port in found.ports:
                for user in port.used_by if port.message is not None else ():
                    for output in by_name[user].outputs:
                        if output.endpoint.address == port.endpoint.address:
                            structure = output.declared or port.message
                            assert structure is not None, "looked at above"
                            reference = f"{by_name[user].function}.{output.name}"
                            owner = finding.bridge, found.name
                            at = port.endpoint.address
                            yield _Output(reference, output.name, owner, at, structure)


def _proposed(proposals: Iterable[_Proposal]) -> Iterator[_Output]:
    for proposal in proposals:
        outputs = proposal.of(Role.OUTPUT)
        for port in outputs:
            if port.message is not None:
                several = len(outputs) > 1
                reference = f"{proposal.name}.{_port(port)}" if several else proposal.name
                at = port.endpoint.address
                yield _Output(reference, _port(port), proposal.owner, at, port.message)


def _lines(
    proposal: _Proposal, outputs: Iterable[_Output], is_late: Callable[[], bool]
) -> Iterator[str]:
    yield f"  {proposal.name}:  # {proposal.found.name} of {proposal.bridge}"
    yield "    components:"
    yield f"      - name: {proposal.name}"
    yield f"        bridge: {proposal.bridge}"
    if parameters := proposal.ports[0].endpoint.parameters:
        yield f"        parameters: {write_flow(to_json(parameters))}"
    for service in proposal.of(Role.SERVICE):
        yield f"        service: {{endpoint: {_address(service)}}}{_unknown(service)}"
    for key, role in (("inputs", Role.INPUT), ("outputs", Role.OUTPUT)):
        ports = proposal.of(role)
        if ports:
            yield f"        {key}:"
        for port in ports:
            chosen, reason = "", list[str]()
            if role is Role.INPUT and port.message is not None:
                chosen, reason = _feed(proposal, port, port.message, outputs, is_late)
            yield from (f"          # {line}" for line in reason)
            feed = f"from: {chosen}, " if chosen else ""
            yield f"          {_port(port)}: {{{feed}endpoint: {_address(port)}}}{_unknown(port)}"


def _feed(
    proposal: _Proposal,
    port: FoundPort,
    wanted: MessageStructure,
    outputs: Iterable[_Output],
    is_late: Callable[[], bool],
) -> tuple[str, list[str]]:
    """Return what feeds an input, and what a reader should know of it."""
    here = proposal.bridge, port.endpoint.address
    others = [
        output
        for output in outputs
        if output.owner != proposal.owner and (output.owner[0], output.address) != here
    ]  # what is sent to the very topic that is subscribed to arrives there already
    fits = [output for output in others if output.structure.schema == wanted.schema]
    reason = "has its structure"
    left = 0
    if not fits:
        reason = "fits it: every message is accepted"
        for output in others:
            if is_late():
                left += 1
            elif _fits(output.structure, wanted):
                fits.append(output)
    named = [output for output in fits if output.port == _port(port)]
    fits = named if len(named) == 1 else fits
    said = [f"{left} outputs were not compared, for want of time"] if left else []
    if len(fits) == 1:
        return fits[0].reference, [*said, f"proven: {fits[0].reference} {reason}"]
    if fits:
        more = f" and {len(fits) - _SHOWN} more" if len(fits) > _SHOWN else ""
        several = ", ".join(output.reference for output in fits[:_SHOWN])
        said.append(f"from: one of {several}{more}")
    return "", said


def _fits(producer: MessageStructure, consumer: MessageStructure) -> bool:
    try:
        return check(
            producer.schema, consumer.schema, budget=CheckBudget(seconds=_PAIR_SECONDS)
        ).compatible
    except SchemaError:
        return False


def _port(port: FoundPort) -> str:
    return new_name(port.endpoint.port, {})


def _address(port: FoundPort) -> str:
    return write_flow(to_json(port.endpoint.address))


def _unknown(port: FoundPort) -> str:
    if port.message is not None or port.request is not None:
        return ""
    is_service = port.endpoint.role is Role.SERVICE
    keys = "request: SCHEMA, reply: SCHEMA" if is_service else "structure: SCHEMA"
    return f"  # not known, and must be added: {keys}; true is any"


_MOST_FUNCTIONS = 500
_ABOUT_ITSELF = "@"  # begins the names of ports that are about the component, not part of it


def add_functions(
    robot: Robot, findings: Iterable[BridgeFindings], *, unfed: tuple[str, ...] = ()
) -> Robot:
    """Return a robot with a function for each output and service that is seen and not named.

    Such a function names no component: it needs what has that name in that framework, so that it is
    fed by whatever is proven to fit, may go and come back, and says why it cannot be had. It is
    called after the component, and after the port where there are several. What is about a
    component itself, such as its state, is no function. Equal arguments give equal robots; a robot
    that has them already is returned as it is.

    Args:
        robot: the configuration, which stays as it is otherwise.
        findings: what its bridges see. Beyond five hundred functions nothing is added.
        unfed: patterns of inputs that may stay without a feed.
    """
    known = {function.needs for function in robot.functions.values() if function.needs is not None}
    taken = _names(robot)
    more: dict[str, Function] = {}
    for finding in findings:
        for found in finding.components if finding.bridge in robot.bridges else ():
            for wanted, need in _needs(finding.bridge, found, unfed):
                if need in known or len(robot.functions) + len(more) >= _MOST_FUNCTIONS:
                    continue
                name = new_name(wanted, taken)
                more[name] = Function(name, (), f"{found.name} of {finding.bridge}", needs=need)
    return evolve(robot, functions={**robot.functions, **more}) if more else robot


def _needs(
    bridge: str, found: FoundComponent, unfed: tuple[str, ...]
) -> Iterator[tuple[str, Need]]:
    """Yield what would be needed of a component, and a name for it."""
    for role in (Role.OUTPUT, Role.SERVICE):
        ports = [found_port for found_port in found.ports if found_port.endpoint.role is role]
        for found_port in ports:
            port = found_port.endpoint.port
            if found_port.used_by or port.startswith(_ABOUT_ITSELF):
                continue
            if found_port.message is None and found_port.request is None:
                continue
            need = Need(
                role=role,
                names=(glob.escape(found.name),),
                ports=(glob.escape(port),) if len(ports) > 1 else (),
                prefer=(bridge,),
                unfed=unfed if role is Role.OUTPUT else (),
            )
            is_plain = port == "default" or (len(ports) == 1 and role is Role.OUTPUT)
            yield found.name if is_plain else f"{found.name}_{port}", need
