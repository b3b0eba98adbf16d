"""How deep JSON text is nested, found before a parser is let loose on it."""

from __future__ import annotations

import re

from uoarm.errors import ControlMessageError

__all__ = ["check_depth"]

_TOKEN = re.compile(r'[\[{]|[\]}]|"[^"\\]*(?:\\.[^"\\]*)*(?:"|\\?\Z)', re.DOTALL)


def check_depth(text: str, limit: int) -> None:
    """Refuse text nested deeper than a limit, in time linear in its length.

    Raises:
        ControlMessageError: it is nested deeper.
    """
    if text.count("[") + text.count("{") <= limit:
        return
    depth = 0
    for token in _TOKEN.finditer(text):
        first = token.group()[0]
        if first in "[{":
            depth += 1
            if depth > limit:
                raise ControlMessageError(f"nested more than {limit} levels deep")
        elif first != '"':
            depth -= 1
