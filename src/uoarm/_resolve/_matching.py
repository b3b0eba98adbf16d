"""Matching: which discovered ports fulfil what a function needs, and in which order."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from fnmatch import fnmatchcase

from attrs import frozen

from uoarm._resolve._proofs import Proofs
from uoarm.model import (
    BridgeFindings,
    BridgeSpec,
    Component,
    Endpoint,
    FoundComponent,
    FoundPort,
    Function,
    MessageStructure,
    Need,
    Role,
)

_LONGEST_NAME = 256


@frozen(eq=False)
class DiscoveredPort:
    """A discovered port that may provide a function.

    Attributes:
        rank: less is better; the last part of it is its name.
        why: the rules by which it stands there.
    """

    spec: BridgeSpec
    found: FoundComponent
    port: FoundPort
    rank: tuple[object, ...]
    why: str

    @property
    def alike(self) -> tuple[object, ...]:
        """What ranks it, but for its name."""
        return self.rank[:-1]


def candidate_name(function: str, bridge: str, found: FoundComponent, port: FoundPort) -> str:
    """Return the name of a candidate, which is never that of a configured component."""
    plain = found.name.lstrip("/")
    end = "" if port.endpoint.port == "default" else f":{port.endpoint.port}"
    return f"{function}@{bridge}/{plain}{end}"


def references(
    function: Function, findings: Iterable[BridgeFindings], of_function: Iterable[MessageStructure]
) -> tuple[MessageStructure, ...]:
    """Return the structures that a stream is compared with; `like` may have several by one name.

    Args:
        function: with needs.
        findings: what bridges see.
        of_function: structures of the function that `like` names, where it names one.
    """
    need = function.needs
    assert need is not None, "the caller looked"
    if need.structure is not None:
        return (need.structure,)
    named = tuple(of_function)
    if named or not need.like:
        return named
    seen = (
        port.message
        for finding in findings
        for component in finding.components
        for port in component.ports
        if port.message is not None and port.message.native_type == need.like
    )
    return tuple({structure.fingerprint: structure for structure in seen}.values())


def offers(
    function: Function,
    findings: Iterable[BridgeFindings],
    bridges: Mapping[str, BridgeSpec],
    wanted: tuple[MessageStructure, ...],
    proofs: Proofs,
) -> tuple[list[DiscoveredPort], list[tuple[str, str]]]:
    """Return the ports that fit, best first, and those that were passed over with the reason."""
    need = function.needs
    assert need is not None, "the caller looked"
    named = {_place(end) for component in function.components for end in _ends(component)}
    fitting: list[DiscoveredPort] = []
    passed = list(_without_ports(function, findings, bridges))
    for spec, found, port in _looked_at(need, findings, bridges):
        name = candidate_name(function.name, spec.name, found, port)
        if _place(port.endpoint) in named:
            continue
        if len(name) > _LONGEST_NAME or not name.isprintable():
            passed.append((name[:_LONGEST_NAME], "its name is too long, or cannot be printed"))
            continue
        if need.like and not wanted:
            passed.append((name, f"nothing that is known has messages like {need.like}"))
            continue
        refused, exact = _judged(need, port, wanted, proofs)
        if refused:
            passed.append((name, refused))
            continue
        rank, text = _rank(need, spec, found, port, is_exact=exact)
        fitting.append(DiscoveredPort(spec, found, port, (*rank, name), text))
    fitting.sort(key=lambda item: item.rank)
    return fitting, sorted(passed)


def _without_ports(
    function: Function, findings: Iterable[BridgeFindings], bridges: Mapping[str, BridgeSpec]
) -> Iterator[tuple[str, str]]:
    """Yield components of the right name that show no port, with what is said of them."""
    names = function.needs.names if function.needs is not None else ()
    for finding in findings:
        for found in finding.components if finding.bridge in bridges else ():
            if not found.ports and _first(names, (found.name, found.name.lstrip("/"))) is not None:
                name = f"{function.name}@{finding.bridge}/{found.name.lstrip('/')}"
                if len(name) <= _LONGEST_NAME and name.isprintable():
                    yield name, found.detail or "it shows no port"


def _looked_at(
    need: Need, findings: Iterable[BridgeFindings], bridges: Mapping[str, BridgeSpec]
) -> Iterator[tuple[BridgeSpec, FoundComponent, FoundPort]]:
    """Yield the ports that are of the right kind, by role, framework, names and labels."""
    for finding in findings:
        spec = bridges.get(finding.bridge)
        if spec is None or {spec.name, spec.plugin} & set(need.exclude):
            continue
        for found in finding.components:
            if _first(need.names, (found.name, found.name.lstrip("/"))) is None:
                continue
            if _first(need.labels, (found.detail,)) is None:
                continue
            for port in found.ports:
                end = port.endpoint
                if (
                    end.role is need.role
                    and _first(need.ports, (end.port, *end.address)) is not None
                ):
                    yield spec, found, port


def _judged(
    need: Need, port: FoundPort, wanted: tuple[MessageStructure, ...], proofs: Proofs
) -> tuple[str, bool]:
    """Say why a port does not fit, or nothing; and whether it has the very structure."""
    if need.role is Role.SERVICE:
        pairs = ((need.request, port.request), (port.reply, need.reply))
        if need.like:  # a type of services is found by its request's or its reply's name
            types = {
                structure.native_type
                for structure in (port.request, port.reply)
                if structure is not None
            }
            return ("" if need.like in types else f"it is no {need.like}"), True
        if (need.request and not port.request) or (need.reply and not port.reply):
            return "its structure is not known", False
        reports = [
            proofs.refusal(structure, other) for structure, other in pairs if structure and other
        ]
        return "; ".join(filter(None, reports)), all(
            structure == other for structure, other in pairs if structure and other
        )
    if port.message is None:
        return "its structure is not known", False
    if not wanted:
        return "", False
    refusals = []
    for structure in wanted:
        if structure.schema == port.message.schema:
            return "", True
        pair = (port.message, structure) if need.role is Role.OUTPUT else (structure, port.message)
        refusals.append(proofs.refusal(*pair))
    return ("" if "" in refusals else refusals[0]), False


def _rank(
    need: Need, spec: BridgeSpec, found: FoundComponent, port: FoundPort, *, is_exact: bool
) -> tuple[tuple[object, ...], str]:
    preferred = _index(need.prefer, (spec.name, spec.plugin))
    is_elsewhere = "machine" in (spec.host or {})
    is_hosted = spec.host is not None
    by_name = _first(need.names, (found.name, found.name.lstrip("/"))) or 0
    by_port = _first(need.ports, (port.endpoint.port, *port.endpoint.address)) or 0
    by_label = _first(need.labels, (found.detail,)) or 0
    reports = [
        f"preferred {spec.name}" if preferred < len(need.prefer) else "",
        "exact structure" if is_exact else "contained structure",
        f"machine {spec.host['machine']}" if is_elsewhere and spec.host else "this machine",
        "hosted" if is_hosted else "native",
        f"name {need.names[by_name]}" if need.names else "",
        f"port {need.ports[by_port]}" if need.ports else "",
        f"label {need.labels[by_label]}" if need.labels else "",
    ]
    rank = (preferred, not is_exact, is_elsewhere, is_hosted, by_name, by_port, by_label)
    return rank, ", ".join(filter(None, reports))


def _index(words: tuple[str, ...], names: tuple[str, ...]) -> int:
    return next((number for number, word in enumerate(words) if word in names), len(words))


def _first(patterns: tuple[str, ...], texts: tuple[str, ...]) -> int | None:
    """Return the number of the first pattern that a text matches; 0 where there are none."""
    if not patterns:
        return 0
    numbers = (
        n for n, pattern in enumerate(patterns) if any(fnmatchcase(t, pattern) for t in texts)
    )
    return next(numbers, None)


def _ends(component: Component) -> Iterator[Endpoint]:
    services = () if component.service is None else (component.service,)
    for port in (*component.inputs, *component.outputs, *services):
        yield port.endpoint


def _place(end: Endpoint) -> tuple[str, Role, tuple[str, ...]]:
    return end.bridge, end.role, end.address
