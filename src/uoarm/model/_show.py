"""A value in an error's text, in time and length that do not grow with the value."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from uoarm.model._octets import message_octets

__all__ = ["show_value"]

_SMALL = 4096


def show_value(value: Any, most: int = 60) -> str:
    """Return a value as Python would write it, cut after some characters.

    What takes more than 4 KiB of memory is only told by its kind and length: to write out a list of
    a million numbers for sixty characters of it would take longer than to decode it.
    """
    if isinstance(value, str | bytes):
        shown = repr(value[:most])
        return shown if len(value) <= most else f"{shown}..."
    if message_octets(value, most=_SMALL) > _SMALL:
        if isinstance(value, Mapping):
            return f"an object with {len(value):,} members"
        if isinstance(value, list | tuple):
            return f"a list of {len(value):,} values"
        return f"a large {type(value).__name__}"
    shown = repr(value)
    return shown if len(shown) <= most else f"{shown[:most]}..."
