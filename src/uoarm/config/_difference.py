"""What is different between two configurations, as far as connections that run are concerned."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from attrs import evolve, frozen

from uoarm.model import BridgeSpec, Component, Listening, Offer, Robot

_CODE = "code"
_PLUGIN = "python"


def without_code(spec: BridgeSpec) -> BridgeSpec:
    """Return a bridge as its configuration has it, whichever version of the code it runs."""
    if _CODE not in spec.assigned:
        return spec
    options = {name: option for name, option in spec.options.items() if name != _CODE}
    assigned = {name: value for name, value in spec.assigned.items() if name != _CODE}
    return evolve(spec, options=options, assigned=assigned)


def with_code(robot: Robot, running: Robot | None, version: str = "") -> Robot:
    """Return a configuration whose Python components run this version of their code.

    Args:
        robot: the configuration.
        running: the one in force, whose bridges go on with the version that they have; None:
            none is in force, and none has a version.
        version: hexadecimal digits, for all bridges; "": as they run.
    """
    bridges = {name: without_code(bridge) for name, bridge in robot.bridges.items()}
    for name, spec in bridges.items():
        old = None if running is None else running.bridges.get(name)
        chosen = version or ("" if old is None else old.assigned.get(_CODE, ""))
        if spec.plugin == _PLUGIN and chosen and _CODE not in spec.options:
            code = {_CODE: chosen}
            bridges[name] = evolve(
                spec, options={**spec.options, **code}, assigned={**spec.assigned, **code}
            )
    return evolve(robot, bridges=bridges)


@frozen
class ConfigurationDifference:
    """What another configuration has in place of one before.

    Attributes:
        bridges: names of those that were added, taken away or are others.
        superseded: components of the one before that are gone or are others, as are those of a
            bridge that is another. A priority alone makes no other component.
        functions: those for which a request may get another plan, since they, or what they are
            fed by, have other candidates or another order of them.
        changes: every difference as a line, `+ component x`, `- bridge y`, `~ function z`,
            `~ hosts tls/192.168.1.10:7447`.
    """

    bridges: frozenset[str]
    superseded: frozenset[str]
    functions: frozenset[str]
    changes: tuple[str, ...]


def compare(before: Robot, after: Robot) -> ConfigurationDifference:
    """Return what is different; nothing of the origin, the warnings or the descriptions is."""
    bridges = _differing(before.bridges, after.bridges)
    old = {component.name: _unranked(component) for component in before.components()}
    new = {component.name: _unranked(component) for component in after.components()}
    of_bridges = {component.name for component in old.values() if component.bridge in bridges}
    superseded = frozenset((_differing(old, new) & set(old)) | of_bridges)
    own = {
        name
        for name in {*before.functions, *after.functions}
        if _candidates(before, name) != _candidates(after, name)
        or any(candidate.name in superseded for candidate in _candidates(before, name))
    }
    reports = (
        *_changes_of("hosts", _listening(before), _listening(after)),
        *(
            f"{line}: its code" if _is_code(line, before, after) else line
            for line in _changes_of("bridge", before.bridges, after.bridges)
        ),
        *_changes_of("component", old, new),
        *_changes_of("function", _named(before), _named(after)),
        *(() if before.failover == after.failover else ("~ failover",)),
        *(() if before.lock == after.lock else ("~ lock",)),
        *(() if before.record == after.record else ("~ record",)),
        *_changes_of("offer", _offers(before), _offers(after)),
        *(() if before.applications == after.applications else ("~ applications",)),
        *(() if before.exports == after.exports else ("~ export",)),
    )
    functions = fed_by(own, (*before.components(), *after.components()))
    return ConfigurationDifference(bridges, superseded, functions, reports)


def _is_code(line: str, before: Robot, after: Robot) -> bool:
    """Say whether all that is different of a bridge is that its code is read again."""
    name = line.partition(" bridge ")[2]
    old, new = before.bridges.get(name), after.bridges.get(name)
    return old is not None and new is not None and without_code(old) == without_code(new)


def _candidates(robot: Robot, function: str) -> tuple[Component, ...]:
    found = robot.functions.get(function)
    return () if found is None else found.components


def _unranked(component: Component) -> Component:
    return evolve(component, priority=0)


def _offers(robot: Robot) -> Mapping[str, Offer]:
    return {offer.name: offer for offer in robot.offers}


def _listening(robot: Robot) -> Mapping[str, Listening]:
    return {} if robot.hosts is None else {robot.hosts.place: robot.hosts}


def _named(robot: Robot) -> Mapping[str, object]:
    """Return each function's candidates by name, its needs, and whether agents need an approval."""
    return {
        name: (
            function.approve,
            function.needs,
            [(component.name, component.priority) for component in function.components],
        )
        for name, function in robot.functions.items()
    }


def _differing(
    before: Mapping[str, BridgeSpec] | Mapping[str, Component],
    after: Mapping[str, BridgeSpec] | Mapping[str, Component],
) -> frozenset[str]:
    return frozenset(name for name in {*before, *after} if before.get(name) != after.get(name))


def _changes_of(
    kind: str, before: Mapping[str, object], after: Mapping[str, object]
) -> Iterable[str]:
    for name in dict.fromkeys((*before, *after)):
        if name not in after:
            yield f"- {kind} {name}"
        elif name not in before:
            yield f"+ {kind} {name}"
        elif before[name] != after[name]:
            yield f"~ {kind} {name}"


def fed_by(functions: Iterable[str], components: Iterable[Component]) -> frozenset[str]:
    """Return the functions, and those whose plans may have one of them."""
    consumers: dict[str, set[str]] = {}
    for component in components:
        for port in component.inputs:
            if port.source is not None:
                consumers.setdefault(port.source.function, set()).add(component.function)
    found, waiting = set(functions), list(functions)
    while waiting:
        more = consumers.get(waiting.pop(), set()) - found
        found |= more
        waiting += more
    return frozenset(found)
