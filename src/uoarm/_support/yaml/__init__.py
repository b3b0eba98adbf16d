"""YAML files that people write: plain values with their places, within a budget."""

from typing import TYPE_CHECKING

from uoarm._deferred import deferred
from uoarm._support.yaml._document import (
    Document,
    Path,
    Position,
    Problem,
    clip,
    mistakes_error,
    write_flow,
    write_path,
)

if TYPE_CHECKING:
    from uoarm._support.yaml._reader import ReadBudget, read, read_file

__all__ = [
    "Document",
    "Path",
    "Position",
    "Problem",
    "ReadBudget",
    "clip",
    "mistakes_error",
    "read",
    "read_file",
    "write_flow",
    "write_path",
]

if not TYPE_CHECKING:
    __getattr__, __dir__ = deferred(__name__, {"_reader": ("ReadBudget", "read", "read_file")})
