"""A real terminal for a command under test: what a person would have seen on it."""

from __future__ import annotations

import os
import pty
import re
import select
import signal
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Mapping, Sequence
from fcntl import ioctl
from pathlib import Path

from uoarm.testing import patience

_ERASED = "\x1b[2K"
_CONTROL = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\r")
_LIMIT_SECONDS = 5 * patience()


class Seen:
    """What a command wrote on its terminal.

    Attributes:
        code: its exit code.
        text: everything, without colours and moves of the cursor; what was drawn anew stands
            there as often as it was drawn.
        raw: everything as it was written.
        last: what was drawn last in place, and all after it.
    """

    def __init__(self, code: int, raw: str) -> None:
        self.code = code
        self.raw = raw
        self.text = _CONTROL.sub("", raw.replace(_ERASED, "\n"))
        self.last = _CONTROL.sub("", raw.rpartition(_ERASED)[2])


def on_a_terminal(
    arguments: Sequence[str],
    folder: Path,
    *,
    width: int = 120,
    height: int = 40,
    interrupt_at: str = "",
    number: signal.Signals = signal.SIGINT,
    program: Sequence[str] = ("-m", "uoarm"),
    environment: Mapping[str, str] | None = None,
) -> Seen:
    """Run `uoarm` with a pseudo terminal as its input, output and error until it ends.

    Args:
        arguments: of the command.
        folder: where it runs.
        width: of the terminal, in characters.
        height: of it, in lines.
        interrupt_at: a text at whose appearance the command gets a signal.
        number: that signal; Ctrl-C where none is named.
        program: what Python is given before the arguments.
        environment: variables; TERM, if it is not named, is that of a terminal with colours.
    """
    ours, theirs = pty.openpty()
    ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", height, width, 0, 0))
    variables = {**os.environ, "TERM": "xterm-256color", "PYTHONUNBUFFERED": "1"}
    for name in ("NO_COLOR", "CI", "COLUMNS", "LINES"):
        variables.pop(name, None)
    variables.update(environment or {})
    process = subprocess.Popen(
        [sys.executable, *program, *arguments],
        cwd=folder,
        env=variables,
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        start_new_session=True,
    )
    os.close(theirs)
    raw = b""
    deadline = time.monotonic() + _LIMIT_SECONDS
    try:
        while chunk := _read(ours, deadline):
            raw += chunk
            if interrupt_at and interrupt_at.encode() in raw:
                interrupt_at = ""
                process.send_signal(number)
        code = process.wait(_LIMIT_SECONDS)
    finally:
        process.kill()
        process.wait()
        os.close(ours)
    return Seen(code, raw.decode())


def _read(terminal: int, deadline: float) -> bytes:
    ready, _, _ = select.select([terminal], [], [], max(0.0, deadline - time.monotonic()))
    assert ready, "the command did not end"
    try:
        return os.read(terminal, 65536)
    except OSError:  # the other end was closed
        return b""
