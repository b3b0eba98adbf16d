"""Which bridge plugins are installed, which of them are broken, and why."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from uoarm._mistakes import mistakes
from uoarm._origin import install_command
from uoarm._plugins import PluginProblem, cause_of, installed, values_of
from uoarm._quick_check import certainly_matches
from uoarm._spelling import Speller
from uoarm._support import deadlines
from uoarm._support.yaml import write_path
from uoarm.bridge._border import translated
from uoarm.bridge._bridge import CONTRACT_VERSION, Bridge
from uoarm.bridge._plugin import BridgeHooks, BridgeType
from uoarm.errors import BridgeError, ConfigurationError, FailureReason, PluginError
from uoarm.model import BridgeSpec, MessageStructure

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

__all__ = ["Registry"]

_GROUP = "uoarm.bridges"
# Of the core, beside the plugin `python`, which has an entry point as others have.
_OWN = {"recording": "uoarm.record.plugin", "status": "uoarm.local.status"}
# The extra is what most need: ROS 2 itself, where none is sourced.
_KNOWN = {
    "ros2": ("uoarm-ros2", "jazzy"),
    "ros1": ("uoarm-ros1", ""),
    "rosbridge": ("uoarm-rosbridge", ""),
    "rtm": ("uoarm-rtm", ""),
    "rocos": ("uoarm-rocos", ""),
    "mqtt": ("uoarm-mqtt", ""),
    "vda5050": ("uoarm-vda5050", ""),
    "remote": ("uoarm-remote", ""),
}


class Registry:
    """The bridge types of the plugins that were installed when it was made.

    A plugin is loaded when one of its types is asked for, or all types are: a robot of one
    framework waits for no other. One that fails to load is listed in `problems` and affects no
    other.

    Args:
        points: entry points to read instead of the installed ones.
    """

    def __init__(self, points: Iterable[EntryPoint] | None = None) -> None:
        found = _all_installed() if points is None else points
        self._unread = sorted(found, key=lambda point: point.name)
        self._plugins = frozenset(point.name for point in self._unread)
        # Guards the three below from threads that ask for types at the same time: a plugin is
        # loaded by one of them. Reentrant, as a plugin may look at a registry while it loads.
        self._reading = threading.RLock()
        self._known: dict[str, BridgeType] = {}
        self._problems: list[PluginProblem] = []
        self._types = _Types(self._read, self._read_all)

    @property
    def types(self) -> Mapping[str, BridgeType]:
        """Usable bridge types by name."""
        return self._types

    @property
    def problems(self) -> tuple[PluginProblem, ...]:
        """Plugins that cannot be used, each with its cause."""
        self._read_all()
        return tuple(sorted(self._problems, key=lambda problem: problem.name))

    def _read(self, name: str) -> BridgeType | None:
        """Return a bridge type, loaded with the plugin of its name, or else with all others."""
        if name in self._known:  # without waiting for a plugin that another thread loads
            return self._known[name]
        with self._reading:
            if name not in self._known:
                self._load([point for point in self._unread if point.name == name])
            if name not in self._known:
                self._load(self._unread)
            return self._known.get(name)

    def _read_all(self) -> list[str]:
        """Return the names of all usable types."""
        with self._reading:
            self._load(self._unread)
            return sorted(self._known)

    def _load(self, points: list[EntryPoint]) -> None:
        self._unread = [point for point in self._unread if point not in points]
        for point in points:
            try:
                types = values_of(point, BridgeHooks, "uoarm_bridge_types", BridgeType)
            except Exception as error:  # noqa: BLE001 - a broken plugin may raise anything
                self._problems.append(PluginProblem(point.name, cause_of(error, point)))
                continue
            for kind in types:
                self._admit(point.name, kind)

    def add(self, kind: BridgeType) -> None:
        """Add a bridge type that no installed plugin provides, as tests and programs do.

        Raises:
            PluginError: the name is taken, or the contract version is another.
        """
        with self._reading:
            self._read(kind.name)
            before = len(self._problems)
            self._admit(kind.name, kind)
            if len(self._problems) > before:
                problem = self._problems.pop()
                raise PluginError(f"bridge plugin {problem.name!r}: {problem.cause}")

    def create(self, spec: BridgeSpec) -> Bridge:
        """Make the bridge instance that a configuration asks for.

        Raises:
            ConfigurationError: the plugin does not take these options.
            PluginError: no such plugin, a broken one, or its middleware is missing.
            BridgeError: the plugin raised something else.
        """
        kind = self._types.get(spec.plugin)
        if kind is None:
            raise PluginError(f"bridge {spec.name!r}: {self.missing(spec.plugin)}")
        _require_fitting(spec, kind)
        options = _value_of(spec, kind)
        with translated(f"bridge {spec.name!r}: starting plugin {spec.plugin!r}"):
            bridge: object = kind.create(spec.name, options)
        if not isinstance(bridge, Bridge):
            text = f"plugin {spec.plugin!r} made a {type(bridge).__name__}, not a Bridge"
            raise BridgeError(text)
        bridge.manager = spec.manager
        return bridge

    def structure_of_type(
        self, spec: BridgeSpec, name: str, timeout: float
    ) -> MessageStructure | None:
        """Return what a plugin says of a native type; None: it knows none of this name.

        Raises:
            BridgeError: it failed, or returned something else.
            ConfigurationError: the plugin does not take the options of the bridge.
            BridgeTimeoutError: no answer within `timeout` seconds.
        """
        kind = self._types.get(spec.plugin)
        if kind is None or kind.structure_of_type is None:
            return None
        options = _value_of(spec, kind)
        ask, step = kind.structure_of_type, f"bridge {spec.name!r}: looking for type {name!r:.200}"
        with translated(step):
            found: object = deadlines.run(step, timeout, lambda: ask(name, options))
        if found is not None and not isinstance(found, MessageStructure):
            text = (
                f"plugin {spec.plugin!r} breaks the contract: structure_of_type returned "
                f"{type(found).__name__}, expected a MessageStructure or None"
            )
            raise BridgeError(text, FailureReason.CONTRACT)
        return found

    def missing(self, plugin: str) -> str:
        """Say why there is no bridge type of this name and what to do."""
        for problem in self.problems:
            if problem.name == plugin:
                return f"plugin {plugin!r} is installed but cannot be used: {problem.cause}"
        if plugin in _KNOWN:
            return f"plugin {plugin!r} is not installed: {install_command(*_KNOWN[plugin])}"
        import difflib  # noqa: PLC0415 - for mistakes only

        close = difflib.get_close_matches(plugin, self._types, n=1)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        return f"there is no plugin {plugin!r} (installed: {', '.join(self._types)}){hint}"

    def _admit(self, plugin: str, kind: BridgeType) -> None:
        if kind.contract != CONTRACT_VERSION:
            cause = (
                f"bridge type {kind.name!r} implements contract version {kind.contract}, "
                f"this uoarm has version {CONTRACT_VERSION}: install matching versions"
            )
        elif kind.name in self._known or (kind.name != plugin and kind.name in self._plugins):
            cause = f"bridge type {kind.name!r} is already provided by another plugin"
        else:
            self._known[kind.name] = kind
            return
        self._problems.append(PluginProblem(plugin, cause))


def _all_installed() -> Iterator[EntryPoint]:
    from importlib.metadata import EntryPoint  # noqa: PLC0415 - slow import

    yield from installed(_GROUP)
    for name, module in _OWN.items():
        yield EntryPoint(name, module, _GROUP)


class _Types(Mapping[str, BridgeType]):
    """The bridge types of a registry, each loaded when it is asked for."""

    def __init__(
        self, read: Callable[[str], BridgeType | None], names: Callable[[], list[str]]
    ) -> None:
        self._read = read
        self._names = names

    def __getitem__(self, name: str) -> BridgeType:
        kind = self._read(name)
        if kind is None:
            raise KeyError(name)
        return kind

    def __iter__(self) -> Iterator[str]:
        return iter(self._names())

    def __len__(self) -> int:
        return len(self._names())


def _value_of(spec: BridgeSpec, kind: BridgeType) -> Any:
    try:
        return kind.value_of(spec.options, spec.folder)
    except ValueError as error:
        text = f"bridge {spec.name!r}: the plugin {kind.name!r} does not take these options"
        raise ConfigurationError(f"{text}: {error}") from None


def _require_fitting(spec: BridgeSpec, kind: BridgeType) -> None:
    if certainly_matches(dict(spec.options), kind.options_schema):
        return
    from jsonschema import Draft202012Validator  # noqa: PLC0415 - slow import

    speller = Speller()
    errors = list(Draft202012Validator(kind.options_schema).iter_errors(dict(spec.options)))
    missing = [error for error in errors if error.validator == "required" and not error.path]
    if errors and len(missing) == len(errors):  # as of a bridge that no configuration names
        names = kind.lacking(spec.options)
        s = "" if len(names) == 1 else "s"
        text = f"plugin {kind.name!r} needs the option{s} {', '.join(names)}"
        text += f", which a file gives under `bridges`, such as {kind.line(spec.name, names)}"
        raise ConfigurationError(f"bridge {spec.name!r}: {text}")
    problems = "; ".join(
        f"{write_path(path)}: {sentence}{f' ({hint})' if hint else ''}"
        for error in errors
        for path, sentence, hint, _ in mistakes(error, speller)
    )
    if problems:
        text = f"bridge {spec.name!r}: the plugin {kind.name!r} does not take these options: "
        text += problems
        raise ConfigurationError(text)
