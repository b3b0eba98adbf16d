"""The parts of a document that have the right type, whatever else is wrong with it.

Mistakes of meaning are looked for among these, so that a misspelt key in one corner of the file
hides nothing in another.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from attrs import frozen

from uoarm._yaml import Path

__all__ = [
    "ComponentPart",
    "OfferPart",
    "PortPart",
    "applications",
    "bridge_names",
    "components",
    "function_names",
    "listening",
    "needs",
    "offers",
]

_STREAMS = ("input", "inputs", "output", "outputs")
_KEYS = {"name", "bridge", "priority", "parameters", "service", *_STREAMS}


@frozen
class PortPart:
    """One port of a component: `name` is `default` where it was written without one."""

    name: str
    path: Path
    value: Mapping[str, Any]

    @property
    def source(self) -> str | None:
        """What `from` says, where it is text."""
        source = self.value.get("from")
        return source if isinstance(source, str) and source else None


@frozen
class ComponentPart:
    """One component of one function."""

    function: str
    path: Path
    value: Mapping[str, Any]

    def text(self, key: str) -> str | None:
        """Return the text under a key, None where there is none."""
        value = self.value.get(key)
        return value if isinstance(value, str) else None

    @property
    def priority(self) -> int | None:
        """The priority, None where it is not a number."""
        value = self.value.get("priority", 0)
        return int(value) if isinstance(value, int | float) else None

    @property
    def is_clear(self) -> bool:
        """Whether its ports can be told: every key is known and every port a mapping."""
        ports = [self.value[key] for key in (*_STREAMS, "service") if key in self.value]
        return self.value.keys() <= _KEYS and all(isinstance(port, dict) for port in ports)

    @property
    def streams(self) -> list[str]:
        """The keys under which it gives inputs and outputs."""
        return [key for key in _STREAMS if key in self.value]

    def inputs(self) -> list[PortPart]:
        """Its inputs, whichever of the two spellings it uses."""
        return list(self._ports("input", "inputs"))

    def outputs(self) -> list[PortPart]:
        """Its outputs, whichever of the two spellings it uses."""
        return list(self._ports("output", "outputs"))

    def services(self) -> list[PortPart]:
        """Its service, where it has one."""
        return list(self._ports("service", ""))

    def _ports(self, one: str, several: str) -> Iterator[PortPart]:
        lone = self.value.get(one)
        if isinstance(lone, dict):
            yield PortPart("default", (*self.path, one), lone)
        for name, port in _mapping(self.value.get(several)).items():
            if isinstance(port, dict):
                yield PortPart(name, (*self.path, several, name), port)


@frozen
class OfferPart(ComponentPart):
    """One function that a bridge offers; its outputs and inputs are those of the function."""

    bridge: str


def offers(value: object) -> Iterator[OfferPart]:
    """Yield every offer, in the order of the file."""
    for bridge, offered in _mapping(_mapping(value).get("offer")).items():
        for function, item in _mapping(offered).items():
            if isinstance(item, dict):
                yield OfferPart(function, ("offer", bridge, function), item, bridge)


def bridge_names(value: object) -> dict[str, Any]:
    """Return the bridges by name, where they can be told at all."""
    return _mapping(_mapping(value).get("bridges"))


def function_names(value: object) -> dict[str, Any]:
    """Return the functions by name, where they can be told at all."""
    return _mapping(_mapping(value).get("functions"))


def needs(value: object) -> dict[str, dict[str, Any]]:
    """Return what functions need of discovered components, by function, where it can be told."""
    reports = {
        name: _mapping(function_name).get("needs")
        for name, function_name in function_names(value).items()
    }
    return {name: report for name, report in reports.items() if isinstance(report, dict)}


def applications(value: object) -> dict[str, list[Any]]:
    """Return what each application asks for, where it can be told."""
    asked = _mapping(_mapping(value).get("applications"))
    return {name: names for name, names in asked.items() if isinstance(names, list)}


def listening(value: object) -> dict[str, Any]:
    """Return where hosts on other machines join, where it can be told."""
    return _mapping(_mapping(value).get("hosts"))


def components(value: object) -> Iterator[ComponentPart]:
    """Yield every component, in the order of the file."""
    for function, name in function_names(value).items():
        listed = _mapping(name).get("components")
        for number, component in enumerate(listed if isinstance(listed, list) else ()):
            if isinstance(component, dict):
                yield ComponentPart(
                    function, ("functions", function, "components", number), component
                )


def _mapping(value: object) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}
