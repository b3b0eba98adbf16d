"""The parts of a document that have the right type, whatever else is wrong with it.

Mistakes of meaning are looked for among these, so that a misspelt key in one corner of the file
hides nothing in another.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, TypeAlias

from attrs import frozen

from uoarm._support.yaml import Document, Path, Problem, clip, write_path
from uoarm.model import place_problem

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
        """Whether its ports can be read: every key is known and every port a mapping."""
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

    def _ports(self, single: str, several: str) -> Iterator[PortPart]:
        lone = self.value.get(single)
        if isinstance(lone, dict):
            yield PortPart("default", (*self.path, single), lone)
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
    """Return the bridges by name, where they can be read at all."""
    return _mapping(_mapping(value).get("bridges"))


def function_names(value: object) -> dict[str, Any]:
    """Return the functions by name, where they can be read at all."""
    return _mapping(_mapping(value).get("functions"))


def needs(value: object) -> dict[str, dict[str, Any]]:
    """Return what functions need of discovered components, by function, where it can be read."""
    reports = {
        name: _mapping(function_name).get("needs")
        for name, function_name in function_names(value).items()
    }
    return {name: report for name, report in reports.items() if isinstance(report, dict)}


def applications(value: object) -> dict[str, list[Any]]:
    """Return what each application asks for, where it can be read."""
    return _lists(value, "applications")


def recorded(value: object) -> tuple[list[Any], dict[str, Any]]:
    """Return what is recorded and how, where it can be read."""
    options = dict(_mapping(_mapping(value).get("record")))
    functions = options.pop("functions", None)
    options.pop("path", None)
    return functions if isinstance(functions, list) else [], options


def exports(value: object) -> dict[str, list[Any]]:
    """Return what other managers may import, by role, where it can be read."""
    return _lists(value, "export")


def listening(value: object) -> dict[str, Any]:
    """Return where hosts on other machines join, where it can be read."""
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


def _lists(value: object, key: str) -> dict[str, list[Any]]:
    named = _mapping(_mapping(value).get(key))
    return {name: names for name, names in named.items() if isinstance(names, list)}


Mistake: TypeAlias = "tuple[Path, str, str]"
"""Path of the key at fault, sentence, hint."""

_WITH_MACHINE = {"machine", "silence", "start"}


def host_mistakes(value: object) -> Iterator[Mistake]:
    """Yield every mistake in a document's `hosts` and in the `host` of each bridge."""
    for name, bridge in bridge_names(value).items():
        host = bridge.get("host") if isinstance(bridge, dict) else None
        if isinstance(host, dict):
            yield from _mistakes_of(("bridges", name, "host"), host, listening(value))
    yield from _mistakes_of_place(listening(value))


def _mistakes_of(
    path: Path, host: dict[str, object], hosts: dict[str, object]
) -> Iterator[Mistake]:
    if "machine" not in host:
        if "environment" in host and "python" in host:
            yield (*path, "python"), "give either environment or python, not both", ""
        return
    for key in host:
        if key not in _WITH_MACHINE:
            sentence = f"{key} is settled on the machine itself, where the host is started"
            yield (*path, key), sentence, "machine goes with silence and start only"
    if not hosts:
        hint = "add hosts: {listen: tls/ADDRESS:PORT, certificates: FOLDER} to the file"
        yield (*path, "machine"), "nothing says where this machine joins", hint


def _mistakes_of_place(hosts: dict[str, object]) -> Iterator[Mistake]:
    place = hosts.get("listen")
    if not isinstance(place, str):
        return
    problem = place_problem(place)
    if problem:
        yield ("hosts", "listen"), f"{problem}; got {clip(place)}", ""
    elif place.startswith("tls/") and "certificates" not in hosts:
        hint = "name the folder that `uoarm certificates` made"
        yield ("hosts", "listen"), "TLS needs certificates", hint


_NEED_KEYS = ("structure", "request", "reply", "like", "name", "port", "label")


def need_mistakes(value: object) -> Iterator[tuple[Path, str, str, bool]]:
    """Yield where each mistake is, its sentence, a hint, and whether it is about the key."""
    for name, function in function_names(value).items():
        if isinstance(function, dict) and not {"components", "needs"} & function.keys():
            hint = "it has no candidates"
            yield ("functions", name), "components or needs is missing", hint, True
    for name, need in needs(value).items():
        path: Path = ("functions", name, "needs")
        if not any(key in need for key in _NEED_KEYS):
            yield path, "it does not say what is needed", f"one of {', '.join(_NEED_KEYS)}", True
        if "like" in need and "structure" in need:
            yield (*path, "like"), "give either structure or like, not both", "", True
        if need.get("like") == name:
            hint = "name another function, or a type of messages"
            yield (*path, "like"), "the function is like itself", hint, False
        is_service = need.get("role") == "service"
        for key in ("request", "reply"):
            if key in need and not is_service:
                yield (*path, key), f"only a service has a {key}", "add role: service", True
        if is_service and "structure" in need:
            hint = "give request, reply or both"
            yield (*path, "structure"), "a service has no structure of its own", hint, True


def unknown_frameworks(value: object) -> Iterator[tuple[Path, str]]:
    """Yield what `prefer` and `exclude` name and the file does not have."""
    bridges = bridge_names(value)
    plugins = {bridge.get("plugin") for bridge in bridges.values() if isinstance(bridge, dict)}
    for name, need in needs(value).items():
        for key in ("prefer", "exclude"):
            for word in _several(need.get(key)):
                if word not in bridges and word not in plugins:
                    sentence = f"no bridge is named {clip(word)}, and none has such a plugin"
                    yield ("functions", name, "needs", key), sentence


def _several(value: Any) -> list[str]:
    written = [value] if isinstance(value, str) else value
    return [item for item in written if isinstance(item, str)] if isinstance(written, list) else []


def problem_at(
    document: Document,
    file: str,
    code: str,
    path: Path,
    sentence: str,
    hint: str = "",
    *,
    at_key: bool = False,
) -> Problem:
    """Return a mistake of a file at the value that a path leads to, or at its key."""
    place = document.key_place(path) if at_key else document.place(path)
    return Problem(
        place=place,
        path=write_path(path),
        sentence=sentence,
        hint=hint,
        file=file,
        error_code=code,
    )
