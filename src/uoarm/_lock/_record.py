"""What a lock holds: for each function its plan, and every structure once, by its content."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib.metadata import Distribution, distributions
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from attrs import field, fields, frozen

from uoarm._support.files import UnreadableFileError, expanded, read_text
from uoarm.environments import environment_folder
from uoarm.errors import ConfigurationError, PluginError
from uoarm.model import (
    Component,
    Edge,
    Input,
    Meaning,
    MeaningLevel,
    MessageStructure,
    Offer,
    OfferedPort,
    Options,
    Plan,
    Robot,
    from_json,
    to_json,
)
from uoarm.model import read_json as json_of

_T = TypeVar("_T")
Port: TypeAlias = tuple[str, str]
"""A component, and its port as `output.default`."""
_GROUP = "uoarm.bridges"
_CORE = "uoarm"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
_EXTRA = re.compile(r"""extra\s*==\s*['"]([^'"]+)['"]""")
_FOR_DEVELOPERS = frozenset({"dev", "test", "tests", "doc", "docs"})
_VERSION = 2
_MOST_OCTETS = 100_000_000


@frozen
class LockedBridge:
    """What a bridge runs with.

    Attributes:
        plugin: which makes it.
        environment: the name of its environment, or the interpreter that was named instead; empty:
            that of the application.
        packages: versions by name: of uoarm, of the plugin's distribution, and of all that this
            asks for, as far as it is installed. None of what runs on other machines.
    """

    plugin: str
    environment: str = ""
    packages: dict[str, str] = field(factory=dict)


def bridges_of(robot: Robot) -> dict[str, LockedBridge]:
    """Return what the bridges of a robot run with. Reads what is installed, and runs nothing."""
    installed: dict[Path | None, dict[str, Distribution]] = {}
    found = {}
    for name, spec in sorted(robot.bridges.items()):
        environment, folder = _environment(spec.host or {})
        packages: dict[str, str] = {}
        if not environment or folder is not None:
            if folder not in installed:
                installed[folder] = _installed(folder)
            packages = _packages(installed[folder], spec.plugin)
        found[name] = LockedBridge(spec.plugin, environment, packages)
    return found


def differing_packages(
    before: Mapping[str, LockedBridge], after: Mapping[str, LockedBridge]
) -> list[str]:
    """Return a line for each package of a bridge of both that has another version."""
    return [
        f"bridge {name}: {package} {now or 'is gone'}, was {then or 'not there'}"
        for name, value in before.items()
        if name in after
        for package in sorted(value.packages.keys() | after[name].packages)
        if (then := value.packages.get(package)) != (now := after[name].packages.get(package))
    ]


def _environment(host: Options) -> tuple[str, Path | None]:
    """Return what the settings of a host say of its environment, and its folder if it has one."""
    if "machine" in host:
        return f"of machine {host['machine']}", None
    if "environment" in host:
        name = str(host["environment"])
        try:
            return name, environment_folder(name)
        except PluginError:  # it cannot be the name of one
            return name, None
    if "python" in host:
        python = str(host["python"])
        return python, expanded(python).parent.parent
    return "", None


def _installed(folder: Path | None) -> dict[str, Distribution]:
    if folder is None:
        found = distributions()
    else:
        found = distributions(path=[str(path) for path in folder.glob("lib/python*/site-packages")])
    by_name: dict[str, Distribution] = {}
    for distribution in found:
        name = distribution.metadata["Name"]
        if name:
            by_name.setdefault(
                _normal(name), distribution
            )  # the first on the path is what is imported
    return by_name


def _packages(installed: Mapping[str, Distribution], plugin: str) -> dict[str, str]:
    own = [
        name
        for name, value in installed.items()
        if any(point.group == _GROUP and point.name == plugin for point in value.entry_points)
    ]
    waiting, found = list(own), {}
    while waiting:
        name = waiting.pop()
        if name in found or name not in installed:
            continue
        found[name] = installed[name].version
        if name != _CORE:  # what that asks for concerns no message
            # The plugin's own extras name the versions of the middleware.
            waiting += _required(installed[name], with_extras=name in own)
    return dict(sorted(found.items()))


def _required(one: Distribution, *, with_extras: bool) -> Iterable[str]:
    for line in one.requires or ():
        name, extra = _NAME.match(line), _EXTRA.search(line)
        if name and (extra is None or (with_extras and extra[1] not in _FOR_DEVELOPERS)):
            yield _normal(name[0])


def _normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


class LockError(ConfigurationError):
    """A lock, or what it is compared with, cannot be read; the text says what is wrong with it."""

    error_code = "UOA-110"


@frozen
class LockedPart:
    """One component of a plan; `ports` names the structure of each by its content."""

    component: str
    function: str
    bridge: str
    plugin: str
    ports: dict[str, str]


@frozen
class LockedEdge:
    """One edge of a plan, with all that it was judged by but the structures."""

    producer: str
    output: str
    consumer: str
    input: str
    map: dict[str, Any] | None
    allow_loss: tuple[str, ...]
    meaning: str
    alike: tuple[tuple[str, ...], ...]
    rests_on_shape: tuple[str, ...]


@frozen
class LockedFunction:
    """The plan of a function, or why it has none; `others` are candidates that may take over."""

    parts: tuple[LockedPart, ...] = ()
    edges: tuple[LockedEdge, ...] = ()
    passed_over: dict[str, str] = field(factory=dict)
    refused: str = ""
    others: tuple[LockedPart, ...] = ()


@frozen
class LockedOffer:
    """A function as a framework finds it: its ports there, and how they are fed or feed."""

    part: LockedPart
    edges: tuple[LockedEdge, ...] = ()


@frozen
class LockedStructure:
    """A message structure."""

    native_type: str
    structure: Any


@frozen
class Lock:
    """What the plans of a robot rest on.

    Attributes:
        functions: by name.
        structures: by fingerprint.
        bridges: what each runs with, by name.
        offers: what is offered in frameworks, by `BRIDGE:FUNCTION`.
    """

    functions: dict[str, LockedFunction]
    structures: dict[str, LockedStructure]
    version: int = _VERSION
    bridges: dict[str, LockedBridge] = field(factory=dict)
    offers: dict[str, LockedOffer] = field(factory=dict)

    def parts(self) -> Iterator[LockedPart]:
        """Yield every part, of plans, of candidates and of offers; one may come several times."""
        for function in self.functions.values():
            yield from (*function.parts, *function.others)
        for offer in self.offers.values():
            yield offer.part

    def ports(self) -> dict[Port, str]:
        """Return the fingerprint of each port of every part."""
        return {
            (part.component, port): fingerprint
            for part in self.parts()
            for port, fingerprint in part.ports.items()
        }

    def edges(self) -> Iterator[LockedEdge]:
        """Yield every edge, of plans and of offers."""
        for function in self.functions.values():
            yield from function.edges
        for offer in self.offers.values():
            yield from offer.edges

    def structure(self, fingerprint: str) -> MessageStructure:
        """Return the structure of that content."""
        found = self.structures[fingerprint]
        return MessageStructure(found.structure, native_type=found.native_type)


@frozen
class _WrittenFunction:
    """A function in the file: its parts, edges and others by their keys there."""

    parts: tuple[str, ...] = ()
    edges: tuple[str, ...] = ()
    passed_over: dict[str, str] = field(factory=dict)
    refused: str = ""
    others: tuple[str, ...] = ()


@frozen
class _WrittenLock:
    """A lock in the file: a part that many plans have, as in a chain, is written once."""

    functions: dict[str, _WrittenFunction]
    structures: dict[str, LockedStructure]
    parts: dict[str, LockedPart] = field(factory=dict)
    edges: dict[str, LockedEdge] = field(factory=dict)
    version: int = _VERSION
    bridges: dict[str, LockedBridge] = field(factory=dict)
    offers: dict[str, LockedOffer] = field(factory=dict)


def record(
    robot: Robot,
    plans: Mapping[str, Plan | str],
    described: Mapping[str, Mapping[str, MessageStructure]],
) -> Lock:
    """Return the lock of a robot.

    Args:
        robot: the configuration.
        plans: for each function its plan, or why it has none.
        described: the structures of all components and offers that are there, by their ports.
    """
    structures: dict[str, LockedStructure] = {}
    functions: dict[str, LockedFunction] = {}
    known: dict[str, tuple[Mapping[str, MessageStructure], LockedPart]] = {}

    def part(subject: Component | Offer, ports: Mapping[str, MessageStructure]) -> LockedPart:
        if subject.name not in known or known[subject.name][0] != ports:
            known[subject.name] = ports, new_part(subject, ports)
        return known[subject.name][1]

    def new_part(subject: Component | Offer, ports: Mapping[str, MessageStructure]) -> LockedPart:
        for structure in ports.values():
            structures[structure.fingerprint] = LockedStructure(
                structure.native_type, structure.schema
            )
        by_port = {port: structure.fingerprint for port, structure in sorted(ports.items())}
        plugin = robot.bridges[subject.bridge].plugin
        return LockedPart(subject.name, subject.function, subject.bridge, plugin, by_port)

    for name, plan in sorted(plans.items()):
        used = () if isinstance(plan, str) else [step.component.name for step in plan.steps]
        others = tuple(
            part(component, described[component.name])
            for component in robot.functions[name].components
            if component.name in described and component.name not in used
        )
        if isinstance(plan, str):
            functions[name] = LockedFunction(others=others, refused=plan)
            continue
        inputs = {
            (step.component.name, port.name): port
            for step in plan.steps
            for port in step.component.inputs
        }
        parts = tuple(part(step.component, step.structures) for step in plan.steps)
        edges = tuple(_edge(edge, inputs[edge.consumer, edge.input]) for edge in plan.edges)
        passed_over = {
            rejection.component: rejection.reasons[0].sentence if rejection.reasons else ""
            for rejection in plan.rejected
        }
        functions[name] = LockedFunction(parts, edges, passed_over, others=others)
    offers = {
        offer.name: LockedOffer(
            part(offer, described[offer.name]),
            tuple(_offered(offer, plans.get(offer.function, ""), described[offer.name])),
        )
        for offer in robot.offers
        if offer.name in described
    }
    return Lock(
        functions, dict(sorted(structures.items())), bridges=bridges_of(robot), offers=offers
    )


def _offered(
    offer: Offer, plan: Plan | str, described: Mapping[str, MessageStructure]
) -> Iterator[LockedEdge]:
    """Yield an edge for each port of an offer whose structures are known on both sides."""
    if isinstance(plan, str):
        return
    component, known = plan.provider.component, plan.provider.structures
    for port in offer.outputs:
        output = component.output(None if port.name == "default" else port.name)
        if output is not None and f"input.{port.name}" in described:
            yield _offered_edge(port, (component.name, output.name), (offer.name, port.name))
    for port in offer.inputs:
        if f"input.{port.name}" in known and f"output.{port.name}" in described:
            yield _offered_edge(port, (offer.name, port.name), (component.name, port.name))


def _offered_edge(
    port: OfferedPort, producer: tuple[str, str], consumer: tuple[str, str]
) -> LockedEdge:
    mapping = None if port.mapping is None else dict(port.mapping)
    level, alike = port.meaning.level.value, _sorted(port.meaning.alike)
    return LockedEdge(*producer, *consumer, mapping, port.allow_loss, level, alike, ())


def _sorted(alike: Iterable[frozenset[str]]) -> tuple[tuple[str, ...], ...]:
    return tuple(sorted(tuple(sorted(names)) for names in alike))


def _edge(edge: Edge, port: Input) -> LockedEdge:
    mapping = None if edge.mapping is None else dict(edge.mapping)
    return LockedEdge(
        edge.producer, edge.output, edge.consumer, edge.input, mapping, port.allow_loss,
        port.meaning.level.value, _sorted(port.meaning.alike), edge.unstated,
    )  # fmt: skip


def meaning_of(edge: LockedEdge) -> Meaning:
    """Return how the meaning of an edge is judged."""
    return Meaning(MeaningLevel(edge.meaning), tuple(map(frozenset, edge.alike)))


def write_lock(lock: Lock) -> str:
    """Return a lock as text: the same for the same plans, a line for each value."""
    parts: dict[str, LockedPart] = {}
    edges: dict[str, LockedEdge] = {}
    functions = {
        name: _rebuilt(
            function,
            _WrittenFunction,
            parts=tuple(_key(parts, part.component, part) for part in function.parts),
            edges=tuple(
                _key(edges, f"{edge.producer}.{edge.output} -> {edge.consumer}.{edge.input}", edge)
                for edge in function.edges
            ),
            others=tuple(_key(parts, part.component, part) for part in function.others),
        )
        for name, function in lock.functions.items()
    }
    written = _rebuilt(lock, _WrittenLock, functions=functions, parts=parts, edges=edges)
    return json.dumps(to_json(written), indent=2, sort_keys=True, ensure_ascii=False) + "\n"


def _rebuilt(value: Any, made: Callable[..., _T], *gone: str, **changed: Any) -> _T:
    """Make another record of all fields of a value, but for what is gone or changed."""
    kept = {item.name: getattr(value, item.name) for item in fields(type(value))}
    return made(**{name: part for name, part in kept.items() if name not in gone} | changed)


def _key(known: dict[str, _T], name: str, value: _T) -> str:
    """Return the key of a value, and put it there; what is another has a key of its own."""
    while known.setdefault(name, value) is not value and known[name] != value:
        name += "'"
    return name


def read_lock(path: Path) -> Lock:
    """Read a lock.

    Raises:
        LockError: there is none, or it is no lock of this version.
    """
    data = read_json(path, "a lock, as `uoarm lock` writes it")
    if not isinstance(data, dict) or "version" not in data:
        raise LockError(f"{path}: expected a lock, as `uoarm lock` writes it, got other JSON")
    if data["version"] != _VERSION:
        text = f"expected a lock of version {_VERSION}, got version {data['version']}"
        text += ": `uoarm lock` writes it anew"
        raise LockError(f"{path}: {text}")
    try:
        lock = _read(from_json(data, _WrittenLock))
        for part in lock.parts():
            for fingerprint in part.ports.values():
                lock.structure(fingerprint)
        for edge in lock.edges():
            meaning_of(edge)
    except (ValueError, KeyError) as error:
        raise LockError(f"{path}: this is no whole lock: {error}") from error
    return lock


def _read(written: _WrittenLock) -> Lock:
    functions = {
        name: _rebuilt(
            function,
            LockedFunction,
            parts=tuple(written.parts[key] for key in function.parts),
            edges=tuple(written.edges[key] for key in function.edges),
            others=tuple(written.parts[key] for key in function.others),
        )
        for name, function in written.functions.items()
    }
    return _rebuilt(written, Lock, "parts", "edges", functions=functions)


def read_json(path: Path, expected: str = "JSON") -> Any:
    """Return what a file of JSON holds.

    Raises:
        LockError: it cannot be read, or is none; the text says what was expected.
    """
    try:
        return json_of(read_text(path, _MOST_OCTETS))
    except UnreadableFileError as error:
        raise LockError(f"{path}: {error}") from error
    except ValueError as error:
        raise LockError(f"{path}: expected {expected}, got what is no JSON: {error}") from error
