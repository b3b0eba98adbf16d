"""What every command shares: its file, exit codes, one line for an error, text for a terminal."""

from __future__ import annotations

import functools
import os
import signal
import sys
import textwrap
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar, cast
from urllib.parse import urlsplit

import click
from click.core import ParameterSource
from click.shell_completion import CompletionItem

from uoarm import errors
from uoarm._encodable import in_short_lines
from uoarm._forks import default_in_children
from uoarm._secrets import without_secrets
from uoarm._support.files import UnreadableFileError, read_text
from uoarm.cli._output import echo, output, styled

if TYPE_CHECKING:
    from uoarm import RobotManager
    from uoarm.model import Function, Message

F = TypeVar("F", bound=Callable[..., Any])
REFUSED, CONFIGURATION, BRIDGE, CANNOT_LISTEN, UNPRINTED, INTERRUPTED = 1, 3, 4, 5, 6, 130
JSON = "uoarm.json"  # of the context: whether `--json` is among the words
_NAMED = 20
_MOST_OCTETS = 10_000_000  # as configurations have at most
STANDARD = "robot.yaml"
CONFIGURATION_ENDINGS = (".yaml", ".yml")
_CONFIGURATION = click.Path(readable=False)  # whether it can be read is said as it is
_Command = TypeVar("_Command", bound=Callable[..., Any])


def _can(function: Function, *, serve: bool) -> bool:
    """Say whether a function can be called, or else requested, should its components be there."""
    from uoarm.model import Role  # noqa: PLC0415 - when first needed

    if function.needs is not None and (function.needs.role is Role.SERVICE) is serve:
        return True
    return any((component.service is not None) is serve for component in function.components)


class FunctionArgument(click.Argument):
    """The name of a function of the configuration, which the tab key completes.

    It must be given; that it is missing is said once it is known in which file it would be.

    Args:
        declarations: as of every argument.
        serves: whether only those are meant that answer calls, or only those that do not.
        nargs: how many; -1: any number.
    """

    def __init__(self, declarations: Sequence[str], *, serves: bool | None, nargs: int = 1) -> None:
        metavar = "NAME" if nargs == 1 else "[NAME]..."
        super().__init__(declarations, required=False, metavar=metavar, nargs=nargs)
        self._serves = serves

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Return the names that begin so."""
        file = ctx.params.get("file") or os.environ.get("UOARM_CONFIG") or "robot.yaml"
        try:
            names = self._names(file)
        except errors.UoarmError:  # there is nothing to complete where it cannot be read
            return []
        return [CompletionItem(name) for name in names if name.startswith(incomplete)]

    def missing(self, context: click.Context, file: str) -> click.UsageError:
        """Return the error that no name was given: it says which there are."""
        if context.params.get("url"):
            text = f"uoarm list --url {context.params['url']} says which there are"
            return click.MissingParameter(text, ctx=context, param=self)
        try:
            names = self._names(file)
        except errors.UoarmError as error:
            text = str(error)
        else:
            more = f" and {len(names) - _NAMED:,} more" if len(names) > _NAMED else ""
            kind = {None: "", True: " that are called", False: " that are requested"}[self._serves]
            text = f"{file} has no functions{kind}"
            if names:
                text = f"{file} has the functions {', '.join(names[:_NAMED])}{more}"
        return click.MissingParameter(text, ctx=context, param=self)

    def _names(self, file: str) -> list[str]:
        from uoarm.config import load  # noqa: PLC0415 - when first needed

        functions = load(file).functions
        is_any = self._serves is None
        return [
            name
            for name, function in functions.items()
            if is_any or _can(function, serve=bool(self._serves))
        ]


def function_argument(*, serves: bool | None = None) -> Callable[[F], F]:
    """Give a command the name of a function as its argument; see `FunctionArgument`."""
    return click.argument("name", cls=FunctionArgument, serves=serves)


class Seconds(click.FloatRange):
    """A number of seconds that a clock can wait for: a billion at most, which NaN is not."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Return the number.

        Raises:
            click.BadParameter: it is none, or out of range.
        """
        seconds = float(super().convert(value, param, ctx))
        if not seconds <= _MOST_SECONDS:
            self.fail(f"expected seconds, a billion at most, got {value}", param, ctx)
        return seconds


_MOST_SECONDS = 1e9
NO_FUNCTIONS = "no functions"
"""What is said where an empty table would be."""


json_option = click.option("--json", "as_json", is_flag=True, help="Print JSON.")


every_option = click.option(
    "--every",
    type=Seconds(min=0.1),
    default=2.0,
    show_default=True,
    help="Seconds between two looks of --watch.",
)


def terminable(context: click.Context) -> None:
    """Have SIGTERM end whatever command runs as Ctrl-C does: what is open is closed first.

    So does SIGHUP, as when a terminal or its network is gone: nothing must be left moving then.
    Commands that serve have handlers of their own. A second signal ends the process at once.
    """
    if threading.current_thread() is not threading.main_thread():
        return
    if signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
        return

    def end(number: int, _: object) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        sys.exit(128 + number)

    signal.signal(signal.SIGTERM, end)
    context.call_on_close(lambda: signal.signal(signal.SIGTERM, signal.SIG_DFL))
    hangup = getattr(signal, "SIGHUP", None)  # not on every system
    if hangup is None or signal.getsignal(hangup) is not signal.SIG_DFL:  # as of `nohup`
        return
    signal.signal(hangup, lambda *_: signal.raise_signal(signal.SIGTERM))
    default_in_children([hangup])
    context.call_on_close(lambda: signal.signal(hangup, signal.SIG_DFL))


@contextmanager
def at_signals(**actions: Callable[[], object]) -> Iterator[None]:
    """Act on signals, by their names, during the block, each time in a thread of its own."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    former = {
        number: signal.signal(
            number,
            # Not in the handler: what it interrupts may hold a lock that this needs.
            lambda *_, act=act: threading.Thread(target=act, daemon=True).start(),
        )
        for name, act in actions.items()
        if (number := getattr(signal, name, None)) is not None  # not on every system
    }
    default_in_children(former)
    try:
        yield
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)


def exit_code_of(error: errors.UoarmError) -> int:
    """Return the documented exit code of a command that an error ends."""
    if isinstance(error, errors.CommandLineError):
        return error.exit_code
    if isinstance(error, errors.ConfigurationError):
        return CONFIGURATION
    if isinstance(error, errors.ListenError):
        return CANNOT_LISTEN
    refusals = errors.ResolutionError, errors.MessageError, errors.UsageError
    return REFUSED if isinstance(error, refusals) else BRIDGE


@contextmanager
def reporting() -> Iterator[None]:
    """Turn errors into one message and the documented exit code."""
    try:
        yield
    except errors.UoarmError as error:
        fail(error, exit_code_of(error))
    except KeyboardInterrupt:
        echo("interrupted", err=True)
        sys.exit(INTERRUPTED)


@contextmanager
def reading_words(kind: type[errors.UoarmError] = errors.UsageError) -> Iterator[None]:
    """Have what is wrong with the words of a command be wrong usage, whatever finds it.

    Raises:
        click.UsageError: the block, which reads words and does nothing else, raised such an error.
    """
    try:
        yield
    except kind as error:
        raise click.UsageError(str(error)) from error


_MAY_BE_EMPTY = frozenset({"cause", "message"})


def refuse_empty_words(command: click.Command) -> None:
    """Have a command, and all commands in it, refuse empty text: no name or file is that.

    It comes of a variable that a script has not set, and would stand for the current folder, for
    every address, or for a name that nothing has.
    """
    for parameter in command.params:
        if parameter.name not in _MAY_BE_EMPTY:
            # Before it is converted: an empty path becomes that of the current folder.
            consume = functools.partial(_consume, parameter, parameter.consume_value)
            setattr(parameter, "consume_value", consume)  # noqa: B010 - a method
    if isinstance(command, click.Group):
        for member in command.commands.values():
            refuse_empty_words(member)


def _consume(
    parameter: click.Parameter,
    consume: Callable[..., tuple[Any, ParameterSource]],
    context: click.Context,
    words: Mapping[str, Any],
) -> tuple[Any, ParameterSource]:
    value, source = consume(context, words)
    given = value if isinstance(value, tuple | list) else (value,)
    if source is ParameterSource.COMMANDLINE and "" in given and not context.resilient_parsing:
        raise click.BadParameter("expected some text, got ''", context, parameter)
    return value, source


@contextmanager
def needing(extra: str) -> Iterator[None]:
    """Import what an extra brings; where it is not installed, PluginError says how it would be."""
    try:
        yield
    except ImportError as error:
        from uoarm._origin import install_command  # noqa: PLC0415 - when first needed

        # Of a package that says so itself, this is of what is missing.
        cause = error.__cause__ if isinstance(error.__cause__, ImportError) else error
        command = install_command("uoarm", extra)
        text = f"this needs: {command} ({cause})"
        raise errors.PluginError(text, error_code="UOA-302") from error


@contextmanager
def importing() -> Iterator[None]:
    """Import modules; Ctrl-C meanwhile ends the process, as it does before there is a command.

    Nothing is open yet, and an exception could be lost, or reported as another one, in an import.
    """
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@contextmanager
def open_robot(file: str, stop_file: Path | None = None) -> Iterator[RobotManager]:
    """Read the configuration and close the manager whatever happens."""
    with importing():
        from uoarm import RobotManager  # noqa: PLC0415 - when first needed

    with reporting(), RobotManager.from_file(file, stop_file=stop_file) as robot:
        yield robot


def text_of_file(file: str | Path, limit: int = _MOST_OCTETS) -> str:
    """Return the text of a regular file.

    Raises:
        ConfigurationError: it cannot be read, has more octets than the limit, or is not UTF-8.
    """
    try:
        return read_text(Path(file), limit)
    except UnreadableFileError as error:
        raise errors.ConfigurationError(f"{file}: {error}", error_code="UOA-101") from error


def print_json(value: Any, *, in_one_line: bool = False) -> None:
    """Print a value of the model, or plain data, as JSON, indented or in one line."""
    from uoarm.model import to_json, write_json  # noqa: PLC0415 - when first needed

    echo(write_json(to_json(value), indent=None if in_one_line else 2))


def plain(message: Message, most: int | None = None) -> Any:
    """Return a message as JSON values: octets and buffers as lists, as `call` takes them.

    Args:
        message: any logical value.
        most: items that a buffer may have to be a list; a longer one, and octets, become a note of
            their size.
    """
    if isinstance(message, str):
        return message
    if isinstance(message, bytes | bytearray | memoryview):
        return list(memoryview(message).cast("B")) if most is None else f"<{len(message)} octets>"
    if hasattr(message, "tolist"):
        size = getattr(message, "size", 0) or len(message)
        return message.tolist() if most is None or size <= most else f"<{size:,} items>"
    if isinstance(message, dict):
        return {key: plain(value, most) for key, value in message.items()}
    if isinstance(message, list | tuple):
        return [plain(value, most) for value in message]
    from uoarm.model import to_json  # noqa: PLC0415 - when first needed

    return to_json(message)


def is_address(url: str, schemes: tuple[str, ...]) -> bool:
    """Say whether text is `SCHEME://HOST`, with a port that can be one if it has any."""
    try:
        parts = urlsplit(url)
        return parts.scheme in schemes and bool(parts.hostname) and parts.port != 0
    except ValueError:
        return False


def fail(
    error: Exception | str, code: int, error_code: str = "UOA-001", **details: object
) -> NoReturn:
    """Say what is wrong, and exit; an error of uoarm has its own code of errors.

    With `--json` its object has these details, too.
    """
    context = click.get_current_context(silent=True)
    as_json = context is not None and bool(context.meta.get(JSON))
    print_failure(error, error_code, as_json=as_json, **details)
    sys.exit(code)


def print_failure(
    error: Exception | str, error_code: str, *, as_json: bool, **details: object
) -> None:
    """Say on stderr what is wrong; as JSON on stdout, too, in one line.

    Without secrets, as a token in an address: what a command prints is often kept.
    """
    if isinstance(error, errors.UoarmError):
        error_code = error.error_code
    error = in_short_lines(without_secrets(str(error)))
    if as_json:
        print_json({**details, "error": error, "error_code": error_code}, in_one_line=True)
    print_error(error)
    print_error_code(error_code)


def print_error_code(error_code: str) -> None:
    echo(f"uoarm explain {error_code} says more", err=True)


def print_error(error: object) -> None:
    """Say on stderr what is wrong."""
    echo(f"{styled('error:', fg='red')} {in_short_lines(str(error))}", err=True)


def print_warning(warning: object) -> None:
    """Say on stderr what is worth a look."""
    echo(f"{styled('warning:', fg='yellow')} {warning}", err=True)


_LEAST, _USUAL = 20, 80  # a terminal may not know its width


def terminal_width() -> int | None:
    """Return the columns of the terminal that stdout is; None where it is none."""
    if not output().isatty():
        return None
    columns = os.environ.get("COLUMNS", "")
    if columns.isdecimal() and int(columns):
        return max(_LEAST, int(columns))
    # Not by `shutil`, which looks at what has the number of standard output now.
    return max(_LEAST, os.get_terminal_size(output().fileno()).columns or _USUAL)


def fitted(text: str) -> str:
    """Return text whose lines fit the terminal: what goes on stands below, two columns further."""
    width = terminal_width()
    if width is None:
        return text
    lines: list[str] = []
    for line in text.splitlines():
        indent = line[: len(line) - len(line.lstrip())][: width // 2]
        lines += textwrap.wrap(
            line.strip(),
            width,
            initial_indent=indent,
            subsequent_indent=f"{indent}  ",
            break_on_hyphens=False,
            replace_whitespace=False,
        ) or [""]
    return "\n".join(lines)


def hold_apart(*words: str) -> None:
    """Refuse options and arguments of which one would do nothing beside another.

    Args:
        words: as they are written: `--watch`, `FILE`.

    Raises:
        click.UsageError: more than one of them was given to the command that runs.
    """
    given = _given(words)
    if len(given) > 1:
        raise click.UsageError(f"give {given[0]} or {given[1]}, not both")


def hold_to(leading: str, *words: str) -> None:
    """Refuse options that would do nothing without another one.

    Raises:
        click.UsageError: one of them was given to the command that runs, without the leading one.
    """
    given = _given(words)
    if given and not _given([leading]):
        # It stands last: the word after `--token` would be hidden as a secret.
        raise click.UsageError(f"without {leading} there is no use for {given[0]}")


def _given(words: Sequence[str]) -> list[str]:
    context = click.get_current_context()
    given = {
        word
        for parameter in context.command.params
        if context.get_parameter_source(parameter.name or "") is ParameterSource.COMMANDLINE
        for word in (*parameter.opts, parameter.human_readable_name.strip("[]"))
    }
    return [word for word in words if word in given]


class DefaultConfiguration(Enum):
    """Which configuration a command takes where none is named; the value is said in its help."""

    STANDARD = STANDARD
    IF_THERE = f"{STANDARD}, if it is there"
    NONE = ""


def takes_configuration(
    *words: str, unnamed: DefaultConfiguration = DefaultConfiguration.STANDARD, listed: str = ""
) -> Callable[[_Command], _Command]:
    """Give a command its configuration as `file`: written as a word, with -f or in UOARM_CONFIG.

    A word that ends as files of YAML do is the configuration wherever it stands among the words;
    any other is it after all words of the command's own.

    Args:
        words: the command's own arguments before it, each of one word, in their order.
        unnamed: what holds where none is named.
        listed: the command's argument of any number of words, in place of `words`.
    """

    def add(command: _Command) -> _Command:
        @functools.wraps(command)
        def with_file(**options: Any) -> Any:
            context = click.get_current_context()
            if listed:
                files = [word for word in options[listed] if word.endswith(CONFIGURATION_ENDINGS)]
                options[listed] = tuple(word for word in options[listed] if word not in files)
                place = files[0] if files else None
                if len(set(files)) > 1:
                    text = f"the configuration is named twice: {files[0]} and {files[1]}"
                    raise click.UsageError(text)
            else:
                place = _sorted(context, words, options)
            options["file"] = file = _chosen(context, place, options["file"], unnamed)
            for parameter in context.command.params:
                if isinstance(parameter, FunctionArgument) and options[parameter.name] is None:
                    raise parameter.missing(context, file or STANDARD)
            return command(**options)

        option = click.option(
            "-f",
            "--file",
            "file",
            envvar="UOARM_CONFIG",
            show_default=unnamed.value,
            type=_CONFIGURATION,
            help="Configuration file, in place of FILE; also UOARM_CONFIG.",
        )
        if listed:
            return cast("_Command", option(with_file))
        argument = click.argument("place", metavar="[FILE]", required=False, type=_CONFIGURATION)
        return cast("_Command", argument(option(with_file)))

    return add


def _sorted(context: click.Context, words: tuple[str, ...], options: dict[str, Any]) -> str | None:
    """Give each word of a command what is meant for it; return the configuration among them."""
    place: str | None = options.pop("place")
    if place is not None and place.endswith(CONFIGURATION_ENDINGS):
        return place
    is_optioned = context.get_parameter_source("file") is ParameterSource.COMMANDLINE
    given = [
        options[word]
        for word in words
        if context.get_parameter_source(word) is ParameterSource.COMMANDLINE
    ]
    files = [word for word in given if word.endswith(CONFIGURATION_ENDINGS)]
    if not files or (is_optioned and place is None):
        return place
    given.remove(files[0])
    if place is not None:
        given.append(place)
    for parameter in context.command.params:
        name = parameter.name or ""
        if name in words:
            if not given and parameter.required:
                raise click.MissingParameter(ctx=context, param=parameter)
            is_function = isinstance(parameter, FunctionArgument)
            default = None if is_function else parameter.get_default(context)
            options[name] = given.pop(0) if given else default
    return cast("str", files[0])


def _chosen(
    context: click.Context, place: str | None, optioned: str | None, unnamed: DefaultConfiguration
) -> str | None:
    """Return the one file that is named, or what holds where none is."""
    is_optioned = context.get_parameter_source("file") is ParameterSource.COMMANDLINE
    if place is not None and is_optioned and place != optioned:
        raise click.UsageError(f"the configuration is named twice: {place} and -f {optioned}")
    named = place if place is not None else optioned
    if named is not None or unnamed is DefaultConfiguration.NONE:
        return named
    return STANDARD if unnamed is DefaultConfiguration.STANDARD or Path(STANDARD).exists() else None
