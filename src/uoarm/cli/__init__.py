"""The command line: `uoarm check`, `list`, `resolve`, `request`, `call`, `bridges`, `doctor`.

Exit codes: 0 done; 1 refused (no plan fits, a message does not match); 2 wrong usage;
3 the configuration has mistakes; 4 a bridge failed; 130 interrupted.
"""

from uoarm.cli._main import main

__all__ = ["main"]
