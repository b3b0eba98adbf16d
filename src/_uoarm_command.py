"""What our commands begin with: Ctrl-C ends them in silence while they still import.

It is no part of a package, whose import is most of what there is to wait for.
"""

import faulthandler
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
    if sys.stderr is not None and not faulthandler.is_enabled():
        faulthandler.enable(all_threads=False)  # a crash in C shows the line that called it
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not where it is ignored
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    command = import_module(module).main
    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    command()
