"""Mistakes of meaning: references to nothing, names used twice, cycles, ports that clash."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

from uoarm.config._build import ports
from uoarm.config._cycles import find_cycle, groundable
from uoarm.config._problem import Problem, did_you_mean
from uoarm.config._shape import write_path
from uoarm.config._yaml import Document, Path

__all__ = ["Checker"]


class Checker:
    """Reads a document of the right shape and collects problems and warnings."""

    def __init__(self, document: Document, file: str) -> None:
        self._document = document
        self._file = file
        self._value: Any = document.value
        self.problems: list[Problem] = []
        self.warnings: list[Problem] = []

    def run(self) -> None:
        """Check everything; the results stand in `problems` and `warnings`."""
        seen: dict[str, Path] = {}
        used: set[str] = set()
        for path, _, component in self._components():
            self._check_name(component, path, seen)
            used.add(component["bridge"])
            self._check_bridge(component, path)
            self._check_ports(component, path)
            self._check_sources(component, path)
        for name in self._value["bridges"]:
            if name not in used:
                self._warn(("bridges", name), f"no component uses the bridge {name!r}")
        self._check_priorities()
        self._check_cycles()

    def _components(self) -> Iterator[tuple[Path, str, Any]]:
        for function, value in self._value["functions"].items():
            for number, component in enumerate(value["components"]):
                yield ("functions", function, "components", number), function, component

    def _check_name(self, component: Any, path: Path, seen: dict[str, Path]) -> None:
        name = component["name"]
        if name in seen:
            first = self._document.place((*seen[name], "name")).line
            self._refuse(
                (*path, "name"), f"the component name {name!r} is used twice, first in line {first}"
            )
        seen.setdefault(name, path)

    def _check_bridge(self, component: Any, path: Path) -> None:
        bridge, known = component["bridge"], self._value["bridges"]
        if bridge not in known:
            hint = did_you_mean(bridge, known) or f"bridges: {', '.join(known) or 'none'}"
            self._refuse((*path, "bridge"), f"there is no bridge {bridge!r}", hint)

    def _check_ports(self, component: Any, path: Path) -> None:
        for one, several in (("input", "inputs"), ("output", "outputs")):
            if one in component and several in component:
                self._refuse((*path, one), f"give either {one} or {several}, not both")
        streams = [key for key in ("input", "inputs", "output", "outputs") if key in component]
        if "service" in component and streams:
            sentence = f"a component has a service or streams, not service and {streams[0]}"
            self._refuse((*path, "service"), sentence)
        if "service" not in component and not streams:
            self._refuse(path, "the component has no input, no output and no service")
        for key in ("input", "output", "service"):
            if key in component:
                self._check_structures(component[key], (*path, key))
        for key in ("inputs", "outputs"):
            for name, port in component.get(key, {}).items():
                self._check_structures(port, (*path, key, name))

    def _check_structures(self, port: Any, path: Path) -> None:
        from jsonschema import Draft202012Validator, SchemaError  # noqa: PLC0415 - slow import

        for key in ("structure", "request", "reply"):
            if key in port:
                try:
                    Draft202012Validator.check_schema(port[key])
                except SchemaError as error:
                    where = (*path, key, *error.absolute_path)
                    self._refuse(where, f"not a JSON Schema: {error.message[:200]}")

    def _check_sources(self, component: Any, path: Path) -> None:
        for name, port in ports(component, "input", "inputs").items():
            if "from" in port:
                lone = name == "default" and "input" in component
                where: Path = (*path, "input") if lone else (*path, "inputs", name)
                self._check_source(port["from"], (*where, "from"))

    def _check_source(self, source: str, where: Path) -> None:
        functions = self._value["functions"]
        function, _, output = source.partition(".")
        if function not in functions:
            hint = did_you_mean(function, functions)
            self._refuse(where, f"there is no function {function!r}", hint)
            return
        names = {
            name
            for provider in functions[function]["components"]
            for name in ports(provider, "output", "outputs")
        }
        if not names:
            self._refuse(where, f"no component of {function!r} has an output")
        elif output and output not in names:
            hint = did_you_mean(output, names) or f"outputs: {', '.join(sorted(names))}"
            self._refuse(where, f"{function!r} has no output {output!r}", hint)

    def _check_priorities(self) -> None:
        for function, value in self._value["functions"].items():
            counts = Counter(one.get("priority", 0) for one in value["components"])
            for priority, count in counts.items():
                if count > 1:
                    self._warn(
                        ("functions", function, "components"),
                        f"{count} components have priority {priority}: tried in this order",
                    )

    def _check_cycles(self) -> None:
        needs: dict[str, list[frozenset[str]]] = {}
        for _, function, component in self._components():
            wanted = (
                port["from"].partition(".")[0]
                for port in ports(component, "input", "inputs").values()
                if "from" in port
            )
            needs.setdefault(function, []).append(
                frozenset(name for name in wanted if name in self._value["functions"])
            )
        grounded = groundable(needs)
        graph = {name: sorted(set().union(*sets)) for name, sets in needs.items()}
        stuck = {name: others for name, others in graph.items() if name not in grounded}
        cycle = find_cycle({n: [o for o in others if o in stuck] for n, others in stuck.items()})
        if cycle is not None:
            sentence = f"the functions depend on each other in a cycle: {' -> '.join(cycle)}"
            self._refuse(("functions", cycle[0]), sentence, "one of them needs another provider")
            return
        avoidable = find_cycle(graph)
        if avoidable is not None:
            sentence = f"some components would close the cycle {' -> '.join(avoidable)}"
            self._warn(("functions", avoidable[0]), f"{sentence}; others avoid it")

    def _refuse(self, path: Path, sentence: str, hint: str = "") -> None:
        self.problems.append(self._problem(path, sentence, hint))

    def _warn(self, path: Path, sentence: str) -> None:
        self.warnings.append(self._problem(path, sentence, ""))

    def _problem(self, path: Path, sentence: str, hint: str) -> Problem:
        place = self._document.place(path)
        return Problem(
            place=place, path=write_path(path), sentence=sentence, hint=hint, file=self._file
        )
