"""What a search can come to: a value, proof that there is none, or a reason to give up."""

from __future__ import annotations

from typing import Any, TypeAlias

from attrs import frozen

__all__ = ["EMPTY", "Empty", "Found", "Result", "Unknown"]


@frozen
class Found:
    """A value that does."""

    value: Any


@frozen
class Empty:
    """No value does."""


@frozen
class Unknown:
    """Nobody knows; the cause says what was too much."""

    cause: str


Result: TypeAlias = "Found | Empty | Unknown"
EMPTY = Empty()
