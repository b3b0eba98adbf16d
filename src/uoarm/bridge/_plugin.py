"""How a plugin says what bridge it makes: one hook, one value."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

from attrs import field, frozen
from typing_extensions import Self

from uoarm._plugins import hookspec
from uoarm.bridge._bridge import CONTRACT_VERSION, Bridge
from uoarm.bridge._description import Description
from uoarm.bridge._options import BridgeOptions, EndpointOptions
from uoarm.errors import PluginError
from uoarm.model import Endpoint, MessageStructure, Options, Schema

__all__ = ["BridgeHooks", "BridgeType"]

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
            it as a whole are paths. One that is left out is its `default`, if it has one.
        endpoint_options: the options that an endpoint may have. What is written is checked against
            them while the configuration is read, with its place, and editors explain them. None:
            only `check_endpoint` knows.
        check_endpoint: takes an address and its options; returns what is wrong, or "". Where there
            are `endpoint_options`, it is asked only about options that are right each by itself.
            Reads only; imports no middleware.
        topic: takes an address and its options; returns the name of the topic that it stands for,
            or "". What is sent to a topic is received by everybody who listens to it, so that
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
        return str(Path(folder, os.path.expanduser(value))) if is_path else value  # noqa: PTH111
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
