"""Mistakes that only a plugin can find: options that it does not know, addresses it cannot read."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

from uoarm._mistakes import schema_mistakes
from uoarm._raised import foreign, sentence_of, text_of
from uoarm._spelling import Speller
from uoarm._support import deadlines
from uoarm._support.yaml import Document, Path, Problem, clip
from uoarm.bridge import BridgeType
from uoarm.config._build import bridge_options, folder_of
from uoarm.config._loops import SharedTopic, feedback_loops
from uoarm.config._parts import (
    ComponentPart,
    OfferPart,
    PortPart,
    bridge_names,
    components,
    offers,
    problem_at,
)
from uoarm.config._shape import OF_A_HOST, ShapeChecker, assignables, installation
from uoarm.errors import BridgeError, FailureReason, PluginError
from uoarm.model import Endpoint, Role, Schema

_PARAMETER_SECONDS = 10.0
_STRUCTURE = "x-uoarm-structure"


class PluginChecker:
    """Asks the installed bridge types about what is written for them.

    A bridge whose plugin is not installed is passed over, and so is a component that is not here:
    the same file may serve machines with different frameworks. `absences` has both.
    """

    def __init__(
        self,
        document: Document,
        file: str,
        speller: Speller,
        types: Mapping[str, BridgeType],
        shape: ShapeChecker,
    ) -> None:
        self._document = document
        self._shape = shape
        self._file = file
        self._problem = partial(problem_at, document, file, "UOA-105")
        self._speller = speller
        self._bridges: dict[str, tuple[BridgeType, Any]] = {}
        self._hosts: dict[str, Any] = {}
        self._unknown: dict[str, str] = {}
        self._absent: list[Problem] = []
        self._undescribed: list[Problem] = []
        self._unreachable: set[Path] = set()
        self._wrong_bridges: set[str] = set()
        for name, written in bridge_names(document.value).items():
            settings = written if isinstance(written, dict) else {}
            self._hosts[name] = settings.get("host")
            plugin = str(settings.get("plugin", name))
            if (kind := types.get(plugin)) is None:
                self._unknown[name] = plugin
            else:
                self._bridges[name] = kind, settings.get("options", {})

    def problems(self) -> Iterator[Problem]:
        """Yield every mistake in options and endpoints."""
        for name, (kind, options) in self._bridges.items():
            if isinstance(options, dict):
                path = ("bridges", name, "options")
                wrong = list(self._option_problems(kind, kind.options_schema, options, path))
                written = bridge_options(kind.name, options, self._file)
                read = partial(kind.value_of, written, folder_of(self._file))
                wrong = wrong or list(self._contradictions(kind, read, path))
                if wrong:
                    self._wrong_bridges.add(name)
                    yield from wrong
        for component in (*components(self._document.value), *offers(self._document.value)):
            of_offer = component.bridge if isinstance(component, OfferPart) else None
            bridge = of_offer or component.text("bridge") or ""
            if bridge in self._bridges:
                yield from self._endpoint_problems(self._bridges[bridge][0], component)

    def parameter_problems(self) -> Iterator[Problem]:
        """Yield every mistake in the parameters of components that run in this environment.

        Imports those of Python, each within ten seconds; `absences` has what cannot be asked.
        """
        read: dict[str | None, Any] = {}
        for component in components(self._document.value):
            bridge, given = component.text("bridge"), component.value.get("parameters", {})
            kind, options = self._bridges.get(bridge or "", (None, None))
            if kind is None or bridge in self._wrong_bridges or self._is_hosted(bridge):
                continue
            if kind.check_parameters is None and kind.describe is None:
                continue
            ports = (*component.inputs(), *component.outputs(), *component.services())
            address = _address(ports[0].value) if ports else None
            if address is None or not isinstance(given, dict) or not isinstance(options, dict):
                continue
            if component.path in self._unreachable:  # of which the cause was said
                continue
            try:
                if bridge not in read:
                    written = bridge_options(kind.name, options, self._file)
                    read[bridge] = kind.value_of(written, folder_of(self._file))
                wrong = foreign(self._wrong, kind, address, given, read[bridge])
                if not wrong:
                    yield from foreign(self._port_problems, kind, component, read[bridge])
            except Exception as error:  # noqa: BLE001 - a component may raise anything
                sentence = sentence_of(error)
                if isinstance(error, BridgeError) and error.reason is FailureReason.BAD_ENDPOINT:
                    yield self._problem((*ports[0].path, "endpoint"), sentence)
                    continue
                text = f"it is unavailable here: {sentence}"
                self._absent.append(self._problem(component.path, text))
                continue
            for name, sentence in wrong.items():
                is_written = name in given
                path = (*component.path, "parameters", name) if is_written else component.path
                text = sentence if is_written else f"the parameter {name}: {sentence}"
                yield self._problem(path, text, at_key=is_written)

    def _port_problems(
        self, kind: BridgeType, component: ComponentPart, options: Any
    ) -> list[Problem]:
        """Return the first port that can be none; note those of which no structure is known."""
        fed = {address for port in component.inputs() if (address := _address(port.value))}
        for role, ports in (
            (Role.INPUT, component.inputs()),
            (Role.OUTPUT, component.outputs()),
            (Role.SERVICE, component.services()),
        ):
            parts = {"request": "request", "reply": "reply"}
            if role is not Role.SERVICE:
                parts = {"message": "structure"}
            for port in ports:
                unknown = {part: key for part, key in parts.items() if key not in port.value}
                address = _address(port.value)
                if kind.describe is None or address is None:
                    continue
                endpoint = Endpoint(
                    str(component.text("bridge")),
                    str(component.text("name")),
                    role,
                    address,
                    port.name,
                    options=port.value.get("options", {}),
                    parameters=component.value.get("parameters", {}),
                )
                try:
                    description = deadlines.run(
                        f"looking at the structures of {address}",
                        _PARAMETER_SECONDS,
                        partial(kind.describe, endpoint, options),
                    )
                    wrong = description.unfed(address, fed)
                except BridgeError as error:
                    if error.reason is not FailureReason.BAD_ENDPOINT:
                        raise
                    wrong = str(error)
                if wrong:
                    return [self._problem((*port.path, "endpoint"), wrong)]
                keys = [key for part, key in unknown.items() if getattr(description, part) is None]
                if keys and description.hint:
                    hint = f"{description.hint}, or declare {' and '.join(keys)} here; true is any"
                    sentence = "what its messages are like is not known, so that no plan has it"
                    self._undescribed.append(self._problem(port.path, sentence, hint))
        return []

    def _is_hosted(self, bridge: str | None) -> bool:
        host = self._hosts.get(bridge or "")
        return host is not None and host is not False

    def _wrong(
        self,
        kind: BridgeType,
        address: tuple[str, ...],
        given: Mapping[str, Any],
        options: Any,
    ) -> Mapping[str, str]:
        check = kind.check_parameters
        if check is None:
            return {}
        return deadlines.run(
            f"looking at the parameters of {address}",
            _PARAMETER_SECONDS,
            lambda: check(address, given, options),
        )

    def absences(self, missing: Callable[[str], str]) -> Iterator[Problem]:
        """Yield which bridges and interpreters are not here, and which components were not found.

        A bridge in an environment of its own, or on another machine, is asked for there. Components
        are those of `parameter_problems`.

        Args:
            missing: says of a plugin's name why there is none.
        """
        for name, plugin in self._unknown.items():
            if installation(self._hosts[name]) == installation(None):
                text = f"it was not checked: {missing(plugin)}"
                yield self._problem(("bridges", name), text, at_key=True)
        yield from self._interpreters()
        yield from self._absent
        yield from self._undescribed
        places = self._places()
        for name in self._bridges:
            if not self._is_hosted(name) and name not in self._wrong_bridges:
                yield from self._doubts(name, places.get(name, {}))

    def _interpreters(self) -> Iterator[Problem]:
        """Yield which hosts have no Python here that could run them."""
        from uoarm.environments import find_interpreter  # noqa: PLC0415 - when first needed

        for name, host in self._hosts.items():
            given = host if isinstance(host, dict) else {}
            named = {key: given[key] for key in OF_A_HOST if isinstance(given.get(key), str)}
            try:
                found, hint = find_interpreter(**named)
            except (PluginError, ValueError):  # which the check of shape reports
                continue
            if hint:
                text = f"there is no Python interpreter at {found}"
                yield self._problem(("bridges", name, "host", next(iter(named))), text, hint)

    def _places(self) -> dict[str, dict[tuple[str, ...], list[Path]]]:
        """Return where the addresses of each bridge stand."""
        found: dict[str, dict[tuple[str, ...], list[Path]]] = {}
        for component in (*components(self._document.value), *offers(self._document.value)):
            owner = component.bridge if isinstance(component, OfferPart) else None
            places = found.setdefault(owner or component.text("bridge") or "", {})
            for port in (*component.inputs(), *component.outputs(), *component.services()):
                address = _address(port.value)
                if address is not None:
                    places.setdefault(address, []).append((*port.path, "endpoint"))
        return found

    def _doubts(
        self, bridge: str, places: Mapping[tuple[str, ...], list[Path]]
    ) -> Iterator[Problem]:
        """Yield what a plugin doubts of the options and the addresses of a bridge."""
        kind, options = self._bridges[bridge]
        check = kind.doubts
        if check is None or not isinstance(options, dict):
            return
        whole: Path = ("bridges", bridge, "options") if options else ("bridges", bridge)
        written = bridge_options(kind.name, options, self._file)
        step = f"looking at the addresses of bridge {bridge}"
        try:
            ask = partial(check, kind.value_of(written, folder_of(self._file)), frozenset(places))
            found = dict(foreign(deadlines.run, step, _PARAMETER_SECONDS, ask))
        except Exception as error:  # noqa: BLE001 - a plugin may raise anything
            sentence = sentence_of(error)
            found = {(): f"its addresses cannot be looked at here: {sentence}"}
        for address, sentence in found.items():
            for path in places.get(address, [whole]):
                yield self._problem(path, sentence)

    def unchecked(self) -> Iterator[str]:
        """Yield what was not looked at, and who knows it: a sentence each, without a full stop."""
        used = {str(part.text("bridge")) for part in components(self._document.value)}
        for name in sorted(used & self._hosts.keys()):
            kind, _ = self._bridges.get(name, (None, None))
            if self._is_hosted(name):
                yield f"components of bridge {name}, which runs in a host: are they there?"
            elif kind is None or kind.check_parameters is None:
                plugin = self._unknown.get(name) or (kind.name if kind is not None else name)
                yield f"components of bridge {name} ({plugin}): are they there, of such types?"
        if used:
            yield "do messages fit from component to component?"

    def warnings(self) -> Iterator[Problem]:
        """Yield what the file may hold and should not."""
        yield from self._meetings()
        yield from self._loops()

    def _loops(self) -> Iterator[Problem]:
        for path, names in feedback_loops(list(components(self._document.value)), self._topic):
            along = " -> ".join(names)
            sentence = f"a message would go round without end: {along}"
            hint = "give one of them an address of its own"
            yield self._problem(path, sentence, hint)

    def _topic(self, component: ComponentPart, port: PortPart) -> SharedTopic | None:
        """Return the topic of a port, where its plugin knows one."""
        kind, own = self._bridges.get(component.text("bridge") or "", (None, None))
        if kind is None or kind.topic is None:
            return None
        address, options = port.value.get("endpoint"), port.value.get("options", {})
        if not isinstance(address, list) or not all(isinstance(part, str) for part in address):
            return None
        if not address or not isinstance(options, dict):
            return None
        try:
            name = foreign(kind.topic, tuple(address), options)
        except Exception:  # noqa: BLE001 - a plugin may raise anything; check_endpoint reports it
            return None
        return (
            SharedTopic(f"{kind.name} {json.dumps(own, default=str, sort_keys=True)}", name)
            if name
            else None
        )

    def _meetings(self) -> Iterator[Problem]:
        """Yield what several installations of a plugin have in common and should not have."""
        seen: dict[tuple[str, str, str], tuple[str, str]] = {}
        for name, (kind, options) in self._bridges.items():
            for assignable in assignables(kind) if isinstance(options, dict) else ():
                option = assignable.option
                if option not in options:
                    continue
                value = clip(options[option])
                place = installation(self._hosts[name])
                first, where = seen.setdefault((kind.name, option, value), (name, place))
                if where != place:
                    sentence = (
                        f"bridge {first} has the same {option} {value}, with another "
                        f"installation of {kind.name}: they meet there"
                    )
                    path: Path = ("bridges", name, "options", option)
                    yield self._problem(path, sentence, "leave it out, and uoarm chooses")

    def _option_problems(
        self, kind: BridgeType, schema: Schema, options: Any, path: Path
    ) -> Iterator[Problem]:
        for where, sentence, hint, at_key in schema_mistakes(options, schema, self._speller):
            text = f"the plugin {kind.name}: {sentence}"
            yield self._problem((*path, *where), text, hint, at_key=at_key)
        for where, structure in _structures(schema, options, ()):
            yield from self._shape.structure_problems(structure, (*path, *where))

    def _contradictions(
        self, kind: BridgeType, read: Callable[[], object], path: Path
    ) -> Iterator[Problem]:
        """Yield that options, right each by itself, do not go together."""
        try:
            foreign(read)
        except Exception as error:  # noqa: BLE001 - a plugin may raise anything
            sentence = str(error) if isinstance(error, ValueError) else text_of(error)
            yield self._problem(path, f"the plugin {kind.name}: {sentence}")

    def _endpoint_problems(self, kind: BridgeType, component: ComponentPart) -> Iterator[Problem]:
        """Yield what a plugin says of the addresses of one component: of the same mistake once."""
        found: dict[str, list[PortPart]] = {}
        for port in (*component.inputs(), *component.outputs(), *component.services()):
            options = port.value.get("options", {})
            if kind.endpoint_options is not None and isinstance(options, dict):
                schema, path = kind.endpoint_options.schema(), (*port.path, "options")
                problems = list(self._option_problems(kind, schema, options, path))
                if not problems:
                    read = partial(kind.endpoint_options.of, options)
                    problems = list(self._contradictions(kind, read, path))
                if problems:
                    yield from problems
                    self._unreachable.add(component.path)
                    continue
            wrong = _endpoint_mistake(kind, port.value)
            if wrong:
                found.setdefault(wrong, []).append(port)
        for wrong, (first, *others) in found.items():
            self._unreachable.add(component.path)
            names = (".".join(map(str, port.path[len(component.path) :])) for port in others)
            hint = f"the same stands in {', '.join(names)}" if others else ""
            sentence = f"the plugin {kind.name} says: {wrong}"
            yield self._problem((*first.path, "endpoint"), sentence, hint)


def _structures(schema: Any, value: Any, path: Path) -> Iterator[tuple[Path, Any]]:
    """Yield the message structures in options, which their schema marks, and where they stand."""
    if not isinstance(schema, Mapping):
        return
    if schema.get(_STRUCTURE) and isinstance(value, dict | bool):
        yield path, value
    elif isinstance(value, dict):
        known, others = schema.get("properties", {}), schema.get("additionalProperties")
        for name, member in value.items():
            yield from _structures(known.get(name, others), member, (*path, name))
    elif isinstance(value, list):
        for number, item in enumerate(value):
            yield from _structures(schema.get("items"), item, (*path, number))


def _address(port: Mapping[str, Any]) -> tuple[str, ...] | None:
    """Return the address of a port; None where it is none, which the check of shape reports."""
    address = port.get("endpoint")
    if not isinstance(address, list) or not all(isinstance(part, str) for part in address):
        return None
    return tuple(address)


def _endpoint_mistake(kind: BridgeType, port: Mapping[str, Any]) -> str:
    address, options = _address(port), port.get("options", {})
    if address is None or not isinstance(options, dict) or kind.check_endpoint is None:
        return ""
    try:
        return foreign(kind.check_endpoint, address, options)
    except Exception as error:  # noqa: BLE001 - a plugin may raise anything
        return f"check_endpoint failed with {text_of(error)}"
