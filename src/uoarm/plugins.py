"""What plugins bring beside bridges and front ends: commands, checks, formats of definitions.

Bridges have their contract in `uoarm.bridge`, front ends theirs in `uoarm.server.front_end`.
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from attrs import field, frozen

from uoarm._encodable import printable
from uoarm._plugins import hookimpl, hookspec
from uoarm._support.files import (
    UnreadableFileError,
    expanded,
    read_octets,
    read_text,
    user_folder,
)
from uoarm.errors import CommandLineError

if TYPE_CHECKING:
    from _typeshed import SupportsWrite

__all__ = [
    "CONTRACT_VERSION",
    "Check",
    "CheckHooks",
    "Command",
    "CommandHooks",
    "CommandParser",
    "DefinitionFormat",
    "DefinitionHooks",
    "Definitions",
    "UnreadableFileError",
    "expanded",
    "hookimpl",
    "printable",
    "read_octets",
    "read_text",
    "user_folder",
]

CONTRACT_VERSION = 1
"""Of the hooks of this module."""


@frozen
class Command:
    """A command of the command line, `uoarm NAME`.

    Attributes:
        name: that of the entry point, too, by which it is listed without being loaded.
        run: takes the words after the name and returns the exit status; may raise SystemExit. An
            error of uoarm, or of click, that it raises is shown with its code of errors.
        contract: the version of these hooks that it was written for: a number that stands in its
            source, never `CONTRACT_VERSION`, which is that of the uoarm that runs.
    """

    name: str
    run: Callable[[list[str]], int]
    contract: int = field(kw_only=True)


_EMPTY = re.compile("--[a-z-]+=")


class CommandParser(argparse.ArgumentParser):
    """Reads the words of a command as argparse does; wrong ones raise CommandLineError.

    Empty text is wrong, as of a variable that a script has not set.
    """

    def parse_known_args(  # type: ignore[override]  # as of argparse, without what nothing gives
        self, args: Sequence[str] | None = None, namespace: Any = None
    ) -> tuple[Any, list[str]]:
        """Read words."""
        words = sys.argv[1:] if args is None else list(args)
        if any(word == "" or _EMPTY.fullmatch(word) for word in words):
            self.error("expected some text, got ''")
        return super().parse_known_args(words, namespace)

    def add_configuration(self) -> None:
        """Have the command take its configuration as each command does: a word, or with -f."""
        self.add_argument(
            "place",
            metavar="FILE",
            nargs="?",
            help="configuration; else UOARM_CONFIG or robot.yaml",
        )
        self.add_argument("-f", "--file", help="configuration, in place of FILE")

    def named_configuration(self, given: argparse.Namespace) -> str | None:
        """Return the configuration that the words name; None where they name none.

        Raises:
            CommandLineError: they name two.
        """
        place: str | None = given.place
        file: str | None = given.file
        if None not in {place, file} and place != file:
            self.error(f"the configuration is named twice: {place} and -f {file}")
        return file if place is None else place

    def configuration(self, given: argparse.Namespace) -> str:
        """Return the configuration that the words name, else UOARM_CONFIG, else robot.yaml.

        Raises:
            CommandLineError: they name two.
        """
        named = self.named_configuration(given)
        return named or os.environ.get("UOARM_CONFIG") or "robot.yaml"

    def print_help(self, file: SupportsWrite[str] | None = None) -> None:
        """Write the help, where argparse would say nothing of one for which there is no room."""
        (sys.stdout if file is None else file).write(self.format_help())
        sys.stdout.flush()

    def error(self, message: str) -> NoReturn:
        """Show how the command is used, and raise."""
        self.print_usage(sys.stderr)
        raise CommandLineError(message)


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


@frozen
class Definitions:
    """The message types that files of a folder define.

    Attributes:
        schemas: the JSON Schema of each type, as the bridge to its framework describes it, by the
            native type.
        problems: why a type cannot be read, by the native type.
    """

    schemas: Mapping[str, Mapping[str, Any]]
    problems: Mapping[str, str] = field(factory=dict)


@frozen
class DefinitionFormat:
    """Files that define message types, read without their framework.

    Attributes:
        name: of the format, in errors.
        suffixes: of its files, `.msg` and the like.
        read: returns what the files below a folder define; raises ConfigurationError, with what to
            do, where it cannot. It ends by itself, whatever the folder holds.
        contract: as of `Command`.
    """

    name: str
    suffixes: frozenset[str]
    read: Callable[[Path], Definitions]
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


class DefinitionHooks:
    """The hooks that a module behind an entry point of group `uoarm.definitions` implements."""

    @hookspec
    def uoarm_definition_formats(self) -> list[DefinitionFormat]:
        """Return the formats that this plugin reads. Imports no middleware."""
        raise NotImplementedError
