"""The one error of this package, a schema that is not a schema, and what ends a check early."""

from __future__ import annotations

import reprlib
from typing import TypeAlias

__all__ = ["BudgetError", "OutOfScopeError", "Pointer", "SchemaError", "write_pointer"]

Pointer: TypeAlias = "tuple[Pointer, str | int] | None"
"""A place in a schema, the place around it and a step; written as text only when it is told."""


class BudgetError(Exception):
    """The budget ran out; the text says what of it, and which part of the check took longest."""


_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 90


class OutOfScopeError(Exception):
    """The schema holds something that is not decided; the text says what."""


class SchemaError(ValueError):
    """A malformed schema: the text says which, where (JSON pointer), what was expected."""

    def __init__(self, pointer: str, expected: str, got: object) -> None:
        shown = _SHORT.repr(got)
        shown = shown if len(shown) <= 80 else f"{shown[:77]}..."  # noqa: PLR2004 - a line's worth
        super().__init__(f"{pointer or '#'}: expected {expected}, got {shown}")
        self.pointer = pointer


def write_pointer(pointer: Pointer) -> str:
    """Write a place as `#/properties/a`."""
    steps: list[str] = []
    while pointer is not None:
        pointer, step = pointer
        steps.append(f"/{step}")
    return "#" + "".join(reversed(steps))
