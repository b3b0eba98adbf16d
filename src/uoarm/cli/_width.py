"""What is shown on a terminal fits its width; what is piped stays as it is."""

from __future__ import annotations

import shutil
import sys
import textwrap

__all__ = ["fitted", "terminal_width"]

_LEAST = 20


def terminal_width() -> int | None:
    """Return the columns of the terminal that stdout is; None where it is none."""
    return max(_LEAST, shutil.get_terminal_size().columns) if sys.stdout.isatty() else None


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
