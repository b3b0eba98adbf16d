"""How a plugin says what bridge it makes: one hook, one value."""

from __future__ import annotations

from collections.abc import Callable

import pluggy
from attrs import field, frozen

from uoarm.bridge._bridge import CONTRACT_VERSION, Bridge
from uoarm.model import Options, Schema

__all__ = ["BridgeType", "hookimpl", "hookspec"]

hookspec = pluggy.HookspecMarker("uoarm")
hookimpl = pluggy.HookimplMarker("uoarm")

_CLOSED: Schema = {"type": "object", "additionalProperties": False}


@frozen
class BridgeType:
    """A kind of bridge that a plugin can make.

    Attributes:
        name: what the configuration's `plugin:` says.
        summary: one line for people.
        create: takes the instance's name and checked options; may import the middleware, and
            raises PluginError naming the distribution to install when it cannot.
        options_schema: JSON Schema of the options. An integer with `x-uoarm-assign: {from: 64,
            to: 101, except_variable: NAME}` is chosen by uoarm for bridges in hosts of several
            installations that leave it out, a number each, so that they do not meet.
        check_endpoint: takes an address and its options; returns what is wrong, or "".
            Reads only; imports no middleware.
        doctor: returns facts about the environment, name to finding, for `uoarm doctor`.
        contract: the contract version that the plugin was written for.
    """

    name: str
    summary: str
    create: Callable[[str, Options], Bridge]
    options_schema: Schema = field(default=_CLOSED, hash=False)
    check_endpoint: Callable[[tuple[str, ...], Options], str] | None = None
    doctor: Callable[[], dict[str, str]] | None = None
    contract: int = CONTRACT_VERSION


class _Specification:
    """The hooks that a module behind an entry point of group `uoarm.bridges` implements."""

    @hookspec
    def uoarm_bridge_types(self) -> list[BridgeType]:
        """Return the bridge types of this plugin.

        Called once when a manager starts; must not import the framework's middleware.
        The results of all plugins are put together; names must differ.
        """
        raise NotImplementedError


SPECIFICATION = _Specification
