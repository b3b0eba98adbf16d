"""What our commands begin with: Ctrl-C ends them in silence while they still import.

Standard streams that are closed lead to /dev/null before anything else is opened.

It is no part of a package, whose import is most of what there is to wait for.
"""

import faulthandler
import os
import signal
import sys
from importlib import import_module


def main() -> None:
    """Run the command `uoarm`."""
    run("uoarm.cli")


def run(module: str) -> None:
    """Import a module and call its `main`.

    Until it has been imported nothing is open, so that SIGINT may end the process as SIGTERM does,
    by itself: an exception could be lost, or reported as another one, within any module's import.
    """
    _open_standard_streams()
    _write_all_text()
    if not faulthandler.is_enabled():
        faulthandler.enable(all_threads=False)  # a crash in C shows the line that called it
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not where it is ignored
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    command = import_module(module).main
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    command()


def _write_all_text() -> None:
    r"""Write what an encoding has not as JSON, YAML and Python have it, such as `\u2603`.

    A locale need not be of UTF-8, and names of files need not be text.
    """
    if getattr(sys.stdout, "errors", "") == "strict":
        sys.stdout.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]


def _open_standard_streams() -> None:
    """Open what was left closed, as services are started: the next file would take its place.

    What is printed would go into that file, and Python has None where the stream should be.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            opened = os.open(os.devnull, os.O_RDWR)  # the lowest free number
            os.set_inheritable(opened, opened == number)
            setattr(sys, name, os.fdopen(opened, "w" if number else "r", closefd=False))
