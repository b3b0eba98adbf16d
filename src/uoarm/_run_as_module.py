"""What `python -m uoarm` begins with, whose package Python imports before its `__main__`.

Ctrl-C ends it in silence while it still imports, as it ends the installed `uoarm`; `__main__` goes
on as that does. In every other process nothing is changed.
"""

import signal
import sys

_BEFORE_WORDS = len(sys.orig_argv) - len(sys.argv) + 1

# The first word is that only for as long as Python looks for the module that it is to run.
if (
    sys.argv[:1] == ["-m"]
    and sys.orig_argv[:_BEFORE_WORDS][-2:] == ["-m", "uoarm"]
    and signal.getsignal(signal.SIGINT) is signal.default_int_handler
):
    signal.signal(signal.SIGINT, signal.SIG_DFL)
