"""What another set of structures does to the plans of a lock; no bridge is asked.

The structures are those that the files of a folder define: JSON Schemas, and what plugins read.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from enum import Enum
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

from attrs import evolve, frozen

from uoarm._adapt import EdgeVerdict, check_edge
from uoarm._lock._record import (
    Lock,
    LockedEdge,
    LockedFunction,
    LockError,
    Port,
    meaning_of,
    read_json,
    read_lock,
)
from uoarm._meaning import name_of_type
from uoarm._origin import install_command
from uoarm._plugins import cause_of, installed, values_of
from uoarm._raised import Log
from uoarm._resolve import Structures, Unavailable
from uoarm._support.files import lock_path
from uoarm.errors import ConfigurationError, PluginError, ResolutionError
from uoarm.model import Component, LockDifference, LockMode, MessageStructure, Robot
from uoarm.plugins import CONTRACT_VERSION, DefinitionFormat, DefinitionHooks, Definitions
from uoarm.schema import SchemaError, newest

_UNDECIDED = "it cannot be decided"
Find = Callable[[Port, MessageStructure], "MessageStructure | None"]
_log = Log("uoarm")


class LockOutcome(Enum):
    """What becomes of one edge, or of one port of a function."""

    FITS = "fits"
    FITS_WITH_MAP = "fits with a map"
    BREAKS = "breaks"
    UNDECIDED = "undecided"


@frozen
class LockFinding:
    """What becomes of one edge, or of what applications get from a function or send to it.

    Attributes:
        function: whose plan it is of.
        subject: `camera.default -> finder.default`, or `output.default` of the function itself.
        outcome: what becomes of it.
        changed: whether its structures are others at all.
        path: field path, where it does not fit.
        sentence: why not.
        suggestion: lines that would mend it.
    """

    function: str
    subject: str
    outcome: LockOutcome
    changed: bool
    path: str = ""
    sentence: str = ""
    suggestion: str = ""


def compare(lock: Lock, other: Lock | Mapping[str, Any]) -> Iterator[LockFinding]:
    """Yield what becomes of every edge and of every function that applications may ask for.

    Args:
        lock: whose plans they are.
        other: another lock, or JSON Schemas by the names of their types; a structure whose type is
            not among those stays as it is.
    """
    find = _in_lock(other) if isinstance(other, Lock) else _in_schemas(other)
    known = {port: lock.structure(fingerprint) for port, fingerprint in lock.ports().items()}
    for name, offer in lock.offers.items():
        for edge in offer.edges:
            yield _edge(f"offer {name}", edge, known, find)
    for name, function in lock.functions.items():
        for edge in function.edges:
            yield _edge(name, edge, known, find)
        yield from _offered(name, function, known, find)


def _in_lock(other: Lock) -> Find:
    found = {port: other.structure(fingerprint) for port, fingerprint in other.ports().items()}
    return lambda port, _: found.get(port)


def _in_schemas(schemas: Mapping[str, Any]) -> Find:
    def find(_: Port, before: MessageStructure) -> MessageStructure:
        schema = before.schema
        declared = name_of_type(schema.get("x-type")) if isinstance(schema, Mapping) else ""
        for name in (before.native_type, declared):
            if name in schemas:
                after = schemas[name]
                if declared and name_of_type(after.get("x-type")) == "":
                    after = {**after, "x-type": schema["x-type"]}  # type: ignore[index] # checked above
                return MessageStructure(after, native_type=before.native_type)
        return before

    return find


def _edge(
    function: str, edge: LockedEdge, ports: Mapping[Port, MessageStructure], find: Find
) -> LockFinding:
    producer, consumer = (edge.producer, f"output.{edge.output}"), (
        edge.consumer, f"input.{edge.input}",
    )  # fmt: skip
    subject = f"{edge.producer}.{edge.output} -> {edge.consumer}.{edge.input}"
    sent, taken = find(producer, ports[producer]), find(consumer, ports[consumer])
    for port, now in ((producer, sent), (consumer, taken)):
        if now is None:
            return _gone(function, subject, port)
    assert sent is not None
    assert taken is not None
    if sent == ports[producer] and taken == ports[consumer]:
        return LockFinding(function, subject, LockOutcome.FITS, changed=False)
    verdict = check_edge(sent, taken, edge.map, edge.allow_loss, meaning_of(edge))
    return _judged(function, subject, verdict)


def _offered(
    name: str, function: LockedFunction, ports: Mapping[Port, MessageStructure], find: Find
) -> Iterator[LockFinding]:
    """Yield what applications notice: outputs may narrow, inputs may widen."""
    if not function.parts:
        return
    provider = function.parts[-1]
    fed = {edge.input for edge in function.edges if edge.consumer == provider.component}
    for port in provider.ports:
        kind, _, own = port.partition(".")
        if kind == "input" and own in fed:
            continue
        key = provider.component, port
        before, after = ports[key], find(key, ports[key])
        if after is None:
            yield _gone(name, port, key)
        elif after == before:
            yield LockFinding(name, port, LockOutcome.FITS, changed=False)
        elif kind in {"output", "reply"}:
            yield _judged(name, port, check_edge(after, before, suggest_seconds=0))
        else:
            yield _judged(name, port, check_edge(before, after, suggest_seconds=0))


def _gone(function: str, subject: str, port: Port) -> LockFinding:
    sentence = f"the other lock has no {port[1]} of a component {port[0]!r}"
    return LockFinding(function, subject, LockOutcome.BREAKS, changed=True, sentence=sentence)


def _judged(function: str, subject: str, verdict: EdgeVerdict) -> LockFinding:
    if verdict.compatible:
        return LockFinding(function, subject, LockOutcome.FITS, changed=True)
    first = verdict.reasons[0]
    outcome = LockOutcome.FITS_WITH_MAP if first.suggestion else LockOutcome.BREAKS
    if first.sentence.startswith(_UNDECIDED):
        outcome = LockOutcome.UNDECIDED
    return LockFinding(
        function, subject, outcome, changed=True,
        path=first.path, sentence=first.sentence, suggestion=first.suggestion,
    )  # fmt: skip


class LockGuard:
    """Holds structures against a lock, and remembers what is different. Thread safe.

    Args:
        lock: what was written down.
        mode: whether a component with other structures may be used.
        report: called once for each new difference, with the place and a sentence.
    """

    def __init__(self, lock: Lock, mode: LockMode, report: Callable[[str, str], None]) -> None:
        self.lock = lock
        self.mode = mode
        self._report = report
        self._ports = lock.ports()
        self._found: dict[tuple[str, str], LockDifference] = {}
        self._counting = threading.Lock()

    def hold(self, component: Component, structures: Structures) -> Structures | Unavailable:
        """Return structures that may be used, with a warning where they are others; or why not."""
        reports = self.differences(component.name, structures.by_port)
        if not reports:
            return structures
        if self.mode is LockMode.ENFORCE:
            return Unavailable("; ".join(reports))
        return evolve(structures, warnings=(*structures.warnings, *reports))

    def hold_offer(self, name: str, ports: Mapping[str, MessageStructure]) -> None:
        """Hold what an offer has in its framework against the lock.

        Raises:
            ResolutionError: it is not as it was locked, and may not be used.
        """
        reports = self.differences(name, ports)
        if reports and self.mode is LockMode.ENFORCE:
            raise ResolutionError("; ".join(reports))

    def differences(self, component: str, ports: Mapping[str, MessageStructure]) -> tuple[str, ...]:
        """Say for each port of a component that is not as it was locked what is different.

        What is reported is counted, too.
        """
        return tuple(
            self._differs(component, port, self._ports.get((component, port)))
            for port, value in ports.items()
            if self._ports.get((component, port)) != value.fingerprint
        )

    def status(self) -> tuple[LockDifference, ...]:
        """Return what was found to be different, by component and port."""
        with self._counting:
            return tuple(difference for _, difference in sorted(self._found.items()))

    def _differs(self, component: str, port: str, locked: str | None) -> str:
        place = f"{component}.{port}"
        if locked is None:
            sentence = f"{place} is not in the lock: `uoarm lock` adds it"
        else:
            sentence = (
                f"{place} has another structure than in the lock: `uoarm lock --check` says what "
                "that breaks, `uoarm lock` accepts it"
            )
        is_refused = self.mode is LockMode.ENFORCE
        with self._counting:
            before = self._found.get((component, port))
            times = 1 if before is None else before.times + 1
            self._found[component, port] = LockDifference(
                component, port, is_refused, times, sentence
            )
        if before is None:
            _log.warning("%s%s", sentence, "; it is not used" if is_refused else "")
            self._report(place, sentence)
        return sentence


def guard_of(
    robot: Robot, report: Callable[[str, str], None], before: LockGuard | None = None
) -> LockGuard | None:
    """Return the guard that a configuration asks for, None where it asks for none. Reads the lock.

    Args:
        robot: the configuration.
        report: as the guard has it.
        before: the guard in force, which stays where the lock is the same.

    Raises:
        LockError: there is no lock beside the configuration, or it cannot be read.
    """
    if robot.lock is None:
        return None
    says = f"the configuration says `lock: {robot.lock.value}`"
    if not robot.origin:
        raise LockError(f"{says}, and was not read from a file: there is no lock beside it")
    path = lock_path(robot.origin)
    if not path.exists():
        raise LockError(f"{says}, and there is no {path}: write it with `uoarm lock`")
    lock = read_lock(path)
    if before is not None and (before.lock, before.mode) == (lock, robot.lock):
        return before
    return LockGuard(lock, robot.lock, report)


_DEFINITIONS = "uoarm.definitions"
_SCHEMAS = frozenset({".json", ".schema"})
_OF_ROS = frozenset({".msg", ".srv", ".action", ".idl"})
_MOST_FILES = 20_000


def read_schemas(folder: Path, lock: Lock, *, is_installed: bool = False) -> dict[str, Any]:
    """Return the JSON Schemas of a folder by the types that they are of.

    Types of schemas are named by `x-type`, by the title and by the name of the file, `.json` or
    `.schema`; those of other definitions by the plugin that reads them.

    Args:
        folder: with all that is below it.
        lock: whose types are to be readable where the folder defines them.
        is_installed: whether it is an environment, whose JSON Schemas are those of its libraries
            and stand for no type.

    Raises:
        LockError: a file or the definition of a type of the lock cannot be read, or there is none.
        ConfigurationError: what reads the files is not installed.
    """
    formats = _formats()
    known = _OF_ROS.union(
        () if is_installed else _SCHEMAS, *(format_.suffixes for format_, _ in formats)
    )
    paths = sorted(path for path in folder.rglob("*") if path.suffix in known)
    if not paths or len(paths) > _MOST_FILES:
        kinds = ", ".join(f"*{suffix}" for suffix in sorted(known))
        raise LockError(
            f"{folder}: expected 1 to {_MOST_FILES:,} files of {kinds}, got {len(paths):,}"
        )
    types = set().union(*_names_of_types(lock))
    found: dict[str, Any] = {}
    places: dict[str, Path] = {}
    defined_beside = {path.with_suffix("") for path in paths if path.suffix not in _SCHEMAS}
    for path in paths:
        # What an installed package has beside a definition describes it, and is no schema.
        if path.suffix not in _SCHEMAS or path.with_suffix("") in defined_beside:
            continue
        schema = read_json(path)
        if not isinstance(schema, dict):
            continue
        given = (path.stem, schema.get("title"), name_of_type(schema.get("x-type")))
        names = [name for name in given if isinstance(name, str) and name]
        if not types.isdisjoint(names):
            try:
                schema = newest(schema)
            except SchemaError as error:
                raise LockError(f"{path}: {error}") from error
        for name in names:
            if name in types and schema != found.get(name, schema):
                raise LockError(f"{folder}: {places[name]} and {path} define {name} otherwise")
            found[name], places[name] = schema, path
    left = {path.suffix for path in paths} - _SCHEMAS
    for format_, point in formats:
        if format_.suffixes & left:
            left -= format_.suffixes
            defined = _read(format_, point, folder)
            _refuse_unreadable(folder, lock, defined.problems)
            found |= defined.schemas
    if left:
        raise LockError(
            f"{folder}: nothing that is installed reads its files of {sorted(left)}: definitions "
            f"of ROS are read with {install_command('uoarm-ros2', 'definitions')}"
        )
    return found


def uncompared_types(lock: Lock, schemas: Mapping[str, Any]) -> list[str]:
    """Return the types of a lock that are not among schemas, and so are not compared."""
    return sorted(min(name) for name in _names_of_types(lock) if name and name.isdisjoint(schemas))


def _names_of_types(lock: Lock) -> set[frozenset[str]]:
    """Return the names of each type of a lock."""
    return {
        frozenset({structure.native_type, name_of_type(structure.structure.get("x-type"))} - {""})
        for structure in lock.structures.values()
        if isinstance(structure.structure, Mapping)
    }


def _formats() -> list[tuple[DefinitionFormat, EntryPoint]]:
    found = []
    for point in sorted(installed(_DEFINITIONS), key=lambda point: point.name):
        try:
            found += [(format_, point) for format_ in _load(point)]
        except Exception as error:
            # Without it a definition that differs would pass for one that is not there.
            text = f"the plugin {point.name} cannot be used: {cause_of(error, point)}"
            raise LockError(text) from error
    return found


def _load(point: EntryPoint) -> list[DefinitionFormat]:
    formats = values_of(point, DefinitionHooks, "uoarm_definition_formats", DefinitionFormat)
    for format_ in formats:
        if format_.contract != CONTRACT_VERSION:
            raise PluginError(
                f"it is written for version {format_.contract} of the hooks, this uoarm has "
                f"version {CONTRACT_VERSION}: install matching versions"
            )
    return formats


def _read(one: DefinitionFormat, point: EntryPoint, folder: Path) -> Definitions:
    try:
        return one.read(folder)
    except ConfigurationError:
        raise
    except Exception as error:
        text = f"{folder}: {one.name} cannot be read: {cause_of(error, point)}"
        raise LockError(text) from error


def _refuse_unreadable(folder: Path, lock: Lock, problems: Mapping[str, str]) -> None:
    """Raise LockError for the first type of the lock that cannot be read, which may differ."""
    for name in sorted(
        {structure.native_type for structure in lock.structures.values()} & set(problems)
    ):
        raise LockError(f"{folder}: the definition of {name} cannot be read: {problems[name]}")
