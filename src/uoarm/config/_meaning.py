"""Mistakes of meaning: references to nothing, names used twice, cycles, ports that clash."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import partial
from typing import Any

from attrs import Factory, define

from uoarm._spelling import Speller
from uoarm._support.yaml import Document, Path, Problem, clip
from uoarm.config._loops import avoidable_cycles, unavoidable_cycles
from uoarm.config._parts import (
    ComponentPart,
    PortPart,
    applications,
    bridge_names,
    components,
    exports,
    function_names,
    host_mistakes,
    need_mistakes,
    needs,
    offers,
    problem_at,
    recorded,
    unknown_frameworks,
)
from uoarm.record import RecordOptions

_CYCLE_SHOWN = 100


@define
class _Emitted:
    """What the components of one function emit, taken together.

    Attributes:
        names: outputs that at least one component has, in the order of the file.
        has_main: some component has an only or a default output, which needs no name.
        is_clear: the outputs of every component could be read.
    """

    names: dict[str, None] = Factory(dict)
    has_main: bool = False
    is_clear: bool = True

    def add(self, component: ComponentPart) -> None:
        names = [port.name for port in component.outputs()]
        self.names.update(dict.fromkeys(names))
        self.has_main = self.has_main or len(names) == 1 or "default" in names
        self.is_clear = self.is_clear and component.is_clear


class MeaningChecker:
    """Collects problems and warnings; what has the wrong shape is passed over."""

    def __init__(self, document: Document, file: str, speller: Speller) -> None:
        self._document = document
        self._problem = partial(problem_at, document, file, "UOA-104")
        self._speller = speller
        self._bridges: Mapping[str, Any] = bridge_names(document.value)
        self._functions: Mapping[str, Any] = function_names(document.value)
        self._components = list(components(document.value))
        self._offers = list(offers(document.value))
        self._needs = needs(document.value)
        self._emitted: dict[str, _Emitted] = {}
        self._providers: dict[str, list[ComponentPart]] = {}
        for component in self._components:
            self._emitted.setdefault(component.function, _Emitted()).add(component)
            self._providers.setdefault(component.function, []).append(component)
        self.problems: list[Problem] = []
        self.warnings: list[Problem] = []

    def run(self) -> None:
        """Check everything; the results stand in `problems` and `warnings`."""
        self._check_names()
        self._check_bridges()
        self._check_needs()
        for path, sentence, hint in host_mistakes(self._document.value):
            self._refuse(path, sentence, hint, at_key=True)
        for component in self._components:
            self._check_ports(component)
            for port in component.inputs():
                self._check_source(port)
                self._check_command(port)
        self._check_offers()
        self._check_priorities()
        self._check_cycles()
        self._check_applications()
        self._check_record()
        self._check_exports()

    def structures(self) -> list[tuple[Path, object]]:
        needed: list[tuple[Path, object]] = [
            (("functions", name, "needs", key), need[key])
            for name, need in self._needs.items()
            for key in ("structure", "request", "reply")
            if isinstance(need.get(key), dict)
        ]
        return needed + [
            ((*port.path, key), port.value[key])
            for component in (*self._components, *self._offers)
            for ports, keys in (
                (component.inputs() + component.outputs(), ("structure",)),
                (component.services(), ("request", "reply")),
            )
            for port in ports
            for key in keys
            if isinstance(port.value.get(key), dict)
        ]

    def _check_names(self) -> None:
        first: dict[str, Path] = {}
        for component in self._components:
            name = component.text("name")
            if name is None:
                continue
            path = (*component.path, "name")
            if name in first:
                line = self._document.place(first[name]).line
                sentence = f"the component name {clip(name)} is used twice, first in line {line}"
                self._refuse(path, sentence, "component names are unique in the file")
            first.setdefault(name, path)

    def _check_bridges(self) -> None:
        used: set[str] = {offer.bridge for offer in self._offers}
        for component in self._components:
            bridge = component.text("bridge")
            if bridge is None:
                continue
            used.add(bridge)
            self._require(bridge, self._bridges, "bridge", (*component.path, "bridge"))
        for name in () if self._needs else self._bridges:
            if name not in used:
                self._warn(
                    ("bridges", name), f"no component uses the bridge {clip(name)}", at_key=True
                )

    def _check_needs(self) -> None:
        for path, sentence, hint, at_key in need_mistakes(self._document.value):
            self._refuse(path, sentence, hint, at_key=at_key)
        for path, sentence in unknown_frameworks(self._document.value):
            self._warn(path, sentence)

    def _check_ports(self, component: ComponentPart, noun: str = "component") -> None:
        streams = component.streams
        for name, several in (("input", "inputs"), ("output", "outputs")):
            if name in streams and several in streams:
                self._refuse(
                    (*component.path, name),
                    f"give either {name} or {several}, not both",
                    at_key=True,
                )
        if "service" in component.value and streams:
            article = "an" if noun[0] in "aeiou" else "a"
            sentence = f"{article} {noun} has either a service or streams; here is also "
            self._refuse((*component.path, "service"), sentence + streams[0], at_key=True)
        if not streams and "service" not in component.value and component.is_clear:
            self._refuse(
                component.path,
                f"the {noun} has no port",
                "give it input or inputs, output or outputs, or a service",
            )

    def _check_offers(self) -> None:
        """Hold offers against what the functions' components have, as far as the file says it."""
        for bridge in dict.fromkeys(offer_part.bridge for offer_part in self._offers):
            self._require(bridge, self._bridges, "bridge", ("offer", bridge), at_key=True)
        for offer in self._offers:
            if not self._require(
                offer.function, self._functions, "function", offer.path, at_key=True
            ):
                continue
            self._check_ports(offer, "offer")
            providers = self._providers.get(offer.function, [])
            is_open = offer.function in self._needs
            if not providers or is_open or not all(provider.is_clear for provider in providers):
                continue
            for port, kind, names in (
                *((port, "output", _emitted(providers)) for port in offer.outputs()),
                *((port, "input", _taken(providers)) for port in offer.inputs()),
            ):
                if not names:
                    self._refuse(port.path, f"no component of {offer.function} has an {kind}")
                elif port.name != "default":
                    has_none = f"{offer.function} has no"
                    self._require(port.name, names, kind, port.path, has_none)
            if offer.services() and not any(provider.services() for provider in providers):
                sentence = f"no component of {offer.function} is a service"
                self._refuse(offer.services()[0].path, sentence)

    def _check_source(self, port: PortPart) -> None:
        if port.source is None:
            return
        where = (*port.path, "from")
        function, dot, output = port.source.partition(".")
        if not self._require(function, self._functions, "function", where):
            return
        emitted = self._emitted.get(function)
        if emitted is None or not (emitted.names or emitted.is_clear):
            return
        if not emitted.names:
            self._refuse(where, f"no component of {function} has an output")
        elif dot:
            self._require(output, emitted.names, "output", where, f"{function} has no")
        elif not emitted.has_main:
            self._refuse(
                where,
                f"{function} has several outputs and none is named default",
                f"say which: {_choices(function, emitted.names)}",
            )

    def _check_command(self, port: PortPart) -> None:
        if "lifetime" in port.value and "stop" not in port.value:
            hint = "say what stops it: stop: {message: ...}"
            self._refuse((*port.path, "lifetime"), "a lifetime needs a stop message", hint)
        limits = port.value.get("limits")
        for path, limit in limits.items() if isinstance(limits, dict) else ():
            least, most = (
                limit.get(key) if isinstance(limit, dict) else None
                for key in ("minimum", "maximum")
            )
            if isinstance(least, int | float) and isinstance(most, int | float) and least > most:
                where: Path = (*port.path, "limits", path)
                self._refuse(where, f"the minimum {least:g} is more than the maximum {most:g}")

    def _check_record(self) -> None:
        functions, options = recorded(self._document.value)
        for number, name in enumerate(functions):
            if not isinstance(name, str):
                continue
            function, _, output = name.partition(".")
            where: Path = ("record", "functions", number)
            emitted = self._emitted.get(function, _Emitted())
            is_known = self._require(function, self._functions, "function", where)
            if is_known and output and emitted.is_clear and emitted.names:
                has_none = f"no component of {clip(function)} has an"
                self._require(output, emitted.names, "output", where, has_none)
        for option, sentence in RecordOptions.mistakes(options):
            self._refuse(("record", option), sentence)

    def _check_applications(self) -> None:
        asked = applications(self._document.value)
        for name, functions in asked.items():
            for number, function in enumerate(functions):
                if isinstance(function, str):
                    where: Path = ("applications", name, number)
                    self._require(function, self._functions, "function", where)
        if not asked:
            return
        used = {str(function) for functions in asked.values() for function in functions}
        used.update(offer.function for offer in self._offers)
        for component in self._components:
            used.update(port.source.partition(".")[0] for port in component.inputs() if port.source)
        for name in self._functions:
            if name not in used:
                sentence = f"no application and no component uses the function {clip(name)}"
                self._warn(("functions", name), sentence, at_key=True)

    def _check_exports(self) -> None:
        for role, names in exports(self._document.value).items():
            for number, name in enumerate(names):
                is_name = isinstance(name, str) and not set(name) & set("*?[")
                if is_name and name not in self._functions:
                    hint = self._speller.guess_or_list(name, self._functions, "functions")
                    sentence = f"there is no function {clip(name)} to export"
                    self._refuse(("export", role, number), sentence, hint)

    def _check_priorities(self) -> None:
        same: dict[tuple[str, int], list[ComponentPart]] = {}
        for component in self._components:
            if component.priority is not None:
                same.setdefault((component.function, component.priority), []).append(component)
        for (function, priority), equal in same.items():
            if len(equal) > 1:
                names = ", ".join(
                    component_part.text("name") or "?" for component_part in equal[:_CYCLE_SHOWN]
                )
                self._warn(
                    equal[1].path,
                    f"{len(equal)} components of {function} have priority {priority}; "
                    f"they are tried in this order: {names}",
                )

    def _check_cycles(self) -> None:
        needs: dict[str, list[frozenset[str]]] = {}
        for component in self._components:
            sources = (port.source.partition(".")[0] for port in component.inputs() if port.source)
            needs.setdefault(component.function, []).append(
                frozenset(source for source in sources if source in self._emitted)
            )
        for cycle in unavoidable_cycles(needs):
            self._refuse(
                ("functions", cycle[0]),
                f"these functions need each other and none can be first: {_arrows(cycle)}",
                "one of them needs a component that does not depend on the others",
                at_key=True,
            )
        for cycle in avoidable_cycles(needs):
            self._warn(
                ("functions", cycle[0]),
                f"some components close a cycle, others avoid it: {_arrows(cycle)}",
                at_key=True,
            )

    def _require(
        self,
        name: str,
        known: Collection[str],
        kind: str,
        path: Path,
        has_none: str = "there is no",
        *,
        at_key: bool = False,
    ) -> bool:
        """Say whether a name is known; refuse one that is not, with names that are like it."""
        if name not in known:
            hint = self._speller.guess_or_list(name, known, f"{kind}s")
            self._refuse(path, f"{has_none} {kind} {clip(name)}", hint, at_key=at_key)
        return name in known

    def _refuse(self, path: Path, sentence: str, hint: str = "", *, at_key: bool = False) -> None:
        self.problems.append(self._problem(path, sentence, hint, at_key=at_key))

    def _warn(self, path: Path, sentence: str, *, at_key: bool = False) -> None:
        self.warnings.append(self._problem(path, sentence, "", at_key=at_key))


def _emitted(providers: list[ComponentPart]) -> dict[str, None]:
    return {port.name: None for provider in providers for port in provider.outputs()}


def _taken(providers: list[ComponentPart]) -> dict[str, None]:
    return {
        port.name: None
        for provider in providers
        for port in provider.inputs()
        if port.source is None
    }


def _choices(function: str, outputs: Collection[str]) -> str:
    return " or ".join(f"{function}.{output}" for output in list(outputs)[:4])


def _arrows(cycle: tuple[str, ...]) -> str:
    if len(cycle) <= _CYCLE_SHOWN:
        return " -> ".join(cycle)
    shown = " -> ".join(cycle[: _CYCLE_SHOWN - 1])
    return f"{shown} -> ... {len(cycle) - _CYCLE_SHOWN:,} more ... -> {cycle[-1]}"
