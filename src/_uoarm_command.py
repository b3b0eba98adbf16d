"""What the command `uoarm` begins with: Ctrl-C ends it in silence while it still imports.

It is no part of the package, whose import is most of what there is to wait for.
"""

import signal


def main() -> None:
    """Import the command line and run it.

    Until it has been imported nothing is open, so that SIGINT may end the process as SIGTERM does,
    by itself: an exception could be lost, or told as another one, within any module's import.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not where it is ignored
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from uoarm.cli import main as command  # noqa: PLC0415 - what takes its time

    if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    command()
