"""The one error of this package, a schema that is not a schema, and what ends a check early."""

from __future__ import annotations

import reprlib

__all__ = ["BudgetError", "OutOfScopeError", "SchemaError"]


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
