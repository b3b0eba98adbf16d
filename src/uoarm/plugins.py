"""What plugins bring beside bridges and front ends: commands, and checks of `uoarm doctor`.

Bridges have their contract in `uoarm.bridge`, front ends theirs in `uoarm.server.front_end`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from attrs import field, frozen

from uoarm._plugins import hookimpl, hookspec

__all__ = ["CONTRACT_VERSION", "Check", "CheckHooks", "Command", "CommandHooks", "hookimpl"]

CONTRACT_VERSION = 1
"""Of the hooks of this module."""


@frozen
class Command:
    """A command of the command line, `uoarm NAME`.

    Attributes:
        name: that of the entry point, too, by which it is listed without being loaded.
        run: takes the words after the name and returns the exit status; may raise SystemExit.
        contract: the version of these hooks that it was written for: a number that stands in its
            source, never `CONTRACT_VERSION`, which is that of the uoarm that runs.
    """

    name: str
    run: Callable[[list[str]], int]
    contract: int = field(kw_only=True)


@frozen
class Check:
    """Something that `uoarm doctor` looks at.

    Attributes:
        name: under which its findings are shown; no other check and no bridge type has it.
        run: returns findings by what they are about; raises PluginError, with what to do, where
            something cannot be used. It ends by itself, within seconds.
        contract: as of `Command`.
    """

    name: str
    run: Callable[[], Mapping[str, str]]
    contract: int = field(kw_only=True)


class CommandHooks:
    """The hooks that a module behind an entry point of group `uoarm.commands` implements."""

    @hookspec
    def uoarm_commands(self) -> list[Command]:
        """Return the commands of this module, of which the one of the entry point's name is run.

        Called when that command is run, and not before.
        """
        raise NotImplementedError


class CheckHooks:
    """The hooks that a module behind an entry point of group `uoarm.checks` implements."""

    @hookspec
    def uoarm_checks(self) -> list[Check]:
        """Return the checks of this plugin. Called by `uoarm doctor`; imports no middleware."""
        raise NotImplementedError
