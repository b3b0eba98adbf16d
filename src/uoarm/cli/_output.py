"""What a command writes: what it was asked for to standard output, its log to standard error.

A component runs in the process of the command. What it prints, C code and programs that it starts
included, would stand among the lines of JSON that another program reads: it goes to standard error.
"""

from __future__ import annotations

import errno
import functools
import io
import logging
import os
import re
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any, TextIO, TypeVar, cast

import click

from uoarm._encodable import printable
from uoarm._log_lines import JsonFormatter, StderrHandler, TextFormatter

_Command = TypeVar("_Command", bound=Callable[..., Any])
_STDOUT, _STDERR = 1, 2
NO_ROOM = frozenset({errno.ENOSPC, errno.EFBIG, errno.EDQUOT})
UNWRITTEN = NO_ROOM | {errno.EPIPE}  # what fails with these is no socket that is read
_SILENT_SECONDS = 3.0
_own: list[TextIO] = []  # of the command that runs; of another one within it, the last
_VARIABLE = "UOARM_LOG"
_META = "uoarm.log"
_EARLY = "uoarm.log.early"
_OURS = "uoarm"
_LEVELS = ("debug", "info", "warning", "error")
_COLOUR = re.compile(r"(\x1b\[[0-9;]{1,4}m)")  # as `styled` writes them
_CLEAR = "\x1b[2J\x1b[1;1H"
_FORMS = {"text": TextFormatter, "json": JsonFormatter}


def output() -> TextIO:
    """Return standard output as it was before components could print to it."""
    return _own[-1] if _own else sys.stdout


def echo(text: object = "", *, nl: bool = True, err: bool = False) -> None:
    """Write text for who gave the command.

    Of what controls a terminal only colours pass: text may be of components and other machines.
    """
    parts = _COLOUR.split(str(text))
    parts[::2] = map(printable, parts[::2])
    click.echo("".join(parts), file=None if err else output(), nl=nl, err=err)


def styled(text: str, *, fg: str | None = None, bold: bool = False) -> str:
    """Return text in a colour, where that is wanted: NO_COLOR is not set, nor a dumb terminal."""
    is_plain = os.environ.get("NO_COLOR") or _is_dumb()
    return text if is_plain else click.style(text, fg=fg, bold=bold or None)


def clear() -> None:
    """Clear the terminal, if there is one that can be cleared."""
    if output().isatty() and not _is_dumb():
        click.echo(_CLEAR, file=output(), nl=False)


def _is_dumb() -> bool:
    """Say whether the terminal takes lines of text and nothing else, as one in an editor."""
    return os.environ.get("TERM") == "dumb"


@contextmanager
def saying_what_is_waited_for(what: str, timeout: float) -> Iterator[None]:
    """Say at a terminal what is waited for, after three seconds, and how long at most."""
    text = f"waiting for {what}, at most {timeout:g} s"
    timer = threading.Timer(_SILENT_SECONDS, partial(echo, text, err=True))
    timer.daemon = True
    if sys.stderr.isatty():
        timer.start()
    try:
        yield
    finally:
        timer.cancel()
        if timer.ident is not None:
            timer.join()


def keep_apart(command: click.Command) -> None:
    """Have a command, and all commands in it, keep its output apart from what components print."""
    # That of `uoarm.schema`, which stands alone, writes by itself and runs no component.
    if command.callback is not None and command.callback.__module__.startswith(__package__):
        command.callback = _kept_apart(command.callback)
    if isinstance(command, click.Group):
        for member in command.commands.values():
            keep_apart(member)


def _kept_apart(callback: _Command) -> _Command:
    @functools.wraps(callback)
    def run(*args: Any, **kwargs: Any) -> Any:
        with _apart():
            return callback(*args, **kwargs)

    return cast("_Command", run)


@contextmanager
def _apart() -> Iterator[None]:
    former = sys.stdout
    with _own_descriptor(former) as own:
        _own.append(own)
        sys.stdout = sys.stderr
        try:
            yield
        finally:
            sys.stdout = former
            _own.pop()


@contextmanager
def _own_descriptor(stream: TextIO) -> Iterator[TextIO]:
    """Give what writes to standard output, and have its descriptor be that of standard error."""
    try:
        is_standard = stream.fileno() == _STDOUT
        os.fstat(_STDERR)
    except (OSError, ValueError, io.UnsupportedOperation, AttributeError):
        is_standard = False  # another stream stands in its place, or it is closed
    if not is_standard:
        yield stream
        return
    stream.flush()
    kept = os.dup(_STDOUT)
    os.dup2(_STDERR, _STDOUT)
    own = os.fdopen(os.dup(kept), "w", encoding=stream.encoding, errors=stream.errors)
    try:
        yield own
    finally:
        import ctypes  # noqa: PLC0415 - slow import

        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).fflush(None)  # what C code has printed, and not written yet
        os.dup2(kept, _STDOUT)
        os.close(kept)
        with suppress(OSError):  # what could not be written has been reported
            own.close()


class _Log:
    """The handler of a command's records, and the levels that were asked for by name of logger."""

    def __init__(self) -> None:
        self.handler = StderrHandler()
        self.handler.addFilter(self._is_asked_for)
        self._asked = {_OURS: logging.WARNING}
        self._former: dict[str, int] = {}
        self._is_chosen = False
        self.take("text")

    def open(self) -> None:
        logging.getLogger().addHandler(self.handler)

    def close(self) -> None:
        logging.getLogger().removeHandler(self.handler)
        for name, level in self._former.items():
            logging.getLogger(name).setLevel(level)

    def take(self, given: str) -> None:
        """Hold to one choice, of a form or of a level.

        Raises:
            ValueError: it is neither.
        """
        if given in _FORMS:
            self.handler.setFormatter(_FORMS[given]())
            return
        name, is_named, level = _checked_level(given).rpartition("=")
        self._set(name.strip() if is_named else _OURS, getattr(logging, level.upper()))
        self._is_chosen = self._is_chosen or not is_named

    def at_least(self, level: int) -> None:
        """Have records of this level written, unless another one was asked for."""
        if not self._is_chosen:
            self._set(_OURS, level)

    def _set(self, name: str, level: int) -> None:
        logger = logging.getLogger(name)
        self._former.setdefault(name, logger.level)
        self._asked[name] = level
        logger.setLevel(level)

    def _is_asked_for(self, record: logging.LogRecord) -> bool:
        """Say whether a record is of a level that was asked for, or of a logger of others.

        A file of the audit log has its logger make records that nothing else wants.
        """
        name = record.name
        while name and name not in self._asked:
            name = name.rpartition(".")[0]
        return not name or record.levelno >= self._asked[name]


def _checked_level(given: str) -> str:
    """Return one choice: `LEVEL`, of all loggers of uoarm, or `LOGGER=LEVEL`.

    Raises:
        ValueError: there is no such level.
    """
    level = given.rpartition("=")[2].lower()
    if level not in _LEVELS:
        from uoarm._mistakes import any_of  # noqa: PLC0415 - for mistakes only
        from uoarm._spelling import Speller  # noqa: PLC0415 - for mistakes only

        hint = Speller().guess(level, _LEVELS)
        expected = f"expected {any_of(_LEVELS)}, or LOGGER=LEVEL such as uoarm.control=debug"
        raise ValueError(f"{expected}; got {given!r}{hint and f'; {hint}'}")
    return given


@contextmanager
def logging_to_stderr(context: click.Context) -> Iterator[None]:
    """Write the records of a command while it runs, as the variable and its options say.

    Raises:
        click.UsageError: the variable says something else.
    """
    log = _Log()
    log.open()
    try:
        chosen = filter(None, map(str.strip, os.environ.get(_VARIABLE, "").split(",")))
        for given in (*chosen, *context.meta.pop(_EARLY, ())):
            try:
                log.take(given)
            except ValueError as error:
                from uoarm._mistakes import any_of  # noqa: PLC0415 - for mistakes only

                expected = f"{_VARIABLE}: {error}; or {any_of(_FORMS)}"
                raise click.UsageError(expected, ctx=context) from error
        context.meta[_META] = log
        yield
    finally:
        log.close()


def at_least(level: int) -> None:
    """Have a command that is about its log write these records unless an option says otherwise."""
    click.get_current_context().meta[_META].at_least(level)


@contextmanager
def leaving_out(repeated: re.Pattern[str]) -> Iterator[None]:
    """Write no records that begin so: the command prints itself what they say."""
    log: _Log = click.get_current_context().meta[_META]

    def is_new(record: logging.LogRecord) -> bool:
        return repeated.match(record.getMessage()) is None

    log.handler.addFilter(is_new)
    try:
        yield
    finally:
        log.handler.removeFilter(is_new)


def _take(context: click.Context, choices: Iterable[str]) -> None:
    """Hold to what an option says: now, or, of those before the command, when its log begins."""
    log: _Log | None = context.meta.get(_META)
    for given in choices:
        if log is None:
            context.meta.setdefault(_EARLY, []).append(given)
        else:
            log.take(given)


def _take_levels(context: click.Context, parameter: click.Parameter, given: Iterable[str]) -> None:
    try:
        _take(context, map(_checked_level, given))
    except ValueError as error:
        raise click.BadParameter(str(error), ctx=context, param=parameter) from error


def add_log_options(command: click.Command) -> None:
    """Give a command, and all commands in it, the options of the log."""
    command.params += [
        click.Option(
            ["--log-level"],
            metavar="LEVEL",
            multiple=True,
            expose_value=False,
            callback=_take_levels,
            help="Write records from debug, info, warning or error on; LOGGER=LEVEL for one.",
        ),
        click.Option(
            ["--log-format"],
            type=click.Choice(list(_FORMS)),
            expose_value=False,
            callback=lambda context, _, form: _take(context, [] if form is None else [form]),
            help=f"Write records as lines of text or of JSON; {_VARIABLE} has both.",
        ),
    ]
    if isinstance(command, click.Group):
        for member in command.commands.values():
            add_log_options(member)
