"""Candidates without a name in the file: the configuration, and what was found and proven to fit.

Each function with needs gets the discovered components that fulfil them, behind those that the
configuration names. Their inputs are fed by functions, level by level: first those that need no
feed, then those that these can feed, so that no cycle comes about. An input waits for the function
that suits it best, as long as that is not there yet and others go on.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from fnmatch import fnmatchcase

from attrs import define, evolve, field, frozen

from uoarm._resolve._catalogue import Structures, Unavailable
from uoarm._resolve._matching import DiscoveredPort, candidate_name, offers, references
from uoarm._resolve._proofs import Adapted, Proofs
from uoarm.model import (
    BridgeFindings,
    Component,
    Endpoint,
    FoundPort,
    Function,
    Input,
    Match,
    MessageStructure,
    Need,
    Options,
    Output,
    PortRef,
    Robot,
    Role,
    Service,
)

_MOST_CANDIDATES = 32
_MOST_PASSED = 20
_NOTHING_SEEN = ("discovery", "no bridge sees a component of that kind, role and name")


@frozen
class _AvailableOutput:
    """What one function can feed inputs with.

    Attributes:
        reference: the function, or its output where it has several.
        names: under which an input may ask for it exactly.
        structures: of its candidates, best first.
        topics: names of topics that carry it already, within their frameworks.
    """

    reference: PortRef
    names: frozenset[str]
    structures: tuple[MessageStructure, ...]
    topics: frozenset[object]


@frozen
class _Feed:
    """What feeds an input: the function, and how; `rank` is less where it suits better."""

    rank: tuple[bool, bool, bool, bool]
    given: _AvailableOutput
    adapted: Adapted


@define
class _Level:
    """A function with needs while its candidates find their feeds."""

    function: Function
    offers: list[DiscoveredPort]
    passed: list[tuple[str, str]]
    made: dict[int, Component] = field(factory=dict)
    causes: dict[int, str] = field(factory=dict)


def without_candidates(robot: Robot) -> Robot:
    """Return a robot with what its configuration names, and nothing that was discovered."""
    functions = {
        name: evolve(
            function,
            components=tuple(c for c in function.components if c.match is None),
            passed_over=(),
        )
        for name, function in robot.functions.items()
    }
    return evolve(robot, functions=functions)


def add_candidates(
    robot: Robot,
    findings: Iterable[BridgeFindings],
    *,
    structures: Callable[[Component], Structures | Unavailable],
    topic: Callable[[Endpoint], object],
    proofs: Proofs,
) -> Robot:
    """Return the robot with what was discovered and fulfils its needs.

    Equal arguments give equal robots, whatever the order of the findings.

    Args:
        robot: the configuration, with or without candidates of before, which count for nothing.
        findings: what bridges see.
        structures: returns those of configured components; asks bridges.
        topic: returns the topic that an endpoint stands for; None where there is none.
        proofs: judges pairs of structures.
    """
    robot = without_candidates(robot)
    if not any(function.needs for function in robot.functions.values()):
        return robot
    return _Matching(robot, findings, structures, topic, proofs).run()


def keep_candidates(robot: Robot, kept: Iterable[Component]) -> Robot:
    """Return the robot with candidates that stay as they are, whatever was discovered meanwhile.

    Args:
        robot: the configuration with its candidates.
        kept: candidates of functions, which take the places of those of their names; where their
            function has no needs they count for nothing.
    """
    functions = dict(robot.functions)
    for component in kept:
        function = functions.get(component.function)
        if function is None or function.needs is None:
            continue
        components = {component.name: component for component in function.components} | {
            component.name: component
        }
        passed = tuple(pair for pair in function.passed_over if pair != _NOTHING_SEEN)
        functions[component.function] = evolve(
            function, components=tuple(components.values()), passed_over=passed
        )
    return evolve(robot, functions=functions)


def carry_candidates(before: Robot, base: Robot) -> Robot:
    """Return a configuration with the candidates of another that may be its own, too."""
    functions = dict(base.functions)
    for name, function in base.functions.items():
        old = before.functions.get(name)
        if function.needs is None or old is None or old.needs != function.needs:
            continue
        still = tuple(
            component
            for component in old.components
            if component.match is not None
            and before.bridges.get(component.bridge) == base.bridges.get(component.bridge)
            and all(
                input_.source is None or input_.source.function in functions
                for input_ in component.inputs
            )
        )
        functions[name] = evolve(
            function, components=(*function.components, *still), passed_over=old.passed_over
        )
    return evolve(base, functions=functions)


class _Matching:
    def __init__(
        self,
        robot: Robot,
        findings: Iterable[BridgeFindings],
        structures: Callable[[Component], Structures | Unavailable],
        topic: Callable[[Endpoint], object],
        proofs: Proofs,
    ) -> None:
        self._robot = robot
        self._findings = sorted(findings, key=lambda finding: finding.bridge)
        self._structures = structures
        self._topic = topic
        self._proofs = proofs
        self._levels: dict[str, _Level] = {}
        self._given: dict[str, list[_AvailableOutput]] = {}
        self._sources: dict[str, set[str]] = {}
        for component in robot.components():
            self._add_sources(component)
        self._emitted = {
            (finding.bridge, report): found.name
            for finding in self._findings
            for found in finding.components
            for port in found.ports
            if port.endpoint.role is Role.OUTPUT and (report := topic(port.endpoint)) is not None
        }

    def run(self) -> Robot:
        for name, function in self._robot.functions.items():
            if function.needs is not None:
                wanted = references(function, self._findings, self._like(name, frozenset()))
                found, passed = offers(
                    function, self._findings, self._robot.bridges, wanted, self._proofs
                )
                self._levels[name] = _Level(function, *self._unambiguous(function, found, passed))
        for name, function in self._robot.functions.items():
            self._given[name] = list(self._gives(function))
        self._feed_all()
        functions = {
            name: self._whole(self._levels[name]) if name in self._levels else value
            for name, value in self._robot.functions.items()
        }
        return evolve(self._robot, functions=functions)

    def _like(self, name: str, seen: frozenset[str]) -> Iterator[MessageStructure]:
        """Yield the structures of the function that a function is like."""
        need = self._robot.functions[name].needs
        other = None if need is None else self._robot.functions.get(need.like)
        if need is None or other is None or other.name in seen:
            return
        if other.needs is not None:
            of_other = self._like(other.name, seen | {name})
            yield from references(other, self._findings, of_other)
        side = "output" if need.role is Role.OUTPUT else "input"
        for component in other.components:
            report = self._structures(component)
            by_port = report.by_port if isinstance(report, Structures) else {}
            yield from (value for key, value in by_port.items() if key.startswith(f"{side}."))

    def _unambiguous(
        self, function: Function, found: list[DiscoveredPort], passed: list[tuple[str, str]]
    ) -> tuple[list[DiscoveredPort], list[tuple[str, str]]]:
        """Take out what fits equally well, where that is refused, and what is beyond the limit."""
        need = function.needs
        assert need is not None, "the caller looked"

        def name(offer: DiscoveredPort) -> str:
            return candidate_name(function.name, offer.spec.name, offer.found, offer.port)

        if need.refuse_ambiguous:
            alike: dict[tuple[object, ...], list[DiscoveredPort]] = {}
            for offer in found:
                alike.setdefault(offer.alike, []).append(offer)
            several = [group for group in alike.values() if len(group) > 1]
            for group in several:
                text = ", ".join(name(offer) for offer in group[:_MOST_PASSED])
                cause = f"ambiguous: {len(group)} fit equally well, which is refused: {text}"
                passed = [*((name(offer), cause) for offer in group), *passed]
            found = [offer for group in alike.values() if len(group) == 1 for offer in group]
        beyond = found[_MOST_CANDIDATES:]
        cause = f"it fits, but {_MOST_CANDIDATES} others do and rank before it"
        return found[:_MOST_CANDIDATES], [*passed, *((name(offer), cause) for offer in beyond)]

    def _gives(self, function: Function) -> Iterator[_AvailableOutput]:
        """Yield what a function can feed inputs with."""
        several: dict[str, list[tuple[MessageStructure, Endpoint]]] = {}
        for component in function.components:
            if not component.outputs:
                continue  # a device that is not there is waited for, for nothing
            report = self._structures(component)
            by_port = report.by_port if isinstance(report, Structures) else {}
            for output in component.outputs if by_port else ():
                made = by_port[f"output.{output.name}"]
                several.setdefault(output.name, []).append((made, output.endpoint))
        level = self._levels.get(function.name)
        found = [] if level is None else level.offers
        main = [(offer.port.message, offer.port.endpoint) for offer in found]
        streams = [
            (structure, end) for structure, end in main if structure and end.role is Role.OUTPUT
        ]
        if len(several) <= 1:
            pairs = [pair for group in several.values() for pair in group] + streams
            names = {function.name, *several, *(end.port for _, end in streams)} - {"default"}
            if pairs:
                yield self._carrying(PortRef(function.name), names, pairs)
            return
        for name, group in several.items():
            yield self._carrying(PortRef(function.name, name), {name, function.name}, group)

    def _carrying(
        self,
        reference: PortRef,
        names: Collection[str],
        ports: list[tuple[MessageStructure, Endpoint]],
    ) -> _AvailableOutput:
        structures = {structure.fingerprint: structure for structure, _ in ports}
        topics = {
            (end.bridge, self._topic(end)) for _, end in ports if self._topic(end) is not None
        }
        return _AvailableOutput(
            reference, frozenset(names), tuple(structures.values()), frozenset(topics)
        )

    # Feeding.

    def _feed_all(self) -> None:
        """Find feeds until nothing more is fed; others than the best where nothing else moves."""
        ready = {name for name, function in self._robot.functions.items() if function.components}
        waits = True
        while True:
            fed = {
                name
                for name, level in self._levels.items()
                if self._feed_level(level, ready, waits=waits)
            }
            if fed:
                ready |= fed
                waits = True
            elif waits:
                waits = False
            else:
                return

    def _feed_level(self, level: _Level, ready: Collection[str], *, waits: bool) -> bool:
        """Complete candidates of one function; say whether any is new."""
        is_new = False
        for number, offer in enumerate(level.offers):
            if number in level.made:
                continue
            made = self._component(level.function, offer, ready, waits=waits)
            if isinstance(made, str):
                level.causes[number] = made
                continue
            level.made[number], is_new = made, True
            self._add_sources(made)
        return is_new

    def _add_sources(self, component: Component) -> None:
        sources = {
            input_.source.function for input_ in component.inputs if input_.source is not None
        }
        self._sources.setdefault(component.function, set()).update(sources)

    def _depends(self, function: str, other: str) -> bool:
        """Say whether a function may be fed by another, at once or through others."""
        seen, waiting = {function}, [function]
        while waiting and other not in seen:
            more = self._sources.get(waiting.pop(), set()) - seen
            seen |= more
            waiting += more
        return other in seen

    def _component(
        self, function: Function, offer: DiscoveredPort, ready: Collection[str], *, waits: bool
    ) -> Component | str:
        """Return the candidate with its feeds, or why it has none yet."""
        need, spec = function.needs, offer.spec
        assert need is not None, "the caller looked"
        name = candidate_name(function.name, spec.name, offer.found, offer.port)
        own = _endpoint(offer.port, name, need)
        inputs: list[Input] = []
        reports = [offer.why]
        streams = [
            found_port for found_port in offer.found.ports if found_port.endpoint.role is Role.INPUT
        ]
        for port in streams if need.role is Role.OUTPUT else ():
            end = _endpoint(port, name, need)
            if _is_one_of(end.port, need.from_application):
                inputs.append(Input(end.port, end))
                reports.append(f"{end.port} from the application")
                continue
            feed = self._feed(function.name, offer, port, ready, waits=waits)
            if isinstance(feed, _Feed):
                adapted, source = feed.adapted, feed.given.reference
                inputs.append(Input(end.port, end, source, adapted.mapping, adapted.allow_loss))
                reports.append(f"{end.port} from {source}{_how(feed)}")
            elif feed and not _is_one_of(end.port, need.unfed):
                return feed
        if need.role is Role.INPUT:
            inputs.append(Input(own.port, own))
        ports = [offer.port, *(stream for stream in streams if need.role is Role.OUTPUT)]
        said = [
            structure for port in ports for structure in (port.message, port.request, port.reply)
        ]
        return Component(
            name=name,
            function=function.name,
            bridge=spec.name,
            priority=min((component.priority for component in function.components), default=0) - 1,
            inputs=tuple(inputs),
            outputs=(Output(own.port, own),) if need.role is Role.OUTPUT else (),
            service=Service(own) if need.role is Role.SERVICE else None,
            parameters=own.parameters,
            match=Match(
                "; ".join(reports),
                tuple(structure.fingerprint for structure in said if structure is not None),
            ),
        )

    def _feed(
        self,
        function: str,
        offer: DiscoveredPort,
        port: FoundPort,
        ready: Collection[str],
        *,
        waits: bool,
    ) -> _Feed | str:
        """Return what feeds an input, why nothing does, or nothing: its framework does."""
        name, topic = port.endpoint.port, self._topic(port.endpoint)
        place = offer.spec.name, topic
        if port.message is None:
            return f"the structure of its input {name} is not known"
        need = self._robot.functions[function].needs
        assert need is not None, "the caller looked"
        feeds = [
            _Feed(_suits(given, port, adapted, place), given, adapted)
            for other, several in self._given.items()
            if not self._depends(other, function)
            for given in several
            if (adapted := self._adapted(given, port.message, need.mapping)) is not None
        ]
        feeds.sort(key=lambda feed: feed.rank)  # those alike stay in the order of the file
        there = [feed for feed in feeds if feed.given.reference.function in ready]
        if topic is not None and self._emitted.get(place, offer.found.name) != offer.found.name:
            there = [feed for feed in there if place in feed.given.topics]
            return there[0] if there else ""
        if not feeds:
            return f"no function feeds its input {name}, which `unfed` does not name"
        if not there or (waits and there[0] is not feeds[0]):
            return f"its input {name} could be fed by {feeds[0].given.reference}, which has nothing"
        alike = [str(feed.given.reference) for feed in feeds if feed.rank == there[0].rank]
        if need.refuse_ambiguous and len(alike) > 1:
            return f"ambiguous: {', '.join(alike)} fit its input {name} equally well"
        return there[0]

    def _adapted(
        self, given: _AvailableOutput, wanted: MessageStructure, rules: Options
    ) -> Adapted | None:
        for structure in given.structures:
            adapted = self._proofs.adapted(structure, wanted, rules)
            if adapted is not None:
                return adapted
        return None

    def _whole(self, level: _Level) -> Function:
        """Return a function with its candidates, and what was left out."""
        made = {component.name: component for _, component in sorted(level.made.items())}
        passed = [
            (candidate_name(level.function.name, offer.spec.name, offer.found, offer.port), cause)
            for number, cause in sorted(level.causes.items())
            if number not in level.made
            for offer in (level.offers[number],)
        ]
        passed += level.passed
        if not made and not passed:
            passed = [_NOTHING_SEEN]
        more = len(passed) - _MOST_PASSED
        if more > 0:
            passed = [*passed[:_MOST_PASSED], (f"{more:,} more", "not listed")]
        components = (*level.function.components, *made.values())
        return evolve(level.function, components=components, passed_over=tuple(passed))


def _suits(
    given: _AvailableOutput, port: FoundPort, adapted: Adapted, place: tuple[str, object]
) -> tuple[bool, bool, bool, bool]:
    is_exact = any(structure == port.message for structure in given.structures)
    is_named = port.endpoint.port in given.names
    return place not in given.topics, adapted.mapping is not None, not is_named, not is_exact


def _endpoint(port: FoundPort, component: str, need: Need) -> Endpoint:
    options = {**port.endpoint.options, **need.options}
    return evolve(port.endpoint, component=component, options=options)


def _is_one_of(name: str, patterns: Iterable[str]) -> bool:
    return any(fnmatchcase(name, pattern) for pattern in patterns)


def _how(feed: _Feed) -> str:
    elsewhere, mapped, other_name, contained = feed.rank
    del elsewhere
    if mapped:
        return " through a map, proven"
    return (" by its name" if not other_name else "") + (", contained" if contained else ", exact")
