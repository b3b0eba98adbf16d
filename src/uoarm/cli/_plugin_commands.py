"""Commands that plugins bring: `uoarm rtm nameserver` belongs to uoarm-rtm.

An entry point of the group `uoarm.commands` has the name of a command, and names a module with
the hook `uoarm_commands`.
"""

from __future__ import annotations

import errno
import os
import sys
from contextlib import suppress
from importlib.metadata import EntryPoint, entry_points
from typing import Any

import click

from uoarm._plugins import values_of
from uoarm._raised import text_of
from uoarm.cli._log import add_log_options
from uoarm.cli._shared import INTERRUPTED, exit_code_of, fail
from uoarm.errors import PluginError, UoarmError
from uoarm.plugins import CONTRACT_VERSION, Command, CommandHooks

__all__ = ["PluginGroup"]

_GROUP = "uoarm.commands"
_NO_ROOM = frozenset({errno.ENOSPC, errno.EFBIG, errno.EDQUOT})


class PluginGroup(click.Group):
    """A group that looks for a command among the plugins when it does not have it itself."""

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; say in one line that it was interrupted, or its output has no room."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:  # which click would tell as a failure, with the code of one
            click.echo("interrupted", err=True)
            sys.exit(INTERRUPTED)
        except UoarmError as error:  # of a plugin's command, and what a command of ours lets pass
            fail(error, exit_code_of(error))
        except OSError as error:
            if error.errno not in _NO_ROOM:
                raise
            with suppress(OSError, ValueError):  # what waits would fail once more when Python ends
                os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise click.ClickException(f"nothing more can be written: {error.strerror}") from error

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return our own commands, then those of plugins."""
        plugins = {point.name for point in entry_points(group=_GROUP)}
        return [*super().list_commands(ctx), *sorted(plugins - set(self.commands))]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return a command; a plugin's is loaded only when it is run."""
        own = super().get_command(ctx, cmd_name)
        if own is not None:
            return own
        point = next(
            (entry for entry in entry_points(group=_GROUP) if entry.name == cmd_name), None
        )
        return None if point is None else _command(point)


def _command(point: EntryPoint) -> click.Command:
    @click.command(
        point.name,
        help=f"Commands of the plugin {point.name}.",
        add_help_option=False,
        context_settings={"ignore_unknown_options": True, "allow_interspersed_args": False},
    )
    @click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
    def run(arguments: tuple[str, ...]) -> None:
        try:
            found = _load(point)
        except Exception as error:
            raise PluginError(
                f"the plugin {point.name} cannot be used: {text_of(error)}"
            ) from error
        sys.exit(found.run(list(arguments)))

    add_log_options(run)
    return run


def _load(point: EntryPoint) -> Command:
    commands = values_of(point, CommandHooks, "uoarm_commands", Command)
    found = next((command for command in commands if command.name == point.name), None)
    if found is None:
        raise PluginError(f"it has no command {point.name!r}")
    if found.contract != CONTRACT_VERSION:
        raise PluginError(
            f"it is written for version {found.contract} of the hooks, this uoarm has version "
            f"{CONTRACT_VERSION}: install matching versions"
        )
    return found
