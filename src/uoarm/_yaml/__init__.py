"""YAML files that people write: plain values with their places, within a budget."""

from uoarm._yaml._document import Document, Path, Place, Problem, clip, write_path
from uoarm._yaml._reader import ReadBudget, read, read_file

__all__ = [
    "Document",
    "Path",
    "Place",
    "Problem",
    "ReadBudget",
    "clip",
    "read",
    "read_file",
    "write_path",
]
