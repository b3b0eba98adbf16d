"""Bridge types: how a plugin states one, and which are installed or broken, and why.

A bridge to other managers also sees through which of them a question came, so that it leads back
to none.
"""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from attrs import field, frozen
from typing_extensions import Self

from uoarm._mistakes import certainly_matches, mistakes
from uoarm._origin import install_command
from uoarm._plugins import PluginProblem, cause_of, hookspec, installed, values_of
from uoarm._spelling import Speller, did_you_mean
from uoarm._support import deadlines
from uoarm._support.files import expanded
from uoarm._support.yaml import write_path
from uoarm.bridge._border import translated
from uoarm.bridge._bridge import CONTRACT_VERSION, Bridge
from uoarm.bridge._options import BridgeOptions, EndpointOptions
from uoarm.bridge._steps import Description
from uoarm.errors import BridgeError, ConfigurationError, FailureReason, PluginError
from uoarm.model import BridgeSpec, Endpoint, MessageStructure, Options, Schema

_PATH = "x-uoarm-path"
Address: TypeAlias = tuple[str, ...]
_CLOSED: Schema = {"type": "object", "additionalProperties": False}


@frozen
class BridgeType:
    """A kind of bridge that a plugin can make.

    Attributes:
        name: what the configuration's `plugin:` says.
        summary: one line for people.
        create: takes the instance's name and its options, checked; may import the middleware, and
            raises PluginError naming the distribution to install when it cannot.
        bridge_options: the options that a bridge may have: a class, of which `create` and the other
            functions get a value; or a JSON Schema, and they get a mapping. The first of the
            `examples` of one that must be
            given is shown to who has not given it. An integer with `x-uoarm-assign: {from: 64,
            to: 101, except_variable: NAME}` is chosen by uoarm for bridges in hosts of several
            installations that leave it out, a number each, so that they do not meet.
            A text with `x-uoarm-path: true` is the path of a file or folder: a relative one begins
            at the configuration's file. Where its value is a regular expression, texts that match
            it as a whole are paths. One that is left out is its `default`, if it has one. What has
            `x-uoarm-structure: true` is the structure of messages, and checked as such.
        endpoint_options: the options that an endpoint may have. What is written is checked against
            them while the configuration is read, with its place, and editors explain them. None:
            only `check_endpoint` knows.
        check_endpoint: takes an address and its options; returns what is wrong, or "". Where there
            are `endpoint_options`, it is asked only about options that are right each by itself.
            Reads only; imports no middleware.
        topic: takes an address and its options; returns the name of the topic that it stands for,
            or "". What is sent to a topic is received by every subscriber of it, so that
            `uoarm check` warns of loops. None: the framework has no topics. Imports no middleware.
        doctor: returns facts about the environment, name to finding, for `uoarm doctor`; raises
            PluginError, with what to install, where no bridge can be made in it.
        check_parameters: takes an address, the parameters of its component and the options of the
            bridge; returns what is wrong, by the parameter's name. For `uoarm check`, which gives
            it ten seconds; unlike the others it may import what it asks about.
        describe: takes an endpoint and the options of the bridge; returns what a bridge would
            describe. For `uoarm check`, as `check_parameters` is; raises what a bridge would.
        doubts: takes the options of a bridge and the addresses that the configuration has of it;
            returns what may be wrong with one in this environment, such as a native type that is
            not installed, by the address, or by () where it is the options. `uoarm check` warns of
            it where the bridge runs in this environment; limits as for `check_parameters`.
        structure_of_type: takes the name of a native message type and the options of the bridge;
            returns what messages of it are like, or None where the type is not known here. Asks
            neither network nor components; may import the type, and what it returns may be kept.
            Names come from clients: nothing but a type's own package may be imported for one.
            Called in any thread, beside bridges that run or not. None: types have no names.
        contract: the contract version that the plugin was written for: a number that stands in
            its source, never `CONTRACT_VERSION`, which is that of the uoarm that runs.
    """

    name: str
    summary: str
    create: Callable[[str, Any], Bridge]
    bridge_options: type[BridgeOptions] | Schema = field(default=_CLOSED, hash=False)
    check_endpoint: Callable[[tuple[str, ...], Options], str] | None = None
    doctor: Callable[[], dict[str, str]] | None = None
    topic: Callable[[tuple[str, ...], Options], str] | None = None
    check_parameters: Callable[[tuple[str, ...], Options, Any], Mapping[str, str]] | None = None
    structure_of_type: Callable[[str, Any], MessageStructure | None] | None = None
    describe: Callable[[Endpoint, Any], Description] | None = None
    doubts: Callable[[Any, frozenset[Address]], Mapping[Address, str]] | None = None
    endpoint_options: type[EndpointOptions] | None = None
    contract: int = field(kw_only=True)

    @property
    def options_schema(self) -> Schema:
        """JSON Schema of the options of a bridge."""
        kind = self.bridge_options
        return kind.schema() if isinstance(kind, type) else kind

    def located(self, options: Options, folder: str) -> dict[str, Any]:
        """Return options in which every relative path begins in a folder, and `~` is the home.

        Paths with a default that are left out are among them.
        """
        made: dict[str, Any] = _located(self.options_schema, dict(options), folder)
        return made

    def value_of(self, options: Options, folder: str) -> Any:
        """Return what `create` takes, of options that match the schema, located in a folder.

        Raises:
            ValueError: the options do not go together; the text says how.
        """
        kind, located = self.bridge_options, self.located(options, folder)
        return kind.of(located) if isinstance(kind, type) else located

    def lacking(self, options: Options) -> tuple[str, ...]:
        """Return the options that must be given and are not."""
        schema: Any = self.options_schema
        required = schema.get("required", ()) if isinstance(schema, Mapping) else ()
        return tuple(str(name) for name in required if name not in options)

    def line(self, bridge: str, options: tuple[str, ...]) -> str:
        """Return what a configuration may say of a bridge with such options, below `bridges`."""
        schema: Any = self.options_schema
        known = schema.get("properties", {}) if isinstance(schema, Mapping) else {}
        examples = {name: known.get(name, {}).get("examples", ["..."])[0] for name in options}
        return f"{bridge}: {{plugin: {self.name}, options: {json.dumps(examples)}}}"

    def __new__(cls, *given: object, **named: object) -> Self:
        """Refuse a bridge type that states no contract in a sentence, before attrs does."""
        if "contract" not in named:
            name = named.get("name", given[0] if given else "?")
            raise PluginError(
                f"bridge type {name!r} states no contract version: add `contract=` with the "
                f"number for which it is written (this uoarm has {CONTRACT_VERSION})"
            )
        return super().__new__(cls)


def _located(schema: Any, value: Any, folder: str) -> Any:
    """Return a value whose paths, by its schema, begin in a folder; the value is not changed."""
    if not isinstance(schema, Mapping):
        return value
    for branch in (*schema.get("anyOf", ()), *schema.get("oneOf", ()), *schema.get("allOf", ())):
        value = _located(branch, value, folder)
    if isinstance(value, str) and value:
        mark = schema.get(_PATH, False)
        is_path = re.fullmatch(mark, value) if isinstance(mark, str) else mark
        return str(Path(folder, expanded(value))) if is_path else value
    if isinstance(value, Mapping):
        known, others = schema.get("properties", {}), schema.get("additionalProperties")
        left_out = {
            name: option["default"]
            for name, option in known.items()
            if isinstance(option, Mapping) and _PATH in option and "default" in option
        }
        return {
            name: _located(known.get(name, others), member, folder)
            for name, member in {**left_out, **value}.items()
        }
    if isinstance(value, list):
        return [_located(schema.get("items"), item, folder) for item in value]
    return value


class BridgeHooks:
    """The hooks that a module behind an entry point of group `uoarm.bridges` implements."""

    @hookspec
    def uoarm_bridge_types(self) -> list[BridgeType]:
        """Return the bridge types of this plugin.

        Called once when a manager starts; must not import the framework's middleware.
        The results of all plugins are put together; names must differ.
        """
        raise NotImplementedError


if TYPE_CHECKING:
    from importlib.metadata import EntryPoint


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
        # By name: on CPython 3.10 an entry point is not comparable to that of importlib_metadata,
        # which reads all of them once any library has imported it.
        names = {point.name for point in points}
        self._unread = [point for point in self._unread if point.name not in names]
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
        hint = did_you_mean(plugin, {**self._types, **_KNOWN})
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


def plugins_of_core() -> frozenset[str]:
    """Return the names of the plugins that the core brings without an entry point."""
    return frozenset(_OWN)


def known_plugins() -> list[str]:
    """Return the names of the plugins that are installed, and of those that we make."""
    return sorted({*(point.name for point in _all_installed()), *_KNOWN})


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


MOST_HOPS = 8
"""Managers through which a message or a question may pass, the first and the last included."""

_asking: ContextVar[tuple[str, ...]] = ContextVar("uoarm-asking-managers", default=())


def asking_managers() -> tuple[str, ...]:
    """Return the identities of the managers whose question is answered here, the first one first.

    Empty where an application of this process asks, and where the manager itself does.
    """
    return _asking.get()


@contextmanager
def asking(managers: tuple[str, ...]) -> Iterator[None]:
    """Answer a question of other managers, for the length of a block and in what it starts."""
    token = _asking.set(managers)
    try:
        yield
    finally:
        _asking.reset(token)


def refuse_loop(what: str, way: tuple[str, ...]) -> None:
    """Refuse a way through managers that comes back to one of them, or is too long.

    Args:
        what: is reached on it, for the error's text.
        way: identities, in order.

    Raises:
        BridgeError: it is refused; the text shows the way.
    """
    shown = " -> ".join(identity[:8] for identity in way)
    if len(set(way)) < len(way):
        text = f"{what}: a loop through managers: {shown}"
        raise BridgeError(text, FailureReason.REFUSED)
    if len(way) > MOST_HOPS:
        text = f"{what}: the way has {len(way)} managers, {MOST_HOPS} at most: {shown}"
        raise BridgeError(text, FailureReason.REFUSED)
