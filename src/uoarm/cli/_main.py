"""The command `uoarm`, and which commands it has: ours, and those that plugins bring.

A command's module is imported when it is run. `uoarm rtm nameserver` belongs to uoarm-rtm: an
entry point of the group `uoarm.commands` has the name of a command, and names a module with the
hook `uoarm_commands`.
"""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from uoarm._raised import text_of
from uoarm._support.process_tuning import short_switch_interval
from uoarm._version import __version__
from uoarm.cli._output import (
    NO_ROOM,
    UNWRITTEN,
    add_log_options,
    echo,
    keep_apart,
    logging_to_stderr,
)
from uoarm.cli._shared import (
    BRIDGE,
    INTERRUPTED,
    JSON,
    REFUSED,
    UNPRINTED,
    exit_code_of,
    fail,
    importing,
    print_failure,
    refuse_empty_words,
    terminable,
)
from uoarm.errors import CommandLineError, PluginError, UoarmError, UsageError

if TYPE_CHECKING:
    from uoarm.plugins import Command

_GROUP = "uoarm.commands"
_NO_THREAD = "can't start new thread"  # the text of what Python raises
_AT_LIMIT = frozenset({errno.EMFILE, errno.ENFILE, errno.EAGAIN, errno.ENOMEM})
_LIMIT = "a limit of this process, user or machine is reached: see ulimit -a and systemd's TasksMax"
_DESCRIPTORS = 8
_HELP = getattr(click.exceptions, "NoArgsIsHelpError", ())  # which click 8.1 has not

# Plugins of ours by the command that they bring.
_BROUGHT: Mapping[str, str] = {
    "fleet": "uoarm-remote", "mcp": "uoarm-mcp", "rocos": "uoarm-rocos", "ros2": "uoarm-ros2",
    "rtm": "uoarm-rtm",
}  # fmt: skip

# By name: a command's module and object, and its line of `uoarm --help`, which imports none.
COMMANDS: Mapping[str, tuple[str, str, str]] = {
    "apply": ("_remote", "apply", "Give a running robot another configuration."),
    "approve": ("_remote", "approve", "Decide about what agents ask to do with a running robot."),
    "bridges": ("_show", "bridges", "List the installed bridge plugins."),
    "call": ("_run", "call", "Call the service NAME and print its reply."),
    "certificates": ("_setup", "certificates", "Make the certificates that machines join with."),
    "check": ("_show", "check", "Say everything that is wrong with a configuration FILE."),
    "discover": ("_discover", "discover", "Show every component and port that bridges see now."),
    "doctor": ("_show", "doctor", "Say what the environment is and what plugins find in it."),
    "env": ("_setup", "env", "Make and remove Python environments for bridge hosts."),
    "explain": ("_show", "explain", "Say what an error CODE means and what to do."),
    "history": ("_remote", "history", "Show the revisions of a running robot's configuration."),
    "host": ("_host", "host", "Run BRIDGES of a configuration, until interrupted."),
    "list": (
        "_show",
        "list_functions",
        "List the functions and the components that provide them.",
    ),
    "lock": ("_lock", "lock", "Write down what all plans rest on, or check it."),
    "new-bridge": ("_setup", "new_bridge", "Make a bridge plugin to start from, with its tests."),
    "offer": ("_run", "offer", "Offer functions in frameworks, as `offer:` says."),
    "record": ("_record", "record", "Record what functions give into a file."),
    "request": ("_run", "request", "Open a function and show its messages."),
    "resolve": ("_show", "resolve", "Find the plan for a function without opening anything."),
    "schema": ("_show", "schema", "Print the JSON Schema of robot.yaml, for editors."),
    "serve": ("_serve", "serve", "Serve a robot to WebSocket clients and browsers."),
    "status": ("_discover", "status", "Show what can be had now, and from which component."),
    "stop": ("_remote", "stop", "Stop everything that moves of a running robot."),
    "suggest": ("_discover", "suggest", "Write the configuration of what bridges see."),
    "token": ("_serve", "token", "Make a token for a client of `uoarm serve`."),
    "types": ("_lock", "types", "Write the types of what functions give and take."),
    "up": ("_up", "up", "Serve whatever there is, without a configuration."),
}


class PluginGroup(click.Group):
    """A group that imports a command when it is run, ours or a plugin's."""

    def make_context(
        self,
        info_name: str | None,
        args: list[str],
        parent: click.Context | None = None,
        **extra: Any,
    ) -> click.Context:
        """Read the words before the command; what is wrong with them has a code of errors."""
        as_json = "--json" in args
        with _writing():
            try:
                context = super().make_context(info_name, args, parent, **extra)
            except click.UsageError as error:
                _fail_with_usage(error, as_json=as_json)
        context.meta[JSON] = as_json
        return context

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command. Whatever ends it is said in one way, with its code of errors."""
        with _writing():
            try:
                return super().invoke(ctx)
            except KeyboardInterrupt:  # which click would report as a failure, with the code of one
                echo("interrupted", err=True)
                sys.exit(INTERRUPTED)
            except click.UsageError as error:
                _fail_with_usage(error, as_json=bool(ctx.meta.get(JSON)))
            except click.ClickException as error:
                fail(error.format_message(), error.exit_code)
            except UoarmError as error:
                fail(error, exit_code_of(error))
            except RuntimeError as error:
                if str(error) != _NO_THREAD:
                    raise
                fail(f"{error}: {_LIMIT}", BRIDGE)
            except OSError as error:
                if error.errno in _AT_LIMIT:
                    fail(f"{error.strerror}: {_LIMIT}", BRIDGE)
                if _is_away(error):
                    fail(
                        "the folder that this runs in was removed: change to another",
                        REFUSED,
                        "UOA-003",
                    )
                if error.filename is None:
                    raise
                # As where a folder may not be searched.
                fail(f"{error.filename}: {error.strerror}", REFUSED, "UOA-003")

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return our own commands, then those of plugins."""
        own = sorted({*COMMANDS, *super().list_commands(ctx)})
        plugins = {point.name for point in entry_points(group=_GROUP)}
        return [*own, *sorted(plugins - set(own))]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return a command, imported if it is ours; a plugin's is only when it runs."""
        own = super().get_command(ctx, cmd_name)
        if own is not None:
            return own
        if cmd_name in COMMANDS:
            module, attribute, _ = COMMANDS[cmd_name]
            with importing():
                found: click.Command = getattr(import_module(f"uoarm.cli.{module}"), attribute)
            add_log_options(found)
            keep_apart(found)
            refuse_empty_words(found)
            self.add_command(found, cmd_name)
            return found
        point = next(
            (entry for entry in entry_points(group=_GROUP) if entry.name == cmd_name), None
        )
        if point is None and cmd_name in _BROUGHT:
            from uoarm._origin import install_command  # noqa: PLC0415 - for mistakes only

            ctx.fail(f"{cmd_name!r} belongs to a plugin: {install_command(_BROUGHT[cmd_name])}")
        return None if point is None else _command(point)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands with a line about each, of ours without importing them."""
        names = self.list_commands(ctx)
        limit = formatter.width - 6 - max(map(len, names))  # as click does for commands it has
        rows = [(name, self._listed(ctx, name).get_short_help_str(limit)) for name in names]
        with formatter.section("Commands"):
            formatter.write_dl(rows)

    def _listed(self, ctx: click.Context, name: str) -> click.Command:
        if name in COMMANDS:
            return click.Command(name, help=COMMANDS[name][2])
        found = self.get_command(ctx, name)
        assert found is not None
        return found


def _is_away(error: OSError) -> bool:
    """Say whether a path could not be made absolute, as there is no folder that it begins at."""
    try:
        Path.cwd()
    except FileNotFoundError as missing:
        return (error.errno, error.filename) == (missing.errno, None)
    return False


@contextmanager
def _writing() -> Iterator[None]:
    """Say that there is no room for what is printed, also for help and mistakes as JSON.

    Where what is printed is read no more, as by `head`, that ends the command in silence.
    """
    try:
        yield
    except OSError as error:
        if error.errno not in UNWRITTEN:
            raise
        with suppress(OSError, ValueError):  # what waits would fail once more when Python ends
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if error.errno in NO_ROOM:
            fail(f"nothing more can be written: {error.strerror}", UNPRINTED, "UOA-003")
        sys.exit(UNPRINTED)


def _fail_with_usage(error: click.UsageError, *, as_json: bool) -> NoReturn:
    """Say which words are wrong, below how the command is used; help that was meant is shown."""
    if isinstance(error, _HELP):
        raise error
    if error.ctx is not None:
        echo(error.ctx.get_usage(), err=True)
    failure = CommandLineError(error.format_message())
    print_failure(failure, failure.error_code, as_json=as_json)
    sys.exit(failure.exit_code)


def _command(point: EntryPoint) -> click.Command:
    @click.command(
        point.name,
        help=f"Of the plugin {point.dist.name if point.dist else point.name}.",
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
    from uoarm._plugins import values_of  # noqa: PLC0415 - of a plugin's command only
    from uoarm.plugins import CONTRACT_VERSION, Command, CommandHooks  # noqa: PLC0415 - as above

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


def _require_descriptors() -> None:
    """Begin nothing that has no room for an event loop: asyncio prints a traceback of half a one.

    Raises:
        OSError: there is none.
    """
    with ExitStack() as opened:
        for _ in range(_DESCRIPTORS):
            opened.callback(os.close, os.open(os.devnull, os.O_RDONLY))


@click.group(cls=PluginGroup)
@click.version_option(__version__, prog_name="uoarm")
@click.pass_context
def main(context: click.Context) -> None:
    """Ask for a robot function by name and get it from whichever framework provides it."""
    terminable(context)
    _require_descriptors()
    context.with_resource(logging_to_stderr(context))
    try:
        context.with_resource(short_switch_interval())
    except UsageError as error:
        raise click.UsageError(str(error)) from error


add_log_options(main)
