"""The one error of this package: a schema that is not a schema."""

from __future__ import annotations

__all__ = ["OutOfScopeError", "SchemaError"]


class OutOfScopeError(Exception):
    """The schema holds something that is not decided; the text says what."""


class SchemaError(ValueError):
    """A malformed schema: the text says which, where (JSON pointer), what was expected."""

    def __init__(self, pointer: str, expected: str, got: object) -> None:
        shown = repr(got)
        shown = shown if len(shown) <= 80 else f"{shown[:77]}..."  # noqa: PLR2004 - a line's worth
        super().__init__(f"{pointer or '#'}: expected {expected}, got {shown}")
        self.pointer = pointer
