"""Standard output is what a command was asked for: what components print goes to standard error.

A component runs in the process of the command. What it prints, C code and programs that it starts
included, would stand among the lines of JSON that another program reads.
"""

from __future__ import annotations

import functools
import io
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO, TypeVar, cast

import click

__all__ = ["echo", "keep_apart", "output"]

_Command = TypeVar("_Command", bound=Callable[..., Any])
_STDOUT, _STDERR = 1, 2
_own: list[TextIO] = []  # of the command that runs; of another one within it, the last


def output() -> TextIO:
    """Return standard output as it was before components could print to it."""
    return _own[-1] if _own else sys.stdout


def echo(text: object = "", *, nl: bool = True, err: bool = False) -> None:
    """Write text for who gave the command."""
    click.echo(text, file=None if err else output(), nl=nl, err=err)


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
