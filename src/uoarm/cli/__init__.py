"""The command line, `uoarm`. docs/cli.md has the commands and their exit codes."""

from uoarm.cli._main import main

__all__ = ["main"]
